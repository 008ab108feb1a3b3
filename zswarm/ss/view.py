"""What a server shows of itself: to ``zswarm-ss status``, to systemd's status line and to Prometheus."""

from collections import Counter, deque

import msgspec

from zswarm.ss.slots import Slot, Slots, SlotState
from zswarm.ss.worker import Worker

LATELY_S = 10.0  # trials a second are counted over these
STEP_S = 0.5  # of the counting
SLOT_STATES = ("busy", "waiting", "preparing", "stopping", "free", "starting", "paused")
_STATES = {
    SlotState.FREE: "free",
    SlotState.ASSIGNED: "preparing",
    SlotState.PREPARING: "preparing",
    SlotState.READY: "waiting",
    SlotState.BUSY: "busy",
    SlotState.STOPPING: "stopping",
}


class LeaseView(msgspec.Struct, frozen=True):
    """A run that this server computes for."""

    user: str
    run: str
    simulator: str
    slots: int
    trials: int
    seconds: float  # since it was granted


class Missed(msgspec.Struct, frozen=True):
    """A slot whose process should be there and is not."""

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
    busy_s: float  # that slots spent on batches, added up
    faults: dict[str, int]  # by kind
    malformed: int
    waiting_batches: int
    waiting_queries: int
    slot_memory_mb: int
    missed: list[Missed]

    def line(self) -> str:
        """In one line."""
        doing = "draining, " if self.draining else "" if self.warm else "starting, "
        missed = f", slot {self.missed[0].slot}: {self.missed[0].reason}" if self.missed else ""
        return (
            f"{doing}{self.slots['busy']} of {sum(self.slots.values())} slots busy, {len(self.leases)} leases, "
            f"{self.trials} trials, {self.trials_per_s:.0f}/s{missed}"
        )


def slot_states(slots: Slots, workers: list[Worker], now: float) -> dict[str, int]:
    """How many slots are in which state."""
    counts = Counter(_state(slot, worker, now) for slot, worker in zip(slots.slots, workers, strict=True))
    return {state: counts[state] for state in SLOT_STATES}


def _state(slot: Slot, worker: Worker, now: float) -> str:
    if worker.here:
        return _STATES[slot.state]
    return "paused" if worker.pauses(now) else "starting"


class Rate:
    """How much a count grew a second lately; told of it whenever it may have grown."""

    def __init__(self, now: float) -> None:
        self._counts: deque[tuple[float, int]] = deque([(now, 0)])

    def take(self, count: int, now: float) -> float:
        """A second, with this count now."""
        while len(self._counts) > 1 and self._counts[1][0] <= now - LATELY_S:
            self._counts.popleft()
        last = self._counts[-1][0]
        if now - last >= STEP_S:
            self._counts.append((now, count))
        elif len(self._counts) > 1:
            self._counts[-1] = (last, count)
        begin, before = self._counts[0]
        return (count - before) / max(1.0, min(now - begin, LATELY_S))
