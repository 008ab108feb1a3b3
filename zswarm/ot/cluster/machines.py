"""The machines of servers: what a server did wrong is held against its machine.

A machine may be many servers: a server that is restarted has another id, and several may run at a
time. With keys, a machine is the name in the certificate of its servers, to which access rules tie
their ids; without, the address that was dialled, or the name in the id where that is not known.
"""

import re
from collections import Counter
from collections.abc import Collection, Mapping

import msgspec

THIS = "this machine"  # which runs the optimizer: no id and no address
# A machine is faulty on which this many trials failed that others could evaluate, and this share
# of all it evaluated.
BLAMED = 3
BLAMED_SHARE = 0.01

_ID = re.compile(r"(.+)-[0-9a-f]{8}")
_HOST = re.compile(r"(?:tcp|udp|ws|tls|quic)/\[?([^/]+?)\]?:[0-9]+")


class Known(msgspec.Struct, frozen=True):
    """What is known of machines when a run begins or resumes."""

    machines: Mapping[str, str] = {}  # by the ids of servers that were used
    banned: Mapping[str, str] = {}  # by machine: its server that computed wrong
    arbitrated: bytes = b""  # digest of the probe that this machine played


class Machines(msgspec.Struct, eq=False):
    """The machines of a run's servers."""

    banned: dict[str, str] = {}  # by machine: its server that computed wrong
    counted: Counter[str] = msgspec.field(default_factory=Counter)  # trials, by machine
    blamed: Counter[str] = msgspec.field(default_factory=Counter)  # failed here only
    _by_server: dict[str, str] = {}  # those that were used

    def of(self, server: str) -> str:
        """Return the machine of a server; one that was not used is taken by its name."""
        return self._by_server.get(server) or name_of(server)

    def use(self, server: str, machine: str) -> None:
        """Remember the machine of a server that is used."""
        self._by_server.setdefault(server, machine)

    def servers(self, machine: str) -> list[str]:
        """Return the servers of a machine that were used."""
        return [server for server, of in self._by_server.items() if of == machine]

    def fails_too_much(self, machine: str) -> bool:
        """Return whether too many trials failed here that other machines could evaluate."""
        most = max(BLAMED, BLAMED_SHARE * self.counted[machine])
        return self.blamed[machine] >= most

    @classmethod
    def after(cls, known: Known) -> "Machines":
        """Return the machines of a run that resumes."""
        return cls(banned=dict(known.banned), _by_server=dict(known.machines))


def name_of(server: str, members: Collection[str] = ()) -> str:
    """Return the name in a server's id, without the part that is new at each start.

    Args:
        members: names of the servers that have certificates. None of them begins with another one
            and ``-``, so an id belongs to one.
    """
    parts = server.split("-") if members else []
    names = ("-".join(parts[:count]) for count in range(1, len(parts)))
    found = _ID.fullmatch(server)
    short = found[1] if found else server
    return next((name for name in names if name in members), short)


def machine(server: str, address: str, local: str, members: Collection[str]) -> str:
    """Return the machine of a server that answered.

    Args:
        address: of the link to it, as zenoh has it; "": it is not known, as through a router.
        local: endpoint of this machine's own slots; "": there are none.
        members: names of the servers that have certificates; none: the link is in the clear.
    """
    if local and address == local:
        return THIS
    if not members and (found := _HOST.fullmatch(address)):
        return found[1]
    return name_of(server, members)
