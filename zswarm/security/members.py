"""Who is let in: holders of keys by role and name, and the list of them that the lab's authority signs."""

from typing import Annotated, Literal, NamedTuple, get_args

import msgspec

from zswarm.protocol import keys

Role = Literal["ss", "ot", "router"]
ROLES: tuple[Role, ...] = get_args(Role)
IN_WORDS: dict[str, str] = {"ss": "server", "ot": "user", "router": "router"}
Name = Annotated[str, msgspec.Meta(pattern=rf"^[a-z0-9][a-z0-9-]{{0,{keys.MAX_NAME - 1}}}\Z")]


class Holder(NamedTuple):
    """A server, a user of optimizers, or a router; its common name in a certificate is such as ``ss.lab-01``."""

    role: Role
    name: str

    @property
    def common_name(self) -> str:
        """As it stands in the certificate."""
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
        """The names of a role."""
        return {"ss": self.servers, "ot": self.users, "router": self.routers}[role]


class SignedMembers(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A list as it travels and stands in ``members.json``."""

    members: Members
    signature: str  # base64 of the authority's ECDSA signature


def is_name(text: str) -> bool:
    """Whether a holder may have this name."""
    return keys.is_id(text) and len(text) <= keys.MAX_NAME


def holder(common_name: str) -> Holder | None:
    """Whom a certificate's common name means; None: nobody of ours."""
    role, _, name = common_name.partition(".")
    for known in ROLES:
        if role == known and is_name(name):
            return Holder(known, name)
    return None
