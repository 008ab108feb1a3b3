"""Counters of a run's servers, updated by each change of one: no event visits all servers."""

import itertools
from collections import Counter, OrderedDict
from collections.abc import Iterator

import msgspec

from zswarm.ot.cluster.remote_server import Phase, RemoteServer, Standing

NAMED = 5  # servers that prepare, in a standing
# A server without a token is remembered for at least this time, since its lease may be resumed;
# after it, the lease has expired. A server that is restarted has another id.
FORGET_S = 120.0

# Of a server: phase, slots, ready ones, taken ones, machine, and whether it is partial.
ServerCounts = tuple[Phase, int, int, int, str, bool]


class Roster(msgspec.Struct, eq=False):
    """The servers of a run, by what they hold."""

    phases: Counter[Phase] = msgspec.field(default_factory=Counter)
    waiting: dict[str, RemoteServer] = {}  # LEASED, without a slot
    preparing: dict[str, RemoteServer] = {}  # LEASED, with slots, none of them ready
    ready: dict[str, RemoteServer] = {}  # LEASED, with a slot ready
    partial: dict[
        str, RemoteServer
    ] = {}  # LEASED, asked for fewer slots than its capacity
    slots: int = 0  # ready
    granted: int = 0  # slots
    taken: int = 0  # slots, granted or asked for
    own: set[str] = (
        set()
    )  # this machine's servers; one that is started again has another id
    machines: Counter[str] = msgspec.field(default_factory=Counter)  # taken, by machine
    _counted: dict[str, ServerCounts] = {}
    # IDLE and without a token, since when; the longest in front.
    _absent: OrderedDict[str, tuple[float, RemoteServer]] = msgspec.field(
        default_factory=OrderedDict
    )

    def update(self, server: RemoteServer) -> None:
        """Count a server as it is now."""
        is_leased = server.phase == Phase.LEASED
        slots, ready = (server.slots, server.ready) if is_leased else (0, 0)
        is_partial = is_leased and server.wanted < server.capacity
        taken, machine = server.taken(), server.machine
        counted = server.phase, slots, ready, taken, machine, is_partial
        before = self._counted.get(server.id)
        if counted == before:
            return
        self._add(before, -1)
        self._counted[server.id] = counted
        self._add(counted, 1)
        for names, belongs in (
            (self.waiting, is_leased and not slots),
            (self.preparing, bool(slots and not ready)),
            (self.ready, bool(ready)),
            (self.partial, is_partial),
        ):
            if belongs:
                names[server.id] = server
            else:
                names.pop(server.id, None)

    def came(self, name: str) -> None:
        """Take note of a server's token."""
        self._absent.pop(name, None)

    def remember(self, server: RemoteServer, now: float) -> Iterator[RemoteServer]:
        """Remember an IDLE server without a token for a while, and yield those to forget."""
        self._absent[server.id] = now, server
        self._absent.move_to_end(server.id)
        while next(iter(self._absent.values()))[0] <= now - FORGET_S:
            _, oldest = self._absent.popitem(last=False)[1]
            if oldest.phase == Phase.IDLE:
                self._add(self._counted.pop(oldest.id, None), -1)
                yield oldest

    def standing(self, probe: bytes) -> Standing:
        """Return how the run stands with its servers."""
        first = next(iter(self.preparing.values()), None)
        return Standing(
            serving=len(self.ready),
            preparing=list(itertools.islice(self.preparing, NAMED)),
            progress=first.progress if first is not None else None,
            leased=self.phases[Phase.LEASED],
            spare=self.phases[Phase.SPARE],
            slots=self.slots,
            probe=probe,
            own=frozenset(self.own),
        )

    def computing(self) -> Iterator[RemoteServer]:
        """Iterate over the servers that can evaluate, or will once a slot is prepared."""
        return itertools.chain(self.ready.values(), self.preparing.values())

    def _add(self, counted: ServerCounts | None, sign: int) -> None:
        if counted is not None:
            phase, slots, ready, taken, machine, _ = counted
            self.phases[phase] += sign
            self.granted += sign * slots
            self.slots += sign * ready
            self.taken += sign * taken
            if taken:
                self.machines[machine] += sign * taken
