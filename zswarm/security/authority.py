"""The lab's authority: it issues keys, knows whose they are, and signs who is let in.

Its folder holds ``authority.pem``, ``key.pem`` (whoever reads it can let anyone in) and ``issued.json``, the ledger.
"""

import contextlib
import fcntl
import ipaddress
import itertools
import os
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Annotated, NamedTuple, Self

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID

from zswarm.errors import ConfigError, KeysError
from zswarm.files import make_private, write_whole
from zswarm.nearest import nearest
from zswarm.protocol import keys
from zswarm.security import certificates, keyring
from zswarm.security.bundle import MEMBERS_FILE, SUFFIX, Bundle
from zswarm.security.members import IN_WORDS, Holder, Members, Role, SignedMembers, holder, is_name
from zswarm.strict import from_json

LEDGER = "issued.json"
AUTHORITY_LIFE = timedelta(days=5 * 365)
SKEW = timedelta(minutes=5)  # by which a machine's clock may be late
LOCAL = ("localhost", "127.0.0.1")  # in every certificate
HOST_NAME = re.compile(r"(?=.{1,253}\Z)[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?(\.[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?)*", re.I)


class Issued(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A certificate that the authority signed."""

    common_name: str
    serial: str  # hexadecimal
    names: list[str]  # and addresses, as in its SAN
    not_after: datetime
    revoked_at: datetime | None = None
    public_key: str = ""  # PEM, where the key never left its machine

    @property
    def holder(self) -> Holder:
        """Whose it is."""
        found = holder(self.common_name)
        if found is None:
            raise KeysError(f"{LEDGER}: {self.common_name!r} is nobody's name: damaged")
        return found


class Ledger(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everything that was issued, the last of each holder last."""

    number: Annotated[int, msgspec.Meta(ge=1)] = 1  # of the list of members
    issued: list[Issued] = []


class Request(NamedTuple):
    """What the holder of a key that never leaves its machine asks for."""

    holder: Holder
    names: list[str]
    public_key: ec.EllipticCurvePublicKey


class Authority:
    """Opened by one program at a time: ``with Authority(folder) as authority``."""

    def __init__(self, folder: Path, *, now: datetime | None = None) -> None:
        if not (folder / certificates.KEY).exists():
            raise KeysError(f"{folder}: no authority here; zswarm-keys init makes one, --authority DIR says where it is")
        self.folder = folder
        self._now = now or datetime.now(UTC)
        with contextlib.ExitStack() as stack:
            stack.enter_context(_locked(folder))
            where = f"{folder}/"
            pem = keyring.read(folder / certificates.AUTHORITY)
            self.certificate = certificates.read_certificate(pem, where + certificates.AUTHORITY)
            key_pem = keyring.read(folder / certificates.KEY, secret=True)
            self._key = certificates.read_key(key_pem, where + certificates.KEY)
            if not certificates.fits(self._key, self.certificate):
                raise KeysError(f"{where}{certificates.KEY}: not the key of {certificates.AUTHORITY} beside it")
            certificates.check_authority(self.certificate, where + certificates.AUTHORITY)
            self.ledger = _read_ledger(folder / LEDGER)
            self._until_closed = stack.pop_all()
        self._pem = pem.decode()
        self.fingerprint = certificates.fingerprint(self.certificate)

    @classmethod
    def create(cls, folder: Path, lab: str, *, now: datetime | None = None) -> Self:
        """A new authority.

        Args:
            folder: made, for its owner alone.
            lab: a name for people, as those of holders.
            now: for tests.

        Raises:
            ConfigError: there is one already, the folder holds other files, or no such name can be given.
            OSError: the folder cannot be written.
        """
        if not is_name(lab):
            raise KeysError(f"the lab's name {lab[:80]!r}: expected 1 to {keys.MAX_NAME} of a-z, 0-9 and -, not starting with -")
        make_private(folder, (certificates.KEY, certificates.AUTHORITY, LEDGER))
        with _locked(folder):
            if (folder / certificates.KEY).exists():
                raise KeysError(
                    f"{folder}: there is an authority already, for all keys of the lab; --authority DIR makes another"
                )
            cls._make(folder, lab, now or datetime.now(UTC))
        return cls(folder, now=now)

    @staticmethod
    def _make(folder: Path, lab: str, begin: datetime) -> None:
        key = certificates.new_key()
        name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, f"authority.{lab}")])
        certificate = (
            _builder(name, name, key.public_key(), key.public_key())
            .not_valid_before(begin - SKEW)
            .not_valid_after(begin + AUTHORITY_LIFE)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs_certificates=True), critical=True)
            .sign(key, certificates.HASH())
        )
        write_whole(folder / LEDGER, msgspec.json.encode(Ledger()))
        write_whole(folder / certificates.AUTHORITY, certificate.public_bytes(serialization.Encoding.PEM))
        write_whole(folder / certificates.KEY, certificates.key_pem(key), 0o600)  # last: where it is, all is

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._until_closed.close()

    def last(self) -> list[Issued]:
        """The last certificate of each holder, in the order they were first issued."""
        return _last(self.ledger)

    def members(self) -> SignedMembers:
        """Who is let in, signed."""
        return certificates.sign(_members(self.ledger, self.fingerprint), self._key)

    def list_of_members(self) -> Bundle:
        """The same, for machines that have keys already."""
        return Bundle(authority=self._pem, members=self.members())

    def known(self, name: str) -> Issued:
        """The last certificate of the holder of a name.

        Raises:
            KeysError: nobody has it.
        """
        found = self._of(name)
        if found is None:
            names = [issued.holder.name for issued in self.last()]
            raise KeysError(f"no keys were issued to {name!r}{nearest(name, names)}; zswarm-keys status shows to whom there were")
        return found

    def check_free(self, whose: Holder) -> None:
        """Refuse a name that was given before.

        Raises:
            KeysError: that.
        """
        before = self._of(whose.name)
        if before is None:
            return
        if before.holder.role != whose.role:
            raise KeysError(f"{whose.name} is the name of a {IN_WORDS[before.holder.role]} already: take another")
        if before.revoked_at is None:
            raise KeysError(
                f"{whose} has keys already, until {before.not_after:%Y-%m-%d}: zswarm-keys renew {whose.name} makes new ones"
            )
        end = max(issued.not_after for issued in self.ledger.issued if issued.common_name == whose.common_name)
        if end > self._now:
            raise KeysError(
                f"{whose} was revoked, and the revoked keys would be let in again under this name until {end:%Y-%m-%d}:"
                f" take another, such as {whose.name[: keys.MAX_NAME - 2]}-2"
            )

    def issue(self, wanted: dict[Holder, list[str]], days: int) -> list[Bundle]:
        """New keys, one bundle each.

        Args:
            wanted: holders, each with addresses beside its own names.
            days: they are valid; not longer than the authority.

        Raises:
            KeysError: a name was given before, or cannot be given.
        """
        for whose in wanted:
            self.check_free(whose)
        _refuse_within([*self.members().members.servers, *(whose.name for whose in wanted if whose.role == "ss")])
        asked = []
        for whose, addresses in wanted.items():
            key = certificates.new_key()
            asked.append((Request(whose, alternative_names(whose, addresses), key.public_key()), key))
        return self._issue(asked, days)

    def sign(self, request: Request, days: int) -> Bundle:
        """A certificate for a key that never left its machine; one that it had before is renewed.

        Raises:
            KeysError: the name was given before, to another key.
        """
        before = self._of(request.holder.name)
        same = (request.holder.common_name, certificates.public_pem(request.public_key), None)
        if before is None or (before.common_name, before.public_key, before.revoked_at) != same:
            self.check_free(request.holder)
            _refuse_within([*self.members().members.servers, *([request.holder.name] if request.holder.role == "ss" else [])])
        return self._issue([(request, None)], days)[0]

    def renew(self, names: Sequence[str], days: int) -> list[Bundle]:
        """New certificates of the same names and addresses, with new keys except for those that never left their machine.

        Raises:
            KeysError: an unknown name, or a revoked one.
        """
        asked: list[tuple[Request, ec.EllipticCurvePrivateKey | None]] = []
        for before in [self.known(name) for name in names]:
            if before.revoked_at:
                raise KeysError(f"{before.holder} was revoked on {before.revoked_at:%Y-%m-%d}: issue keys under another name")
            key = None if before.public_key else certificates.new_key()
            public = key.public_key() if key else certificates.read_public(before.public_key, f"{self.folder / LEDGER}")
            asked.append((Request(before.holder, before.names, public), key))
        return self._issue(asked, days)

    def revoke(self, names: Sequence[str]) -> None:
        """They are members no more.

        Raises:
            KeysError: an unknown name, or one revoked before.
        """
        revoked = [self.known(name) for name in names]
        for before in revoked:
            if before.revoked_at:
                raise KeysError(f"{before.holder} was revoked already, on {before.revoked_at:%Y-%m-%d}")
        lost = {before.common_name for before in revoked}
        self._write(
            [
                msgspec.structs.replace(issued, revoked_at=issued.revoked_at or self._now)
                if issued.common_name in lost
                else issued
                for issued in self.ledger.issued
            ]
        )

    def _issue(self, asked: Sequence[tuple[Request, ec.EllipticCurvePrivateKey | None]], days: int) -> list[Bundle]:
        """Sign; without a key it is on its machine already."""
        end = min(self._now + timedelta(days=days), self.certificate.not_valid_after_utc)
        signed = [self._certificate(request, end) for request, _ in asked]
        entries = [
            Issued(
                common_name=request.holder.common_name,
                serial=f"{certificate.serial_number:x}",
                names=request.names,
                not_after=certificate.not_valid_after_utc,
                public_key="" if key else certificates.public_pem(request.public_key),
            )
            for (request, key), certificate in zip(asked, signed, strict=True)
        ]
        self._write([*self.ledger.issued, *entries])  # first: whatever was signed is known
        members = self.members()
        return [
            Bundle(
                authority=self._pem,
                certificate=certificate.public_bytes(serialization.Encoding.PEM).decode(),
                key=certificates.key_pem(key).decode() if key else "",
                members=members,
            )
            for (_, key), certificate in zip(asked, signed, strict=True)
        ]

    def _certificate(self, request: Request, end: datetime) -> x509.Certificate:
        subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, request.holder.common_name)])
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        return (
            _builder(subject, self.certificate.subject, request.public_key, self._key.public_key())
            .not_valid_before(max(self._now - SKEW, self.certificate.not_valid_before_utc))
            .not_valid_after(end)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(_alternatives(request.names), critical=False)
            .sign(self._key, certificates.HASH())
        )

    def _write(self, issued: list[Issued]) -> None:
        ledger = Ledger(number=self.ledger.number, issued=issued)
        if _members(ledger, "") != _members(self.ledger, ""):
            ledger = msgspec.structs.replace(ledger, number=ledger.number + 1)
        write_whole(self.folder / LEDGER, msgspec.json.format(msgspec.json.encode(ledger)) + b"\n", 0o600)
        self.ledger = ledger

    def _of(self, name: str) -> Issued | None:
        return next((issued for issued in self.last() if issued.holder.name == name), None)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    opened = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise KeysError(f"{folder}: another zswarm-keys works on it: try again when it is done") from None
    finally:
        os.close(opened)


def new_holder(role: Role, name: str) -> Holder:
    """Who is to have keys.

    Raises:
        KeysError: no such name can be given.
    """
    if not is_name(name):
        folded = keys.fold(name)
        hint = f"; {folded} would be one" if folded != "x" else ""
        raise KeysError(
            f"{IN_WORDS[role]} {name[:80]!r}: expected 1 to {keys.MAX_NAME} of a-z, 0-9 and -, not starting with -{hint}"
        )
    if f"{name}{SUFFIX}" == MEMBERS_FILE:
        raise KeysError(f"{IN_WORDS[role]} {name}: that is the name of the list's file: take another")
    return Holder(role, name)


def alternative_names(whose: Holder, addresses: Sequence[str]) -> list[str]:
    """Under which a holder may be dialled: its own names, if it is dialled by them, and addresses.

    Raises:
        KeysError: an address is none.
    """
    own = () if whose.role == "ot" else (whose.name, f"{whose.name}.local")
    return list(dict.fromkeys([*own, *LOCAL, *(_address(whose, text) for text in addresses)]))


def make_request(whose: Holder, addresses: Sequence[str], key: ec.EllipticCurvePrivateKey) -> bytes:
    """A request (PKCS #10, PEM) that ``read_request`` reads.

    Raises:
        KeysError: an address is none.
    """
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, whose.common_name)])
    builder = x509.CertificateSigningRequestBuilder(subject).add_extension(
        _alternatives(alternative_names(whose, addresses)), critical=False
    )
    return builder.sign(key, certificates.HASH()).public_bytes(serialization.Encoding.PEM)


def read_request(path: Path) -> Request:
    """What is asked for; names and addresses are checked as those of ``issue``.

    Raises:
        KeysError: damaged, another file, or not signed by the key that it is for.
    """
    body = keyring.read(path)
    try:
        with certificates.warned():
            request = x509.load_pem_x509_csr(body)
            common_name, public = certificates.common_name(request.subject), request.public_key()
            sound = request.is_signature_valid and certificates.is_ours(public)
            alternatives = request.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (x509.ExtensionNotFound, *certificates.UNREADABLE):
        raise KeysError(f"{path}: no request of zswarm-keys: damaged, or another file") from None
    found = holder(common_name)
    if found is None or not sound:
        raise KeysError(f"{path}: no request that zswarm-keys request made")
    whose = new_holder(*found)
    texts = [str(name.value) for name in alternatives]
    own = alternative_names(whose, [])
    names = alternative_names(whose, [text for text in texts if text not in own])
    return Request(whose, names, certificates.public_key(request))


def _address(whose: Holder, text: str) -> str:
    try:
        return str(ipaddress.ip_address(text))
    except ValueError:
        pass
    if not HOST_NAME.fullmatch(text) or text.rpartition(".")[2].isdigit():
        raise KeysError(
            f"address {text[:80]!r} of {whose}: expected an address such as 10.0.0.5, or a host's name without wildcards"
        )
    return text.lower()


def _alternatives(names: Sequence[str]) -> x509.SubjectAlternativeName:
    found: list[x509.GeneralName] = []
    for name in names:
        try:
            found.append(x509.IPAddress(ipaddress.ip_address(name)))
        except ValueError:
            found.append(x509.DNSName(name))
    return x509.SubjectAlternativeName(found)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, issuer_key: ec.EllipticCurvePublicKey
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key), critical=False)
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True, key_cert_sign=signs_certificates, crl_sign=signs_certificates, content_commitment=False,
        key_encipherment=False, data_encipherment=False, key_agreement=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip


def _last(ledger: Ledger) -> list[Issued]:
    return list({issued.common_name: issued for issued in ledger.issued}.values())


def _members(ledger: Ledger, fingerprint: str) -> Members:
    holders = [issued.holder for issued in _last(ledger) if issued.revoked_at is None]
    names = {role: sorted(holder.name for holder in holders if holder.role == role) for role in IN_WORDS}
    return Members(
        authority=fingerprint, number=ledger.number, servers=names["ss"], users=names["ot"], routers=names["router"]
    )  # fmt: skip


def _read_ledger(path: Path) -> Ledger:
    try:
        ledger = from_json(keyring.read(path), Ledger, str(path))
    except KeysError:
        raise
    except ConfigError as error:
        raise KeysError(f"{error}: damaged; bring it back from a copy") from None
    for issued in ledger.issued:
        _ = issued.holder
    return ledger


def _refuse_within(servers: Sequence[str]) -> None:
    """Refuse a server's name that is another's and more: rules let a server speak as its name, ``-`` and anything.

    Raises:
        KeysError: that.
    """
    for short, name in itertools.permutations(sorted(set(servers)), 2):
        if name.startswith(f"{short}-"):
            raise KeysError(
                f"the servers {short} and {name} could not be told apart: no server's name may begin with another's and -"
            )
