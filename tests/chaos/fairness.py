"""Check who has the slots of a server, by rules of its own: equal shares, lent slots, turns."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

from zswarm.ss.slots.sharing import LEND_S, TURN_S, WORTH
from zswarm.ss.slots.state import HeldLease, Slot
from zswarm.ss.slots.table import SlotTable

# Beyond its turns a lease may wait for a trial that hangs, and for slots that are prepared.
PATIENCE_S = 60.0


class Surplus(NamedTuple):
    """Slots that a user, or a run of one, has beyond its share, while others have too few."""

    name: str
    slots: list[Slot]  # all of them
    count: int  # of those beyond the share


class Fairness:
    """Follow the leases of one server."""

    def __init__(self) -> None:
        self._known: set[bytes] = set()
        self._without_s: dict[bytes, float] = {}  # seconds without a slot, by lease
        self._missing = 0  # slots
        self._since: dict[str, float] = {}  # when somebody began to have too many

    def broken(
        self, table: SlotTable, now: float, clock: float, begun: Sequence[float | None]
    ) -> str:
        """Return which rule is broken after an event; "" if none is.

        A slot changes hands at the end of a chunk: who has too many gets nothing more to compute
        while others that have work have too few.

        Args:
            clock: the time on the server's clock.
            begun: when each slot began what it does; None if it is idle.
        """
        leases = [lease for lease in table.leases.values() if not lease.failure]
        lacking = [one for one in leases if len(one.slots) < one.wanted]
        if table.draining or len(leases) < 2 or not lacking:
            self._missing = 0  # whoever comes next waits from then on
            return ""
        free = sum(slot.state == "free" for slot in table.slots)
        idle = any(lease.idle(clock, LEND_S) for lease in leases)
        if free and not idle:
            return "a slot is free that is wanted"
        if not any(map(_works, lacking)):
            self._missing = 0
            return ""
        missing, found = _compare(leases, len(table.slots))
        missing -= free + sum(slot.state == "stopping" for slot in table.slots)
        found = found if missing > 0 else []
        if missing > self._missing:
            self._since.clear()
        self._missing = missing
        self._since = {one.name: self._since.get(one.name, now) for one in found}
        for surplus in found:
            ending = [begun[slot.index] for slot in surplus.slots]
            since = self._since[surplus.name]
            # Also at that very instant: a server that was stopped handles all that waits at once.
            left = sum(at is not None and at <= since for at in ending)
            if left < min(surplus.count, missing):
                return f"{surplus.name} keeps slots of which others have too few"
        return ""

    def passed(self, table: SlotTable, seconds: float) -> str:
        """Let time pass; return whose turn does not come, or ""."""
        leases = [lease for lease in table.leases.values() if not lease.failure]
        if all(lease.slots or lease.lent or not lease.wanted for lease in leases):
            self._known = {lease.token for lease in leases}
            self._without_s.clear()
            return ""
        tokens = {lease.token for lease in leases}
        if table.draining or tokens - self._known:
            self._without_s.clear()  # the line is another one
        self._known = tokens
        longest = max((max(one.prepare_s, one.jobs.trial_s) for one in leases), default=0)
        turn_s = max(TURN_S, WORTH * longest)
        users = len({lease.user for lease in leases})
        for lease in leases:
            without_s = self._without_s.get(lease.token, 0.0) + seconds
            served = lease.slots or lease.lent or not lease.wanted
            self._without_s[lease.token] = 0.0 if served else without_s
            own = sum(one.user == lease.user for one in leases)
            if not served and without_s > (users * own + 1) * turn_s + PATIENCE_S:
                return f"{lease.user}/{lease.run} never has a turn"
        return ""


@functools.lru_cache(maxsize=10_000)  # the same few again and again
def bounds(count: int, wants: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the least and the most that each may get of equal shares, as far as they are wanted.

    The two differ by one where somebody gets what cannot be divided.
    """
    level = 0
    while level < count and sum(min(want, level + 1) for want in wants) <= count:
        level += 1
    rest = count - sum(min(want, level) for want in wants)
    return [(min(want, level), min(want, level + bool(rest))) for want in wants]


def _works(lease: HeldLease) -> bool:
    """Return whether a lease has something to evaluate."""
    return bool(lease.jobs.waiting) or lease.idle_since is None


def _compare(leases: Sequence[HeldLease], capacity: int) -> tuple[int, list[Surplus]]:
    """Return how many slots those are short of that have work, and who has too many."""
    users = sorted({lease.user for lease in leases})
    own = [[lease for lease in leases if lease.user == user] for user in users]
    parts = bounds(capacity, tuple(sum(one.wanted for one in runs) for runs in own))
    missing, found = 0, []
    for user, runs, (least, most) in zip(users, own, parts, strict=True):
        held = [len(one.slots) for one in runs]
        works = [_works(one) for one in runs]
        wants = tuple(one.wanted for one in runs)
        lows = [low for low, _ in bounds(least, wants)]
        highs = [high for _, high in bounds(most, wants)]
        short = sum(
            max(0, low - has)
            for low, has, busy in zip(lows, held, works, strict=True)
            if busy
        )
        missing += max(short, least - sum(held) if all(works) else 0)
        slots = [slot for one in runs for slot in one.slots]
        if len(slots) > most:
            found.append(Surplus(user, slots, len(slots) - most))
        for lease, has, high in zip(runs, held, highs, strict=True):
            if short and has > high:
                found.append(Surplus(f"{user}/{lease.run}", lease.slots, has - high))
    return missing, found
