"""Which servers a run asks for how many slots, and which of them it releases.

A run wants as many slots as it has trials at once, or ``max_slots`` if these are fewer, of all
servers together. It asks

- the servers with the fewest setbacks since they sent an outcome,
- of these the ones that rank first by ``[cluster] rank``; without a ranking those with free slots,
- of equal ones first this machine's, which no other run can use, then in an order that is another
  one for each run, so that runs do not meet on the same servers,
- and further ones while those that it asked grant fewer slots than it wants. Servers without a free
  slot are asked once a second, as many as could grant what is missing.

Held slots stay. The servers that come last are released when more is held than wanted: a server
that had no slot may grant some late. With ``verify`` a run has one slot more than trials at once,
and no machine gets all of them: a second one is to check outcomes.
"""

import bisect
import hashlib
import math

import msgspec

from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.remote_server import Phase, RemoteServer
from zswarm.ot.cluster.roster import Roster

# From the first offer until slots are allotted, at most; and between two rounds in which servers
# without a free slot are asked.
ALLOT_AFTER_S = 1.0


class Allotment(msgspec.Struct, eq=False):
    """The slots that a run wants, of all servers together."""

    terms: Terms
    roster: Roster
    paused: bool = False  # the run wants no slots now
    at: float = math.inf  # no slots are to be allotted before
    _spare: list[tuple[tuple[object, ...], RemoteServer]] = []  # in order
    _full_at: float = -math.inf  # servers without a free slot are asked again then

    def limit(self) -> int:
        """Return how many slots the run wants."""
        if self.paused:
            return 0
        slots, most = self.terms.reserve.slots, self.terms.choice.max_slots
        slots += bool(self.terms.verify)
        return min(slots, most) if most else slots

    def room(self) -> int:
        """Return how many slots are missing; less than 0: so many are too many."""
        return self.limit() - self.roster.taken

    # ---- servers

    def offered(self, server: RemoteServer, free: int, now: float) -> None:
        """Take an offer; wait a moment for those of others."""
        server.free = free
        known = hashlib.blake2b(self.terms.reserve.nonce + server.id.encode())
        server.lot = known.digest()[:8]
        # The server itself is still counted as SEEN.
        wait = self.terms.choice.max_slots or self.roster.phases[Phase.SEEN] > 1
        self.at = min(self.at, now + ALLOT_AFTER_S) if wait else 0.0

    def follow(self, server: RemoteServer, was: Phase) -> None:
        """Follow a server that moved, and come back to the slots if some were freed."""
        if was == Phase.SPARE:
            self._remove(server)
        if server.phase == Phase.SPARE:
            bisect.insort(self._spare, (self._order(server), server), key=_first)
        if {Phase.RESERVING, Phase.LEASED} & {was, server.phase}:
            self.at = 0.0
        elif was == Phase.SEEN and self._spare and not self.terms.choice.max_slots:
            self.at = self.at if self.roster.phases[Phase.SEEN] else 0.0

    def granted(self, server: RemoteServer) -> None:
        """Allot again, since a server granted slots, perhaps fewer than it was asked for."""
        if server.slots < server.wanted:
            server.free = 0
        self.at = 0.0

    # ---- choices

    def surplus(self) -> RemoteServer | None:
        """Return a server that is to be released: the last one; None if there is none."""
        roster, order = self.roster, self._order
        too_many = self.room() < 0
        if not too_many and (not roster.waiting or roster.granted < self.limit()):
            return None
        with_slots = [*roster.ready.values(), *roster.preparing.values()]
        if too_many and with_slots:
            return max(with_slots, key=order)
        if not roster.waiting or roster.granted < self.limit():
            return None
        last = max(roster.waiting.values(), key=lambda server: server.place)
        # One that ranks first may still replace the others.
        better = any(last.place < server.place for server in with_slots)
        return None if better else last

    def choose(self, now: float) -> tuple[RemoteServer, int] | None:
        """Return the server to ask next, and for how many slots; None if there is none."""
        room = self.room()
        if room <= 0 or not self._spare:
            return None
        spare = (server for _, server in self._spare if self._most(server) > 0)
        server = next(spare, None)
        if server is None:
            return None
        if self._full(server) and now < self._full_at:
            self.at = self._full_at
            return None
        return server, min(room, self._most(server))

    def rounds(self, now: float) -> None:
        """End a round: ask servers without a free slot again after a while only."""
        if now >= self._full_at:
            self._full_at = now + ALLOT_AFTER_S

    def partial(self) -> tuple[RemoteServer, int] | None:
        """Return a leased server that can give more, and how many slots to want of it."""
        room = self.room()
        if room <= 0 or self._spare:
            return None
        for server in self.roster.partial.values():
            most = min(server.capacity, server.wanted + self._most(server))
            if server.slots == server.wanted < most:
                return server, min(most, server.wanted + room)
        return None

    def _most(self, server: RemoteServer) -> int:
        """Return how many slots a server, besides those it has, may get."""
        most = self.terms.reserve.slots - server.taken()
        if self.terms.verify:
            most = self.terms.reserve.slots - self.roster.machines[server.machine]
        return min(server.capacity, most)

    def _order(self, server: RemoteServer) -> tuple[object, ...]:
        first = server.setbacks, self._full(server), server.place, not server.own
        return *first, server.lot, server.id

    def _full(self, server: RemoteServer) -> bool:
        return not server.free and not self.terms.choice.rank

    def _remove(self, server: RemoteServer) -> None:
        index = bisect.bisect_left(self._spare, self._order(server), key=_first)
        if index < len(self._spare) and self._spare[index][1] is server:
            del self._spare[index]


def _first(entry: tuple[tuple[object, ...], RemoteServer]) -> tuple[object, ...]:
    return entry[0]
