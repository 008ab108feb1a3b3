"""The members: holders of keys by role and name, in a list that the lab's authority signs."""

from typing import Annotated, Literal, NamedTuple, Self

import msgspec

from zswarm.errors import KeysError
from zswarm.protocol import keys

Role = Literal["ss", "ot", "router"]
IN_WORDS: dict[Role, str] = {"ss": "server", "ot": "user", "router": "router"}
NAME_RULE = f"expected 1 to {keys.MAX_NAME} of a-z, 0-9 and -, not starting with -"
MEMBERS = "members"  # name of the file with the list
Name = Annotated[
    str, msgspec.Meta(pattern=rf"^{keys.ID.pattern}\Z", max_length=keys.MAX_NAME)
]


class Holder(NamedTuple):
    """A server, a user of optimizers, or a router."""

    role: Role
    name: str

    @classmethod
    def parse(cls, common_name: str) -> Self | None:
        """Return the holder with a common name; None if the name is not valid."""
        role, _, name = common_name.partition(".")
        return next(
            (cls(each, name) for each in IN_WORDS if each == role and is_name(name)), None
        )

    @property
    def common_name(self) -> str:
        """The common name in a certificate, such as ``ss.lab-01``."""
        return f"{self.role}.{self.name}"

    def __str__(self) -> str:
        return f"the {IN_WORDS[self.role]} {self.name}"


class Members(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The list that is signed."""

    authority: str  # fingerprint
    number: Annotated[int, msgspec.Meta(ge=1)]  # grows with every change
    servers: list[Name]
    users: list[Name]
    routers: list[Name]

    def of(self, role: Role) -> list[str]:
        """Return the names of a role."""
        return {"ss": self.servers, "ot": self.users, "router": self.routers}[role]

    def check(self, holder: Holder, where: str) -> None:
        """Refuse a holder that is not a member."""
        if holder.name not in self.of(holder.role):
            raise KeysError(
                f"{where}: {holder} is not, or no longer, among the members (list {self.number}): "
                "it was revoked"
            )


class SignedMembers(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """A signed list, as in ``members.json``."""

    members: Members
    signature: str  # base64 of the authority's ECDSA signature


def is_name(text: str) -> bool:
    """Return whether a holder may have this name."""
    return keys.is_id(text) and len(text) <= keys.MAX_NAME


def new_holder(role: Role, name: str) -> Holder:
    """Return the holder of a new certificate."""
    if not is_name(name):
        folded = keys.fold(name)
        hint = f"; {folded} would be valid" if folded != "x" else ""
        raise KeysError(f"{IN_WORDS[role]} {name[:80]!r}: {NAME_RULE}{hint}")
    if name == MEMBERS:
        raise KeysError(
            f"{IN_WORDS[role]} {name}: that is the name of the file of the members: take another"
        )
    return Holder(role, name)
