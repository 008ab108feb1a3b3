"""How the slots of a server are shared among leases.

- Users get equal shares, as far as their runs want slots; then the runs of a user do. What cannot
  be divided goes to those who stand first in line.
- A lease that had an idle slot and no waiting trials for ``LEND_S`` keeps its right, but its idle
  slots are lent to leases with waiting trials, one for each trial at most. It gets them back, each
  at the end of a chunk, when it has work.
- Where a lease would have no slot at all, leases take turns: after ``TURN_S`` those that used most
  slot-seconds lately go to the end of the line. A turn is longer where a trial or the preparation
  takes long, so that more time is computed than is prepared.

The line is another one at each server: of several servers with one slot, each begins with another
user, or another run of a user.
"""

import hashlib
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import msgspec

from zswarm.ss.slots.state import HeldLease

LEND_S = 1.0
TURN_S = 30.0
WORTH = 4  # a turn is at least that many times as long as preparing a slot, or as a trial
LONGEST_S = 1.0  # between two counts; longer ones are stops of the server itself
FADE = 0.5  # of the slot-seconds that were used before the last turn


class Shares(NamedTuple):
    """How many slots each lease may hold, in the order of the line."""

    rights: dict[HeldLease, int]  # if all had work
    now: dict[HeldLease, int]  # without slots to lend


class Sharing(msgspec.Struct, eq=False):
    """The line of users and runs, and the turns that they take."""

    server: str
    # Slot-seconds that users used, those before the last turn faded; and those at the last turn.
    used: dict[str, float] = {}
    at_turn: dict[str, float] = {}
    _turn_began: float | None = None  # None: no share is zero
    _used_until: float = 0.0
    # The capacity and what leases wanted, and their rights, until the next turn begins.
    _rights: tuple[int, list[tuple[HeldLease, int]], dict[HeldLease, int]] | None = None

    def shares(self, leases: Collection[HeldLease], capacity: int, now: float) -> Shares:
        """Return what each lease may hold; those that failed are left out."""
        rights = self._shared_rights(leases, capacity)
        line = list(rights)
        idle = {lease for lease in line if lease.idle(now, LEND_S)}
        if not idle or not any(lease.jobs.waiting or not rights[lease] for lease in line):
            return Shares(rights, rights)

        def needed(lease: HeldLease) -> int:
            if lease in idle:
                return min(rights[lease], lease.working())
            # One that has no right to a slot shows that it has work once it has one.
            useful = lease.useful() if lease.jobs.waiting else 1
            return max(rights[lease], min(lease.wanted, useful))

        shares = _by_user(line, capacity, needed)
        left = capacity - sum(shares.values())  # that nobody borrows
        for lease in line:
            kept = max(0, min(left, rights[lease] - shares[lease]))
            shares[lease] += kept
            left -= kept
        return Shares(rights, shares)

    def _shared_rights(
        self, leases: Collection[HeldLease], capacity: int
    ) -> dict[HeldLease, int]:
        """Return the rights in the order of the line: the last ones, if they still hold."""
        wants = [(lease, lease.wanted) for lease in leases if not lease.failure]
        if self._rights is None or self._rights[:2] != (capacity, wants):
            line = sorted(
                (lease for lease, _ in wants),
                key=lambda lease: (
                    self._place(self.at_turn.get(lease.user, 0.0), lease.user),
                    lease.user,
                    self._place(lease.used_at_turn, f"{lease.user}/{lease.run}"),
                ),
            )
            rights = _by_user(line, capacity, lambda lease: lease.wanted)
            self._rights = capacity, wants, rights
        return self._rights[2]

    def _place(self, used: float, name: str) -> tuple[float, bytes]:
        tie = hashlib.blake2b(f"{self.server}\n{name}".encode(), digest_size=8).digest()
        return used, tie

    def pass_time(self, leases: Collection[HeldLease], capacity: int, now: float) -> None:
        """Count what was used since the last call, and begin the next turn when it is due."""
        passed, self._used_until = min(now - self._used_until, LONGEST_S), now
        for lease in leases:
            used_s = passed * len(lease.slots)
            lease.used += used_s
            self.used[lease.user] = self.used.get(lease.user, 0.0) + used_s
        if all(self.shares(leases, capacity, now).now.values()):
            self._turn_began = None
        elif self._turn_began is None:
            self._turn_began = now
        elif now - self._turn_began >= self._turn_s(leases):
            self._turn_began, self._rights = now, None
            self.at_turn = dict(self.used)
            for lease in leases:
                lease.used_at_turn = lease.used
                lease.used *= FADE
            users = {lease.user for lease in leases}
            self.used = {user: FADE * self.used[user] for user in users}

    def _turn_s(self, leases: Collection[HeldLease]) -> float:
        longest = max(
            (max(lease.prepare_s, lease.jobs.trial_s) for lease in leases), default=0.0
        )
        return max(TURN_S, WORTH * longest)


def _by_user(
    line: Sequence[HeldLease], capacity: int, wanted: Callable[[HeldLease], int]
) -> dict[HeldLease, int]:
    """Divide slots among users, and what each user gets among its leases."""
    users: dict[str, list[HeldLease]] = {}
    for lease in line:
        users.setdefault(lease.user, []).append(lease)
    wants = {user: [wanted(lease) for lease in own] for user, own in users.items()}
    parts = divide(capacity, [sum(each) for each in wants.values()])
    shares: dict[HeldLease, int] = {}
    for (user, own), part in zip(users.items(), parts, strict=True):
        shares |= zip(own, divide(part, wants[user]), strict=True)
    return shares


def divide(count: int, wanted: Sequence[int]) -> list[int]:
    """Give everybody the same number, as far as it is wanted; the first ones get the remainder."""
    if sum(wanted) <= count:
        return list(wanted)
    shares = [0] * len(wanted)
    served = [place for place, want in enumerate(wanted) if want][:count]
    while served:
        level = count // len(served)
        content = [place for place in served if wanted[place] <= level]
        for place in content or served:
            shares[place] = min(wanted[place], level)
            count -= shares[place]
        if not content:
            for place in served[:count]:
                shares[place] += 1
            break
        served = [place for place in served if wanted[place] > level]
    return shares
