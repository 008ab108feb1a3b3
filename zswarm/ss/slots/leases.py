"""Leases: which run may use which slots, and for how long.

A run sends ``Reserve`` and holds one lease from then on. The state of a lease is not stored; it
follows from its slots:

=========  =========================================  ==========================================
state      the lease ...                              it leaves the state when ...
=========  =========================================  ==========================================
waiting    has no slot: none is free yet              a slot is assigned to it (preparing)
preparing  has slots, none ready for its problem      the first slot is prepared (ready), or all
                                                      are given back (waiting)
ready      has a slot that evaluates, or could        its last ready slot dies (preparing), or its
                                                      last slot is given back (waiting)
failed     cannot be served: ``failure`` has the      never; the run is to release it
           reason, and it has no slots
=========  =========================================  ==========================================

A lease fails when a slot cannot be prepared, or takes too long to; or when the process of a slot
dies three times while it is prepared, and no other slot of the lease could be.

A lease ends, from every state, when

- its run releases it,
- its run reserves again with a higher epoch: the new lease replaces it and keeps its place in the
  order of leases,
- no message of its run came for ``LEASE_S``, or
- the liveliness token of its run vanished, and neither it nor a message came for ``GRACE_S``.

Then its queries are answered with ``lease-lost``, its cached replies are dropped, and its slots
become free: an idle one at once, a working one when it has stopped.

A program draws a ``nonce`` when it starts, and sends it with every ``Reserve``: the same nonce gets
the same lease, which is how a program resumes a lease after its link was cut. ``epoch`` is how
often the run was resumed: ``zswarm-ot resume`` raises it in the record. So the slots of a run that
another program resumes are taken over, and the first program, if it still lives, is refused with
``superseded`` when it reserves again, and ends (docs/protocol.md, "Life of a lease").

A slot is prepared for one problem at a time; ``MOVES`` has the allowed changes of its state:

=========  =========================================  ==========================================
state      the slot ...                               it leaves the state when ...
=========  =========================================  ==========================================
free       is held by no lease                        it is assigned to a lease
assigned   is held by a lease, and waits              its process is to be prepared, or is known
                                                      to be prepared for the problem already
preparing  compiles or loads the problem              it is prepared (ready)
ready      is idle                                    it gets a chunk (busy)
busy       evaluates a chunk                          the chunk is finished (ready)
stopping   lost its lease while it worked             its work ended (free)
=========  =========================================  ==========================================

A slot whose process dies, or is replaced for its memory, is assigned again. One that is given back,
or whose lease ends, becomes free if it is assigned or ready, and stopping otherwise.
"""

from collections import OrderedDict
from collections.abc import Callable
from typing import Literal, NamedTuple

import msgspec

from zswarm.errors import LocalProtocolError
from zswarm.protocol.messages import MAX_TEXT, Lease, Refusal, Reserve, State
from zswarm.ss.slots.events import CommandList, Query, StopSlot
from zswarm.ss.slots.jobs import Chunk, JobQueue
from zswarm.ss.slots.reply_cache import ReplyCache

LEASE_S = 60.0  # after the last message
GRACE_S = 30.0  # after the holder's token vanished
MAX_EPOCHS = 10_000  # runs whose highest epoch is remembered


SlotState = Literal["free", "assigned", "preparing", "ready", "busy", "stopping"]
MOVES: dict[SlotState, set[SlotState]] = {
    "free": {"assigned"},
    "assigned": {"preparing", "ready", "free"},
    "preparing": {"ready", "assigned", "stopping"},
    "ready": {"busy", "assigned", "free"},
    "busy": {"ready", "assigned", "stopping"},
    "stopping": {"free"},
}


class Slot(msgspec.Struct, eq=False):
    """Room for one evaluation."""

    index: int
    state: SlotState = "free"
    # What it does is timed from then: its state or its trial began, or it was told to stop.
    timed_from: float = 0.0
    lease: "HeldLease | None" = None
    prepared_for: Reserve | None = None  # whose problem its process is prepared for
    chunk: Chunk | None = None
    trial: int = -1  # that it is at, an index in the chunk; -1 if not known yet
    deaths: int = 0  # in a row, while it was prepared for this lease

    def move(self, state: SlotState, now: float) -> None:
        """Change the state.

        Raises:
            LocalProtocolError: the move is not allowed.
        """
        if state not in MOVES[self.state]:
            raise LocalProtocolError(f"slot {self.index}: {self.state} to {state}")
        self.state, self.timed_from = state, now


class Renewal(NamedTuple):
    """An open query for the state of a lease."""

    query: Query
    known_ready: int  # number of ready slots that the run knows of
    since: float


class HeldLease(msgspec.Struct, eq=False):
    """A lease."""

    token: bytes
    user: str
    run: str
    reserve: Reserve  # the message that asked for it
    wanted: int  # slots
    since: float
    last_message: float
    jobs: JobQueue
    gone_since: float | None = None  # the holder's token vanished then
    slots: list[Slot] = []
    # Since when slots are idle while outcomes are not reported.
    unreported_since: float | None = None
    renewals: list[Renewal] = []
    probe: bytes = b""
    probe_s: float = 0.0  # of one trial of the probe
    failure: str = ""

    def ready(self) -> int:
        """Return how many slots evaluate, or could."""
        return sum(slot.state in ("ready", "busy") for slot in self.slots)

    def status(self) -> Lease:
        """Return the message that reports the state, as in the table above."""
        ready = self.ready()
        state: State = "ready" if ready else "preparing" if self.slots else "waiting"
        return Lease(
            lease=self.token,
            state="failed" if self.failure else state,
            slots=len(self.slots),
            ready=ready,
            probe=self.probe,
            trial_s=self.probe_s,
            reason=self.failure,
        )

    def renew(self, now: float) -> None:
        """Restart the time of the lease: its run sent a message."""
        self.last_message, self.gone_since = now, None

    def expired(self, now: float) -> bool:
        """Return whether the run was silent or gone for too long."""
        gone = self.gone_since is not None and now - self.gone_since > GRACE_S
        return gone or now - self.last_message > LEASE_S

    def prepared(self, slot: Slot) -> bool:
        """Return whether the process of a slot is prepared for the problem of this lease."""
        return slot.prepared_for is not None and _problem(slot.prepared_for) == _problem(
            self.reserve
        )


class LeaseTable(dict[tuple[str, str], HeldLease]):
    """The leases by user and run, in the order in which they get slots."""

    def __init__(self, out: CommandList, new_token: Callable[[], bytes]) -> None:
        super().__init__()
        self.replies = ReplyCache()
        self._out, self._new_token = out, new_token
        self._epochs: OrderedDict[tuple[str, str], int] = OrderedDict()

    def outdated(self, user: str, run: str, epoch: int) -> str:
        """Return why a run may not reserve with this epoch, or ""."""
        highest = self._epochs.get((user, run), -1)
        if epoch > highest or (epoch == highest and (user, run) not in self):
            return ""
        if epoch == highest:
            return f"another program holds the lease of epoch {epoch}"
        return f"the run was taken over: its epoch is {highest}, not {epoch}"

    def grant(self, user: str, run: str, reserve: Reserve) -> HeldLease:
        """Add a lease, in the place of the previous lease of the run if there is one."""
        self._epochs[user, run] = reserve.epoch
        self._epochs.move_to_end((user, run))
        while len(self._epochs) > MAX_EPOCHS:
            self._epochs.popitem(last=False)
        previous = self.get((user, run))
        now, token = self._out.now, self._new_token()
        jobs = JobQueue(self._out, self.replies, token)
        lease = HeldLease(token, user, run, reserve, reserve.slots, now, now, jobs)
        self[user, run] = lease
        if previous is not None:
            self._close(previous, "taken over")
        return lease

    def end(self, lease: HeldLease, how: str) -> None:
        """End a lease, and refuse all of its queries."""
        del self[lease.user, lease.run]
        self._close(lease, how)

    def _close(self, lease: HeldLease, how: str) -> None:
        """Log the end of a lease, drop its replies, refuse its queries, and take its slots."""
        self._out.log("lease_" + how.replace(" ", "_"), user=lease.user, run=lease.run)
        self.replies.drop(lease.token)
        self._strip(lease, "lease-lost", f"the lease was {how}")
        for renewal in lease.renewals:
            self._out.refuse(renewal.query, "lease-lost", f"the lease was {how}")

    def fail(self, lease: HeldLease, reason: str) -> None:
        """Fail a lease whose problem could not be prepared."""
        self._out.log("prepare_failed", user=lease.user, run=lease.run, reason=reason)
        lease.failure = reason[:MAX_TEXT]
        self._strip(lease, "mismatch", reason)

    def _strip(self, lease: HeldLease, code: Refusal, reason: str) -> None:
        """Refuse the jobs of a lease, and take its slots; those that work are to stop first."""
        lease.jobs.clear(code, reason)
        for slot in list(lease.slots):
            if slot.state == "busy":
                self._out.append(StopSlot(slot.index))
            self.give_back(slot)

    def give_back(self, slot: Slot) -> None:
        """Take a slot from its lease; one that works is free when it stopped."""
        if slot.lease is not None:
            slot.lease.slots.remove(slot)
            slot.lease = None
        working = slot.state in ("preparing", "busy")
        slot.move("stopping" if working else "free", self._out.now)

    # ---- shares

    def share_out(self, slots: list[Slot]) -> None:
        """Share the slots among the leases; prefer slots that are prepared for the problem."""
        free = [slot for slot in slots if slot.state == "free"]
        if not free and len(self) < 2:
            return
        shares = self.shares(len(slots))
        free += self._take_back(shares, slots, len(free))
        for lease, share in shares.items():
            known = {slot.index for slot in free if lease.prepared(slot)}
            free.sort(key=lambda slot: (slot.index not in known, slot.index))
            while free and len(lease.slots) < share:
                slot = free.pop(0)
                slot.move("assigned", self._out.now)
                slot.lease, slot.deaths = lease, 0
                lease.slots.append(slot)

    def _take_back(
        self, shares: dict[HeldLease, int], slots: list[Slot], free: int
    ) -> list[Slot]:
        """Take idle slots of leases that have too many, as far as others have too few."""
        missing = sum(max(0, share - len(lease.slots)) for lease, share in shares.items())
        missing -= free + sum(slot.state == "stopping" for slot in slots)
        taken: list[Slot] = []
        for lease, share in shares.items():
            idle = [slot for slot in lease.slots if slot.state in ("ready", "assigned")]
            surplus = min(len(lease.slots) - share, missing - len(taken))
            for slot in idle[: max(0, surplus)]:
                self._out.log(
                    "slot_given_back", user=lease.user, run=lease.run, slot=slot.index
                )
                self.give_back(slot)
                taken.append(slot)
        return taken

    def shares(self, capacity: int) -> dict[HeldLease, int]:
        """Return how many slots each lease should have.

        All leases get the same number, as far as they want it; earlier ones share the remainder.
        """
        leases = [lease for lease in self.values() if not lease.failure]
        shares = dict.fromkeys(leases, 0)
        served, left = leases[:capacity], capacity
        served.reverse()  # the sort is stable: the remainder is left to earlier leases
        served.sort(key=lambda lease: lease.wanted)
        for number, lease in enumerate(served):
            shares[lease] = min(lease.wanted, left // (len(served) - number))
            left -= shares[lease]
        return shares


def _problem(reserve: Reserve) -> tuple[object, ...]:
    parts = reserve.simulator, reserve.representation
    return *parts, reserve.version_hash, reserve.trial_memory_mb, reserve.asks
