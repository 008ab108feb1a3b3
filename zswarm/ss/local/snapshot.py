"""The state of a server, for ``zswarm-ss status``, systemd's status line, and Prometheus."""

from collections import Counter, deque

import msgspec

from zswarm.ss.slots.table import SlotTable
from zswarm.ss.workers.parent import Worker

RATE_S = 10.0  # trials per second are counted over these
STEP_S = 0.5  # of the counting
SLOT_STATES = ("busy", "waiting", "preparing", "stopping", "free", "starting", "paused")


class LeaseView(msgspec.Struct, frozen=True):
    """A lease."""

    user: str
    run: str
    simulator: str
    slots: int
    trials: int
    seconds: float  # since it was granted


class MissingSlot(msgspec.Struct, frozen=True):
    """A slot that has no process for long."""

    slot: int
    reason: str


class View(msgspec.Struct, frozen=True, kw_only=True):
    """A server at one moment."""

    server: str
    program: str  # version of zswarm
    pid: int
    realm: str
    listen: list[str]
    since: float  # Unix time of its start, s
    warm: bool
    draining: bool
    slots: dict[str, int]  # by state, see SLOT_STATES
    leases: list[LeaseView]
    trials: int
    trials_per_s: float  # over the last seconds
    busy_s: float  # that slots spent on batches, summed
    faults: dict[str, int]  # by kind
    malformed: int
    waiting_batches: int
    waiting_queries: int
    slot_memory_mb: int
    missed: list[MissingSlot]

    def line(self) -> str:
        """Return it as one line."""
        state = "draining, " if self.draining else "" if self.warm else "starting, "
        missing = (
            f", slot {self.missed[0].slot}: {self.missed[0].reason}"
            if self.missed
            else ""
        )
        return (
            f"{state}{self.slots['busy']} of {sum(self.slots.values())} slots busy, "
            f"{len(self.leases)} leases, {self.trials} trials, {self.trials_per_s:.0f}/s{missing}"
        )


def slot_states(slots: SlotTable, workers: list[Worker], now: float) -> dict[str, int]:
    """Return how many slots are in which state."""
    shown = {"assigned": "preparing", "ready": "waiting"}
    counts: Counter[str] = Counter()
    for slot, worker in zip(slots.slots, workers, strict=True):
        if worker.here:
            counts[shown.get(slot.state, slot.state)] += 1
        else:
            counts["paused" if worker.pauses(now) else "starting"] += 1
    return {state: counts[state] for state in SLOT_STATES}


class Rate:
    """How fast a count grew over the last seconds."""

    def __init__(self, now: float) -> None:
        self._counts: deque[tuple[float, int]] = deque([(now, 0)])

    def take(self, count: int, now: float) -> float:
        """Take the count of now; return how much it grew per second."""
        while len(self._counts) > 1 and self._counts[1][0] <= now - RATE_S:
            self._counts.popleft()
        last = self._counts[-1][0]
        if now - last >= STEP_S:
            self._counts.append((now, count))
        elif len(self._counts) > 1:
            self._counts[-1] = (last, count)
        begin, first = self._counts[0]
        return (count - first) / max(1.0, min(now - begin, RATE_S))
