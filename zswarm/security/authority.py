"""The lab's authority: it issues keys, records whose they are, and signs the list of members.

Its folder holds ``authority.pem``, ``key.pem`` (who can read it can let anyone in) and the ledger.
"""

import contextlib
import fcntl
import itertools
import os
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Self

import msgspec
from cryptography.hazmat.primitives.serialization import Encoding

from zswarm.config.suggest import nearest
from zswarm.errors import KeysError
from zswarm.protocol import keys
from zswarm.security import certificates, keyring
from zswarm.security.certificates import AUTHORITY, KEY, Bundle
from zswarm.security.ledger import LEDGER, Issued, Ledger
from zswarm.security.members import IN_WORDS, NAME_RULE, Holder, SignedMembers, is_name
from zswarm.security.requests import Request, alternative_names
from zswarm.system.files import make_private, write_whole

AUTHORITY_LIFE = timedelta(days=5 * 365)
SKEW = timedelta(minutes=5)  # by which a machine's clock may be late


class Authority:
    """The authority in a folder, opened by one program at a time, as a context manager."""

    def __init__(self, folder: Path, *, now: datetime | None = None) -> None:
        key, certificate = folder / KEY, folder / AUTHORITY
        if not key.exists():
            remedy = "zswarm-keys init makes one, --authority DIR names its folder"
            raise KeysError(f"{folder}: no authority here; {remedy}")
        self.folder = folder
        self._now = now or datetime.now(UTC)
        with contextlib.ExitStack() as stack:
            stack.enter_context(_locked(folder))
            self._pem = keyring.read(certificate)
            self.certificate = certificates.read_certificate(self._pem, f"{certificate}")
            self._key = certificates.read_key(keyring.read(key, secret=True), f"{key}")
            certificates.check_fits(self._key, self.certificate, f"{key}")
            certificates.check_authority(self.certificate, f"{certificate}")
            self.ledger = Ledger.read(folder / LEDGER)
            self._until_closed = stack.pop_all()
        self.fingerprint = certificates.fingerprint(self.certificate)

    @classmethod
    def create(cls, folder: Path, lab: str, *, now: datetime | None = None) -> Self:
        """Make a new authority.

        Args:
            folder: made, for its owner alone.
            lab: a name of the lab, for people.
            now: for tests.
        """
        if not is_name(lab):
            raise KeysError(f"the lab's name {lab[:80]!r}: {NAME_RULE}")
        make_private(folder, (KEY, AUTHORITY, LEDGER))
        with _locked(folder):
            if (folder / KEY).exists():
                text = "there is an authority already, for all keys of the lab"
                raise KeysError(f"{folder}: {text}; --authority DIR makes another")
            key = certificates.new_key()
            begin = now or datetime.now(UTC)
            name = f"authority.{lab}"
            certificate = certificates.build(
                name,
                key.public_key(),
                certificates.subject(name),
                key,
                (begin - SKEW, begin + AUTHORITY_LIFE),
                None,
            )
            Ledger().write(folder / LEDGER)
            write_whole(folder / AUTHORITY, certificate.public_bytes(Encoding.PEM))
            # The key is last: where it is, all files are.
            write_whole(folder / KEY, certificates.key_pem(key), 0o600)
        return cls(folder, now=now)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._until_closed.close()

    def members(self) -> SignedMembers:
        """Return the signed list of members."""
        return certificates.sign(self.ledger.members(self.fingerprint), self._key)

    def list_of_members(self) -> Bundle:
        """Return the list as a bundle, for machines that have keys already."""
        return Bundle(authority=self._pem, members=self.members())

    def known(self, name: str) -> Issued:
        """Return the last certificate of the holder of a name."""
        found = self.ledger.of(name)
        if found is None:
            similar = nearest(name, [issued.holder.name for issued in self.ledger.last()])
            raise KeysError(
                f"no keys were issued to {name!r}{similar}; zswarm-keys status lists all holders"
            )
        return found

    def check_new(self, holders: Sequence[Holder]) -> None:
        """Refuse names that are taken, and servers whose names would overlap.

        Access rules let a server use ids that begin with its name and ``-``.
        """
        for holder in holders:
            self._check_free(holder)
        servers = {*self.ledger.members().servers}
        servers |= {holder.name for holder in holders if holder.role == "ss"}
        for short, name in itertools.permutations(sorted(servers), 2):
            if name.startswith(f"{short}-"):
                raise KeysError(
                    f"the servers {short} and {name} could not be told apart: a server's name must "
                    "not begin with the name of another and -"
                )

    def _check_free(self, holder: Holder) -> None:
        previous = self.ledger.of(holder.name)
        if previous is None:
            return
        role = previous.holder.role
        if role != holder.role:
            raise KeysError(
                f"{holder.name} is the name of a {IN_WORDS[role]} already: take another"
            )
        if previous.revoked_at is None:
            text = f"{holder} has keys already, until {previous.not_after:%Y-%m-%d}"
            raise KeysError(f"{text}: zswarm-keys renew {holder.name} makes new ones")
        common_name = holder.common_name
        end = max(
            each.not_after
            for each in self.ledger.issued
            if each.common_name == common_name
        )
        if end > self._now:
            other = f"{holder.name[: keys.MAX_NAME - 2]}-2"
            raise KeysError(
                f"{holder} was revoked, and the revoked keys would be let in again under this name "
                f"until {end:%Y-%m-%d}: take another, such as {other}"
            )

    def issue(self, wanted: dict[Holder, list[str]], days: int) -> list[Bundle]:
        """Issue new keys; return a bundle for each holder.

        Args:
            wanted: addresses, besides its own names, by holder.
            days: they are valid; not longer than the authority.
        """
        self.check_new(list(wanted))
        asked = []
        for holder, addresses in wanted.items():
            key = certificates.new_key()
            asked.append(
                Request(
                    holder, alternative_names(holder, addresses), key.public_key(), key
                )
            )
        return self._issue(asked, days)

    def sign(self, request: Request, days: int) -> Bundle:
        """Sign or renew the certificate of a key that never left its machine."""
        previous, public = self.ledger.of(request.holder.name), request.public_key
        known = previous and (previous.holder, previous.public_key, previous.revoked_at)
        if known != (request.holder, certificates.public_pem(public), None):
            self.check_new([request.holder])
        return self._issue([request], days)[0]

    def renew(self, names: Sequence[str], days: int) -> list[Bundle]:
        """Issue new certificates, and new keys except for those that never left their machine."""
        asked = []
        for previous in map(self.known, names):
            holder, pem = previous.holder, previous.public_key
            if previous.revoked_at:
                text = f"{holder} was revoked on {previous.revoked_at:%Y-%m-%d}"
                raise KeysError(f"{text}: issue keys under another name")
            if pem:
                public = certificates.read_public(pem, f"{self.folder / LEDGER}")
                key = None
            else:
                key = certificates.new_key()
                public = key.public_key()
            asked.append(Request(holder, previous.names, public, key))
        return self._issue(asked, days)

    def revoke(self, names: Sequence[str]) -> None:
        """Remove holders from the members."""
        revoked = set()
        for previous in map(self.known, names):
            if previous.revoked_at:
                raise KeysError(
                    f"{previous.holder} was revoked already, on {previous.revoked_at:%Y-%m-%d}"
                )
            revoked.add(previous.common_name)
        entries = []
        for entry in self.ledger.issued:
            if entry.common_name in revoked and not entry.revoked_at:
                entry = msgspec.structs.replace(entry, revoked_at=self._now)
            entries.append(entry)
        self._write(entries)

    def _issue(self, asked: Sequence[Request], days: int) -> list[Bundle]:
        begin = max(self._now - SKEW, self.certificate.not_valid_before_utc)
        end = min(self._now + timedelta(days=days), self.certificate.not_valid_after_utc)
        signed, entries = [], []
        for request in asked:
            certificate = certificates.build(
                request.holder.common_name,
                request.public_key,
                self.certificate.subject,
                self._key,
                (begin, end),
                request.names,
            )
            entry = Issued(
                common_name=request.holder.common_name,
                serial=f"{certificate.serial_number:x}",
                names=request.names,
                not_after=certificate.not_valid_after_utc,
                public_key=""
                if request.key
                else certificates.public_pem(request.public_key),
            )
            signed.append(certificate.public_bytes(Encoding.PEM).decode())
            entries.append(entry)
        # First: no certificate is unrecorded.
        self._write([*self.ledger.issued, *entries])
        members = self.members()
        return [
            Bundle(
                authority=self._pem,
                certificate=pem,
                key=certificates.key_pem(request.key).decode() if request.key else "",
                members=members,
            )
            for request, pem in zip(asked, signed, strict=True)
        ]

    def _write(self, issued: list[Issued]) -> None:
        ledger = self.ledger.replaced(issued)
        ledger.write(self.folder / LEDGER)
        self.ledger = ledger


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    opened = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise KeysError(
            f"{folder}: another zswarm-keys works on it: try again when it is done"
        ) from None
    finally:
        os.close(opened)
