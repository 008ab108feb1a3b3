"""The slot table: a pure state machine. Events and the time go in, commands come out.

``state.py`` has the states of leases and slots, ``sharing.py`` who gets slots, ``jobs.py`` how a
batch is cut for the slots and what happens when memory runs out, ``events.py`` the events and
commands. An event changes only what it is about; what follows from the new state is derived once,
at the end of ``handle``.

- Users share the slots evenly. A lease that has too many gives slots back, each when it is idle.
- The first slot of a lease compiles alone; then the others load what it compiled, and all of them
  play the probe (``probing.py``). The probe of a problem is played once while the server runs;
  where it is known, all slots are prepared at once.
- The answer to a batch is sent when its last chunk is finished. It is sent earlier, as *running*,
  when slots are idle while the run does not know all outcomes, or when the query is open for long.
- Every query is answered once.
"""

import math
from collections import Counter
from collections.abc import Callable

import msgspec

from zswarm.errors import LocalProtocolError
from zswarm.protocol import messages
from zswarm.ss.slots import events
from zswarm.ss.slots.jobs import Chunk
from zswarm.ss.slots.leases import LeaseTable
from zswarm.ss.slots.state import HeldLease, Renewal, Slot, SlotState

HOLD_RENEWAL_S = 10.0
MAX_RENEWALS = 4  # of a lease, that are held: the latest; a run has one open
# When slots are idle for longer, outcomes are reported before their batch is done. The end of a
# trial that is shorter than SHORT_S is awaited first: the rest would come a round trip later.
IDLE_S, SHORT_S = 0.01, 0.1
STOP_S = 2.0  # a stopped chunk that runs longer is killed
PREPARE_S = 60.0  # to compile, and for the probe's short trials
PROBE_TIMEOUTS = 2  # trials of the probe that may be long
STALL_S = 2.0  # without an event: the server itself stood still, and no slot is to blame
PREPARE_ATTEMPTS = 3  # of a slot whose process dies while it is prepared


class SlotTable:
    """The state machine; ``handle`` is its only entry.

    Args:
        offer: the answer to ``Requirements``; free slots and leases are filled in.
        mismatch: returns why this server cannot serve such a problem, or "".
        new_token: returns 16 random bytes.

    Attributes:
        trials: number of trials with outcomes, of all leases so far.
        seconds: that slots spent on chunks.
        faults: deaths of processes by kind; ``stopped``: they did not stop in time.
    """

    def __init__(
        self,
        capacity: int,
        offer: messages.Offer,
        mismatch: Callable[[messages.Requirements | messages.Reserve], str],
        new_token: Callable[[], bytes],
    ) -> None:
        self._out = events.CommandList()
        self.slots = [Slot(index) for index in range(capacity)]
        self.leases = LeaseTable(self._out, new_token, offer.server)
        self.offer = offer
        self.draining = False
        self.trials = 0
        self.seconds = 0.0
        self.faults: Counter[str] = Counter()
        self._mismatch = mismatch
        self._drained = False  # nothing will run any more

    def handle(self, event: events.Event, now: float) -> list[events.Command]:
        """Take an event at a monotonic time in seconds; return the commands to carry out."""
        out = self._out
        stalled_s, out.now = now - out.now, now
        if stalled_s > STALL_S:
            for slot in self.slots:
                slot.timed_from = min(slot.timed_from + stalled_s, now)
        match event:
            case events.Asked():
                self._asked(event)
            case events.HolderAlive(user, run, alive):
                if (lease := self.leases.get((user, run))) is not None:
                    lease.gone_since = None if alive else now
            case events.Tick(positions):
                self._tick(positions)
            case events.Preparing():
                self._preparing(self.slots[event.slot], event)
            case events.Drain():
                self.draining = True
                for lease in self.leases.values():
                    lease.jobs.drain()
            case _:
                self._slot_event(self.slots[event.slot], event)
        self._derive()
        commands = list(out)
        out.clear()
        return commands

    def _derive(self) -> None:
        """Do what follows from the state."""
        if not self.draining:
            self.leases.share_out(self.slots)
        busy = any(slot.state == "busy" for slot in self.slots)
        ends = self.draining and not busy and not self._drained
        self._drained |= ends
        for lease in self.leases.values():
            self.leases.prepare(lease)
            self._start(lease)
            lease.watch_idle(self._out.now)
            self._answer_renewals(lease)
        if ends:
            self._out.append(events.Drained())

    def next_time(self) -> float:
        """Return when a Tick is due, at the latest, in addition to the regular ones."""
        return min(map(_report_at, self.leases.values()), default=math.inf)

    def busy(self) -> bool:
        """Return whether something needs ticks: a lease, or a slot that stops."""
        return bool(self.leases) or self.free() < len(self.slots)

    def free(self) -> int:
        """Return how many slots can be assigned to a lease."""
        return sum(slot.state == "free" for slot in self.slots)

    # ---- requests

    def _asked(self, event: events.Asked) -> None:
        message, query, out = event.message, event.query, self._out
        match message:
            case messages.Requirements():
                mismatch = "draining" if self.draining else self._mismatch(message)
                free, leases = self.free(), len(self.leases)
                fields = {"free": free, "leases": leases, "mismatch": mismatch}
                return out.answer(query, msgspec.structs.replace(self.offer, **fields))
            case messages.Reserve():
                return self._reserve(event, message)
        lease = self.leases.get((event.user, event.run))
        if lease is None or lease.token != message.lease:
            reason = "no such lease: it expired, was released or taken over"
            return out.refuse(query, "lease-lost", reason)
        lease.renew(out.now)
        match message:
            case messages.Renew():
                lease.renewals.append(Renewal(query, message.known_ready, out.now))
            case messages.Evaluate():
                self._evaluate(lease, message, query)
            case messages.Cancel():
                cancelled = lease.jobs.cancel(set(message.batches))
                for slot in lease.slots:
                    if slot.chunk is not None and slot.chunk.job in cancelled:
                        slot.timed_from = out.now
                        out.append(events.StopSlot(slot.index))
                out.answer(query, messages.Done())
            case messages.Release():
                self.leases.end(lease, "released")
                out.answer(query, messages.Done())
        return None

    def _reserve(self, event: events.Asked, message: messages.Reserve) -> None:
        user, run, query, out = event.user, event.run, event.query, self._out
        lease = self.leases.get((user, run))
        if lease is not None and lease.reserve.nonce == message.nonce:
            lease.renew(out.now)
            if message.slots != lease.reserve.slots:
                # The rest was checked when the lease was granted.
                fields = {"slots": message.slots}
                lease.reserve = msgspec.structs.replace(lease.reserve, **fields)
                lease.wanted = message.slots
        elif refusal := self.leases.refusal(user, run, message):
            return out.refuse(query, *refusal)
        elif self.draining:
            return out.refuse(query, "draining", "the server is draining")
        elif mismatch := self._mismatch(message):
            return out.refuse(query, "mismatch", mismatch)
        else:
            out.log(
                "lease_granted",
                user=user,
                run=run,
                wanted=message.slots,
                free=self.free(),
            )
            lease = self.leases.grant(user, run, message)
        # Answered at the end of handle.
        lease.renewals.append(Renewal(query, -1, out.now))
        return None

    def _evaluate(
        self, lease: HeldLease, message: messages.Evaluate, query: events.Query
    ) -> None:
        if lease.jobs.ask_again(message.batch, query):
            return
        slots, refuse = len(lease.slots) + lease.lent, self._out.refuse
        if not message.seeds and not message.participants:
            refuse(query, "unknown-batch", f"there is no batch {message.batch}")
        elif self.draining:
            refuse(query, "draining", "the server is draining")
        elif lease.failure:
            refuse(query, lease.failure_code, lease.failure)
        elif sum(not job.cancelled for job in lease.jobs.jobs.values()) >= 2 * slots:
            refuse(query, "busy", f"{slots} slots take {2 * slots} batches at once")
        else:
            lease.jobs.add(message, query)

    # ---- events of slots

    def _preparing(self, slot: Slot, event: events.Preparing) -> None:
        """Note how far a slot is, unless it has lost its lease."""
        if slot.lease is not None and slot.state == "preparing":
            slot.lease.trials.built(event, self._out.now)

    def _slot_event(self, slot: Slot, event: events.SlotEvent) -> None:
        """Take an event of a slot's process; a slot that has lost its lease becomes free."""
        lease, chunk, slot.chunk = slot.lease, slot.chunk, None
        taken_s = self._out.now - slot.timed_from
        if chunk is not None:
            self.seconds += self._out.now - chunk.begun
            chunk.job.running -= 1
        match event:
            case events.Died():
                return self._died(slot, event, chunk)
            case events.Unprepared():
                slot.prepared_for = None
            case events.Finished(reply=messages.Outcomes(left=left)) if left:
                self._out.log("slot_spoiled", slot=slot.index, left=left)
                self._kill(slot)
            case events.Exhausted() | events.Finished(recycle=True):
                self._out.log("slot_worn", slot=slot.index)
                self._kill(slot)
        if lease is None:
            return self._move(slot, "free")
        self._move(slot, "assigned" if slot.prepared_for is None else "ready")
        match event:
            case events.Prepared():
                slot.deaths = 0
                lease.prepare_s = max(lease.prepare_s, taken_s)
                self.leases.probe_played(lease, event)
            case events.Unprepared():
                self.leases.fail(lease, event.reason, passing=event.passing)
            case events.Finished() if chunk is not None:
                self.trials += lease.jobs.finished(chunk, event.reply)
            case events.Exhausted() if chunk is not None:
                lease.jobs.exhausted(chunk, event.trial)
            case _:
                raise LocalProtocolError(
                    f"slot {slot.index} ended a chunk that it does not have"
                )
        return None

    def _died(self, slot: Slot, event: events.Died, chunk: Chunk | None) -> None:
        """Blame the trial at which the process of a slot died; a new process has started."""
        lease, state, reason = slot.lease, slot.state, event.reason
        slot.prepared_for = None
        self.faults[event.kind] += 1
        if state == "stopping":
            self._move(slot, "free")
        if lease is None:
            return
        self._out.log(
            "slot_died",
            slot=slot.index,
            kind=event.kind,
            trial=event.trial,
            reason=reason,
        )
        if state != "assigned":
            self._move(slot, "assigned")
        if chunk is not None:
            lease.jobs.failed(chunk, event, lease.reserve.simulator.kind)
        slot.deaths += state == "preparing"
        if slot.deaths < PREPARE_ATTEMPTS:
            return
        if (lease.served or lease.trials.digest_known()) and len(lease.slots) > 1:
            # Others could be prepared: there may be too little memory for all of them.
            lease.wanted = min(lease.wanted, len(self.slots)) - 1
            self.leases.give_back(slot)
        else:
            simulator = lease.reserve.simulator.kind
            reason = f"while simulator {simulator} was prepared: {reason}"
            self.leases.fail(lease, reason, passing=event.kind != "memory")

    def _kill(self, slot: Slot) -> None:
        self._out.append(events.KillSlot(slot.index))
        slot.prepared_for = None

    def _move(self, slot: Slot, state: SlotState) -> None:
        slot.move(state, self._out.now)

    # ---- time

    def _tick(self, positions: tuple[int, ...]) -> None:
        now = self._out.now
        for lease in [lease for lease in self.leases.values() if lease.expired(now)]:
            self.leases.end(lease, "expired")
        self.leases.sharing.pass_time(self.leases.values(), len(self.slots), now)
        for slot, trial in zip(self.slots, positions, strict=True):
            if (event := self._overdue(slot, trial)) is not None:
                self._kill(slot)
                self._slot_event(slot, event)
        for lease in self.leases.values():
            chunks = [
                (slot.chunk, max(0, slot.trial)) for slot in lease.slots if slot.chunk
            ]
            lease.jobs.report(chunks, idle=now >= _report_at(lease))

    def _overdue(self, slot: Slot, trial: int) -> events.Died | events.Unprepared | None:
        """Return the event that ends a slot's work if it takes too long; else None.

        Args:
            trial: that its process is at; -1 while its work is on the way to it.
        """
        lease, chunk, now = slot.lease, slot.chunk, self._out.now
        taken_s = now - slot.timed_from
        if slot.state == "stopping" or (chunk is not None and chunk.job.cancelled):
            if taken_s > (STOP_S if chunk is not None else PREPARE_S):
                reason = "it did not stop in time"
                return events.Died(slot.index, max(0, trial), reason, "stopped")
        elif lease is not None and slot.state == "preparing":
            limit_s = PREPARE_S + PROBE_TIMEOUTS * lease.reserve.trial_timeout_s
            if taken_s > limit_s:
                reason = f"the simulator's first trials took longer than {limit_s:g} s"
                return events.Unprepared(slot.index, reason, passing=True)
        elif lease is not None and slot.state == "busy":
            timeout_s = lease.reserve.trial_timeout_s
            if trial != slot.trial:
                slot.trial, slot.timed_from = trial, now
            elif taken_s > timeout_s:
                reason = f"one trial took longer than {timeout_s:g} s (cluster.trial_timeout_s)"
                return events.Died(slot.index, max(0, trial), reason, "timeout")
        return None

    # ---- what follows from the state

    def _start(self, lease: HeldLease) -> None:
        """Hand out chunks to the slots that are ready, once the probe is known."""
        idle = [slot for slot in lease.slots if slot.state == "ready"]
        if lease.probe is None:
            return
        while idle and lease.jobs.waiting:
            chunk = lease.jobs.next_chunk(len(lease.slots), len(idle))
            slot = idle.pop(0)
            self._move(slot, "busy")
            slot.chunk, slot.trial = chunk, -1
            self._out.append(
                events.RunChunk(slot.index, chunk.work(), chunk.positions.start)
            )
        if not idle or not any(job.unreported() for job in lease.jobs.jobs.values()):
            lease.unreported_since = None
        elif lease.unreported_since is None:
            lease.unreported_since = self._out.now

    def _answer_renewals(self, lease: HeldLease) -> None:
        """Answer renewals that have news, were held for long, or are too many."""
        if not lease.renewals:
            return
        renewals, lease.renewals = lease.renewals, []
        for later, renewal in zip(range(len(renewals))[::-1], renewals, strict=True):
            known = renewal.known_ready == lease.ready() and not lease.failure
            held = known and not self._drained and later < MAX_RENEWALS
            held = held and not lease.got_on(self._out.now)
            if held and self._out.now - renewal.since <= HOLD_RENEWAL_S:
                lease.renewals.append(renewal)
            else:
                lease.reported = lease.progress(), self._out.now
                self._out.answer(renewal.query, lease.status())


def _report_at(lease: HeldLease) -> float:
    """Return when outcomes of a lease are to be reported because its slots are idle."""
    if lease.unreported_since is None:
        return math.inf
    trial_s = lease.jobs.trial_s
    return lease.unreported_since + IDLE_S + (trial_s if trial_s < SHORT_S else 0.0)
