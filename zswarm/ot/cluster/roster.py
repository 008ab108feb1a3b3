"""Counters of a run's servers, updated by each change of one: no event visits all servers."""

import itertools
from collections import Counter
from collections.abc import Iterator

import msgspec

from zswarm.ot.cluster.remote_server import Phase, RemoteServer, Standing

NAMED = 5  # servers that prepare, in a standing


class Roster(msgspec.Struct, eq=False):
    """The servers of a run that hold slots, by what they hold."""

    phases: Counter[Phase] = msgspec.field(default_factory=Counter)
    leased: dict[str, RemoteServer] = {}
    waiting: dict[str, RemoteServer] = {}  # LEASED, without a slot
    preparing: dict[str, RemoteServer] = {}  # LEASED, with slots, none of them ready
    ready: dict[str, RemoteServer] = {}  # LEASED, with a slot ready
    partial: dict[str, RemoteServer] = {}  # LEASED, asked for fewer slots than it has
    slots: int = 0  # ready
    granted: int = 0  # slots
    taken: int = 0  # slots, granted or asked for
    machines: Counter[str] = msgspec.field(default_factory=Counter)  # taken, by machine
    _counted: dict[str, tuple[Phase, int, int, int, str]] = {}

    def update(self, server: RemoteServer) -> None:
        """Count a server as it is now."""
        self._add(self._counted.pop(server.id, None), -1)
        is_leased = server.phase == Phase.LEASED
        slots, ready = (server.slots, server.ready) if is_leased else (0, 0)
        counted = server.phase, slots, ready, server.taken(), server.machine
        self._counted[server.id] = counted
        self._add(counted, 1)
        for names, belongs in (
            (self.leased, is_leased),
            (self.waiting, is_leased and not slots),
            (self.preparing, bool(slots and not ready)),
            (self.ready, bool(ready)),
            (self.partial, is_leased and server.wanted < server.capacity),
        ):
            if belongs:
                names[server.id] = server
            else:
                names.pop(server.id, None)

    def forget(self, server: RemoteServer) -> None:
        """Count a server no more; it holds nothing."""
        self._add(self._counted.pop(server.id, None), -1)

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
        )

    def computing(self) -> Iterator[RemoteServer]:
        """Iterate over the servers that can evaluate, or will once a slot is prepared."""
        return itertools.chain(self.ready.values(), self.preparing.values())

    def _add(self, counted: tuple[Phase, int, int, int, str] | None, sign: int) -> None:
        if counted is not None:
            phase, slots, ready, taken, machine = counted
            self.phases[phase] += sign
            self.granted += sign * slots
            self.slots += sign * ready
            self.taken += sign * taken
            if taken:
                self.machines[machine] += sign * taken
