"""The ledger of an authority, ``issued.json``: every certificate that it signed."""

from datetime import datetime
from pathlib import Path
from typing import Annotated, Self

import msgspec

from zswarm.config.decode import from_json
from zswarm.errors import ConfigError, KeysError
from zswarm.security import keyring
from zswarm.security.members import IN_WORDS, Holder, Members
from zswarm.system.files import write_whole

LEDGER = "issued.json"


class Issued(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A certificate that the authority signed."""

    common_name: str
    serial: str  # hexadecimal
    names: list[str]  # and addresses, as in its SAN
    not_after: datetime
    revoked_at: datetime | None = None
    public_key: str = ""  # PEM, if the key never left its machine

    @property
    def holder(self) -> Holder:
        """The holder of the certificate."""
        found = Holder.parse(self.common_name)
        if found is None:
            raise KeysError(
                f"{LEDGER}: {self.common_name!r} is not the name of a holder: damaged"
            )
        return found


class Ledger(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everything that was issued; later certificates of a holder replace earlier ones."""

    number: Annotated[int, msgspec.Meta(ge=1)] = 1  # of the list of members
    issued: list[Issued] = []

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a ledger."""
        body = keyring.read(path)
        try:
            ledger = from_json(body, cls, str(path))
        except ConfigError as error:
            raise KeysError(f"{error}: damaged; restore it from a copy") from None
        for issued in ledger.issued:
            _ = issued.holder
        return ledger

    def write(self, path: Path) -> None:
        """Write it, for its owner alone."""
        write_whole(path, msgspec.json.format(msgspec.json.encode(self)) + b"\n", 0o600)

    def last(self) -> list[Issued]:
        """Return the last certificate of each holder, in the order they were first issued."""
        return list({issued.common_name: issued for issued in self.issued}.values())

    def of(self, name: str) -> Issued | None:
        """Return the last certificate of the holder of a name."""
        return next(
            (issued for issued in self.last() if issued.holder.name == name), None
        )

    def members(self, authority: str = "") -> Members:
        """Return the members: the holders that were not revoked.

        Args:
            authority: its fingerprint.
        """
        holders = [issued.holder for issued in self.last() if issued.revoked_at is None]
        servers, users, routers = (
            sorted(each.name for each in holders if each.role == role)
            for role in IN_WORDS
        )
        return Members(
            authority=authority,
            number=self.number,
            servers=servers,
            users=users,
            routers=routers,
        )

    def replaced(self, issued: list[Issued]) -> "Ledger":
        """Return the ledger with other entries; the number grows if the members change."""
        new = Ledger(number=self.number, issued=issued)
        changed = new.members() != self.members()
        return msgspec.structs.replace(new, number=self.number + changed)
