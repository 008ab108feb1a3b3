"""Slots, leases and batches of a server: a pure state machine. Events and the time go in, commands come out.

A lease holds slots for one run. Free slots go to the leases that want more, in the order the leases were made; a lease
that takes over another one takes its place. A slot is prepared once for its lease's problem; the first compiles, and the
others are prepared when it is ready, so that they find the compiled code. A lease holds one batch running and one waiting
per slot, and outcomes are kept for a run that asks again. A process that has little memory left is replaced by a new one.
Every query is answered once.
"""

from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from enum import Enum, auto
from typing import Literal

import msgspec

from zswarm.errors import LocalProtocolError
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    MAX_TEXT,
    PROBE_GENOMES,
    PROBE_SEEDS,
    Cancel,
    Done,
    Evaluate,
    Fault,
    FaultKind,
    Lease,
    Message,
    Offer,
    Outcomes,
    Refusal,
    Refused,
    Release,
    Renew,
    Request,
    Requirements,
    Reserve,
    Running,
    State,
)
from zswarm.ss.kept import Kept

LEASE_S = 60.0  # after the last message
GRACE_S = 30.0  # after the holder's token vanished
HOLD_QUERY_S = 30.0  # a batch that runs longer is answered "running"
HOLD_RENEWAL_S = 10.0
STOP_S = 2.0  # a batch told to stop that goes on longer is killed
PREPARE_S = 60.0  # to compile; a preparation may take this and the time of the probe's trials
STALL_S = 2.0  # without an event although slots work: the server itself stood still, and that is no slot's fault
PREPARE_ATTEMPTS = 3  # of a slot whose process ends while it is prepared
EPOCHS = 10_000  # runs whose highest epoch is remembered

Query = int  # stands for a query to answer


# ---- events -------------------------------------------------------------------------------------------------------


class Asked(msgspec.Struct, frozen=True):
    """A run asks; ``body`` is the message as it came."""

    query: Query
    user: str
    run: str
    message: Request
    body: bytes


class HolderSeen(msgspec.Struct, frozen=True):
    """A run's liveliness token is there."""

    user: str
    run: str


class HolderGone(msgspec.Struct, frozen=True):
    """A run's liveliness token vanished."""

    user: str
    run: str


class Prepared(msgspec.Struct, frozen=True):
    """A slot is ready for its setup."""

    slot: int
    probe: bytes
    trial_s: float


class Unprepared(msgspec.Struct, frozen=True):
    """A slot cannot evaluate its setup."""

    slot: int
    reason: str


class Finished(msgspec.Struct, frozen=True):
    """A slot's batch ended; ``reply`` is the encoded answer."""

    slot: int
    reply: bytes
    worn: bool = False  # its process has little memory left
    played: bool = True  # the reply is outcomes


class Exhausted(msgspec.Struct, frozen=True):
    """A slot's process has no memory left for the rest of its batch, though no single trial is to blame yet."""

    slot: int
    part: Outcomes  # of the trials that it finished
    done: int  # trials of the batch that are finished, with those of the processes before
    alone: int  # the trial to be played by itself, to see whether it is to blame; -1: none


class Died(msgspec.Struct, frozen=True):
    """A slot's process ended by itself, in the given trial of its batch; a new one was started."""

    slot: int
    trial: int
    reason: str
    kind: FaultKind = "crashed"


class Tick(msgspec.Struct, frozen=True):
    """Time passed; ``trials`` are the trials that the slots are at."""

    trials: tuple[int, ...]


class Drain(msgspec.Struct, frozen=True):
    """Finish what runs and take nothing new."""


Event = Asked | HolderSeen | HolderGone | Prepared | Unprepared | Finished | Exhausted | Died | Tick | Drain


# ---- commands -----------------------------------------------------------------------------------------------------


class Answer(msgspec.Struct, frozen=True):
    """Answer a query, for good."""

    query: Query
    body: bytes


class Prepare(msgspec.Struct, frozen=True):
    """Prepare a slot for a problem, and evaluate the probe if asked; answered by Prepared, Unprepared or Died."""

    slot: int
    setup: Reserve
    probe: bool
    known: bool = False  # its process is prepared for this problem already


class Run(msgspec.Struct, frozen=True):
    """Evaluate a batch in a slot; answered by Finished, Exhausted or Died."""

    slot: int
    body: bytes
    first: int = 0  # trial to begin with
    alone: int = -1  # trial to play by itself


class Stop(msgspec.Struct, frozen=True):
    """Let a slot's batch end before its next trial."""

    slot: int


class Kill(msgspec.Struct, frozen=True):
    """End a slot's process and start a new one; no Died follows."""

    slot: int


class Log(msgspec.Struct, frozen=True):
    """Worth a line in the log."""

    event: str
    fields: dict[str, str | int | float]


class Drained(msgspec.Struct, frozen=True):
    """Nothing runs any more: exit."""


Command = Answer | Prepare | Run | Stop | Kill | Log | Drained


# ---- state --------------------------------------------------------------------------------------------------------


class SlotState(Enum):
    """What a slot does."""

    FREE = auto()
    ASSIGNED = auto()  # waits for the first slot of its lease to be ready
    PREPARING = auto()
    READY = auto()
    BUSY = auto()
    STOPPING = auto()  # its lease ended; its batch or preparation goes on a little


class Batch(msgspec.Struct, eq=False):
    """Work of a lease that is not finished."""

    id: int
    body: bytes
    query: Query | None
    since: float  # when the query came
    trials: int
    begun: float = 0.0  # in its slot
    cancelled: bool = False
    done: int = 0  # trials, by processes that ran out of memory
    alone: int = -1  # the trial to play by itself
    parts: list[Outcomes] = []  # of these trials


class Slot(msgspec.Struct, eq=False):
    """Room for one evaluation."""

    index: int
    state: SlotState = SlotState.FREE
    lease: "Held | None" = None
    setup: Reserve | None = None  # what its process is prepared for
    batch: Batch | None = None
    trial: int = -1
    since: float = 0.0  # in this trial, preparing or stopping since then
    deaths: int = 0  # while it was prepared for this lease, in a row


class Held(msgspec.Struct, eq=False):
    """A lease."""

    token: bytes
    user: str
    run: str
    setup: Reserve
    place: int  # in the line for free slots
    wanted: int  # slots
    last_message: float
    since: float
    trials: int = 0  # whose outcomes are there
    gone_since: float | None = None
    slots: list[Slot] = []
    waiting: deque[Batch] = msgspec.field(default_factory=deque)
    renewals: list[tuple[Query, int, float]] = []  # query, ready slots known, since
    probe: bytes = b""
    trial_s: float = 0.0
    failure: str = ""

    def ready(self) -> int:
        """Slots that evaluate or could."""
        return sum(slot.state in (SlotState.READY, SlotState.BUSY) for slot in self.slots)


class Slots:
    """The state machine; ``handle`` is its only entry.

    Attributes:
        trials: whose outcomes are there, of all leases so far.
        seconds: that slots spent on batches.
        faults: how many slots' processes died or were killed, by kind; ``stopped``: told to stop, they did not.
    """

    def __init__(
        self,
        capacity: int,
        offer: Offer,
        mismatch: Callable[[Requirements | Reserve], str],
        new_token: Callable[[], bytes],
    ) -> None:
        """Start with all slots free.

        Args:
            offer: what is told in phase 1; free slots and leases are filled in.
            mismatch: why this server cannot serve such a problem, or "".
            new_token: 16 random bytes.
        """
        self.slots = [Slot(index) for index in range(capacity)]
        self.leases: dict[bytes, Held] = {}
        self.draining = False
        self.trials = 0
        self.seconds = 0.0
        self.faults: Counter[str] = Counter()
        self._offer = offer
        self._mismatch = mismatch
        self._new_token = new_token
        self._places = 0
        self._epochs: OrderedDict[tuple[str, str], int] = OrderedDict()
        self.kept = Kept()
        self._last_event = 0.0
        self._commands: list[Command] = []

    def handle(self, event: Event, now: float) -> list[Command]:
        """Take an event at a time (seconds, monotonic); give the commands to carry out, in order."""
        self._commands = []
        stalled, self._last_event = now - self._last_event, now
        if stalled > STALL_S:
            for slot in self.slots:
                slot.since = min(slot.since + stalled, now)
        match event:
            case Asked():
                self._asked(event, now)
            case HolderSeen() | HolderGone():
                for lease in self.leases.values():
                    if (lease.user, lease.run) == (event.user, event.run):
                        lease.gone_since = None if isinstance(event, HolderSeen) else now
            case Prepared():
                self._prepared(self.slots[event.slot], event, now)
            case Unprepared():
                self._unprepared(self.slots[event.slot], event.reason, now)
            case Finished():
                self._finished(self.slots[event.slot], event, now)
            case Exhausted():
                self._exhausted(self.slots[event.slot], event, now)
            case Died():
                self._died(self.slots[event.slot], event.kind, event.trial, event.reason, now)
            case Tick():
                self._tick(event.trials, now)
            case Drain():
                self._drain()
        if self.draining and not any(slot.state == SlotState.BUSY for slot in self.slots):
            for lease in self.leases.values():
                self._answer_renewals(lease, now, hold=False)
            self._do(Drained())
        return self._commands

    def busy(self) -> bool:
        """Whether something needs ticks: a lease, or a slot that stops."""
        return bool(self.leases) or any(slot.state != SlotState.FREE for slot in self.slots)

    def free(self) -> int:
        """Slots that no lease holds."""
        return sum(slot.state == SlotState.FREE for slot in self.slots)

    # ---- requests

    def _asked(self, event: Asked, now: float) -> None:
        message, query = event.message, event.query
        match message:
            case Requirements():
                mismatch = "draining" if self.draining else self._mismatch(message)
                self._answer(
                    query,
                    msgspec.structs.replace(self._offer, free=self.free(), leases=len(self.leases), mismatch=mismatch),
                )
            case Reserve():
                self._reserve(event, message, now)
            case Renew() | Evaluate() | Cancel() | Release():
                lease = self.leases.get(message.lease)
                if lease is None or (lease.user, lease.run) != (event.user, event.run):
                    self._refuse(query, "lease-lost", "no such lease: it expired, was released or taken over")
                    return
                lease.last_message, lease.gone_since = now, None
                match message:
                    case Renew():
                        lease.renewals.append((query, message.known_ready, now))
                        self._answer_renewals(lease, now)
                    case Evaluate():
                        self._evaluate(lease, message, event, now)
                    case Cancel():
                        self._cancel(lease, set(message.batches), now)
                        self._answer(query, Done())
                    case Release():
                        self._end(lease, "released", now)
                        self._answer(query, Done())

    def _reserve(self, event: Asked, message: Reserve, now: float) -> None:
        holder = (event.user, event.run)
        old = next((held for held in self.leases.values() if (held.user, held.run) == holder), None)
        if old is not None and old.setup.nonce == message.nonce:
            old.last_message, old.gone_since = now, None
            self._answer(event.query, self._lease(old))
            return
        highest = self._epochs.get(holder, -1)
        if message.epoch < highest or (message.epoch == highest and old is not None):
            self._refuse(event.query, "lease-lost", f"the run was taken over: its epoch is {highest}, not {message.epoch}")
            return
        if self.draining:
            self._refuse(event.query, "draining", "the server is draining")
            return
        if mismatch := self._mismatch(message):
            self._refuse(event.query, "mismatch", mismatch)
            return
        self._epochs[holder] = message.epoch
        self._epochs.move_to_end(holder)
        while len(self._epochs) > EPOCHS:
            self._epochs.popitem(last=False)
        self._places += 1
        place = self._places if old is None else old.place
        lease = Held(self._new_token(), event.user, event.run, message, place, message.slots, now, now)
        self.leases[lease.token] = lease
        self._log("lease_granted", user=lease.user, run=lease.run, wanted=message.slots, free=self.free())
        if old is not None:
            self._end(old, "taken-over", now)
        self._assign(now)
        self._answer(event.query, self._lease(lease))

    def _evaluate(self, lease: Held, message: Evaluate, event: Asked, now: float) -> None:
        kept = self.kept.get(lease.token, message.batch)
        if kept is not None:
            self._do(Answer(event.query, kept))
            return
        running = [slot.batch for slot in lease.slots if slot.batch is not None]
        for batch in [*running, *lease.waiting]:
            if batch.id == message.batch:
                self._refuse(batch.query, "cancelled", "asked again")
                batch.query, batch.since = event.query, now
                return
        going_on = sum(not batch.cancelled for batch in running)
        if self.draining:
            self._refuse(event.query, "draining", "the server is draining")
        elif lease.failure:
            self._refuse(event.query, "mismatch", lease.failure)
        elif going_on + len(lease.waiting) >= 2 * len(lease.slots):
            self._refuse(event.query, "busy", f"{len(lease.slots)} slots take {2 * len(lease.slots)} batches at once")
        else:
            lease.waiting.append(Batch(message.batch, event.body, event.query, now, len(message.seeds) // 8))
            self._start(lease, now)

    def _cancel(self, lease: Held, ids: set[int], now: float) -> None:
        for batch in [batch for batch in lease.waiting if batch.id in ids]:
            lease.waiting.remove(batch)
            self._refuse(batch.query, "cancelled", "cancelled")
        for slot in lease.slots:
            if slot.batch is not None and slot.batch.id in ids and not slot.batch.cancelled:
                slot.batch.cancelled = True
                slot.since = now
                self._do(Stop(slot.index))

    # ---- slots

    def _assign(self, now: float) -> None:
        """Give free slots to the leases that want more, prefering slots that are prepared already."""
        for lease in sorted(self.leases.values(), key=lambda lease: lease.place):
            if lease.failure or self.draining:
                continue
            free = [slot for slot in self.slots if slot.state == SlotState.FREE]
            free.sort(key=lambda slot: not _same_problem(slot.setup, lease.setup))
            for slot in free[: max(0, lease.wanted - len(lease.slots))]:
                slot.state, slot.lease, slot.deaths = SlotState.ASSIGNED, lease, 0
                lease.slots.append(slot)
            self._prepare(lease, now)
            self._start(lease, now)
            self._answer_renewals(lease, now)

    def _prepare(self, lease: Held, now: float) -> None:
        preparing = any(slot.state == SlotState.PREPARING for slot in lease.slots)
        for slot in lease.slots:
            if slot.state != SlotState.ASSIGNED:
                continue
            if lease.probe and _same_problem(slot.setup, lease.setup):
                slot.state = SlotState.READY
            elif lease.probe or not preparing:
                slot.state, slot.since, preparing = SlotState.PREPARING, now, True
                known = _same_problem(slot.setup, lease.setup)
                slot.setup = lease.setup
                self._do(Prepare(slot.index, lease.setup, probe=not lease.probe, known=known))

    def _prepared(self, slot: Slot, event: Prepared, now: float) -> None:
        lease = slot.lease
        if lease is None:
            self._release(slot, now)
            return
        slot.state, slot.deaths = SlotState.READY, 0
        if not lease.probe:
            lease.probe, lease.trial_s = event.probe, event.trial_s
            self._log("lease_ready", user=lease.user, run=lease.run, trial_s=event.trial_s)
        self._prepare(lease, now)
        self._start(lease, now)
        self._answer_renewals(lease, now)

    def _unprepared(self, slot: Slot, reason: str, now: float) -> None:
        lease = slot.lease
        slot.setup = None
        if lease is None:
            self._release(slot, now)
            return
        slot.state = SlotState.ASSIGNED
        lease.failure = reason[:MAX_TEXT]
        self._log("prepare_failed", user=lease.user, run=lease.run, reason=reason)
        self._let_go(lease, "mismatch", reason, now)
        self._answer_renewals(lease, now)
        self._assign(now)

    def _start(self, lease: Held, now: float) -> None:
        for slot in lease.slots:
            if not lease.waiting:
                return
            if slot.state == SlotState.READY:
                slot.batch = lease.waiting.popleft()
                slot.state, slot.trial, slot.since, slot.batch.begun = SlotState.BUSY, -1, now, now
                self._do(Run(slot.index, slot.batch.body, slot.batch.done, slot.batch.alone))

    def _finished(self, slot: Slot, event: Finished, now: float) -> None:
        lease, batch = slot.lease, self._leave_batch(slot, now)
        if event.worn:
            self._renew_process(slot)
        if lease is None:
            self._release(slot, now)
            return
        if batch is None:
            raise LocalProtocolError(f"slot {slot.index} finished a batch it does not have")
        slot.state = SlotState.ASSIGNED if event.worn else SlotState.READY
        if batch.cancelled:
            self._refuse(batch.query, "cancelled", "cancelled")
        else:
            reply = _joined(batch.parts, event.reply)
            if event.played:
                lease.trials += batch.trials
                self.trials += batch.trials
            self.kept.put(lease.token, batch.id, reply, now)
            if batch.query is not None:
                self._do(Answer(batch.query, reply))
        if event.worn:
            self._prepare(lease, now)
            self._answer_renewals(lease, now)
        self._start(lease, now)

    def _exhausted(self, slot: Slot, event: Exhausted, now: float) -> None:
        """The batch goes on in whatever slot is ready first; this one gets a new process."""
        lease, batch = slot.lease, self._leave_batch(slot, now)
        self._renew_process(slot)
        if lease is None:
            self._release(slot, now)
            return
        if batch is None:
            raise LocalProtocolError(f"slot {slot.index} ran out of memory for a batch it does not have")
        slot.state = SlotState.ASSIGNED
        if batch.cancelled:
            self._refuse(batch.query, "cancelled", "cancelled")
        elif self.draining:
            self._refuse(batch.query, "draining", "the server is draining")
        else:
            batch.done, batch.alone = event.done, event.alone
            batch.parts = [*batch.parts, event.part]
            lease.waiting.appendleft(batch)
        self._prepare(lease, now)
        self._start(lease, now)
        self._answer_renewals(lease, now)

    def _leave_batch(self, slot: Slot, now: float) -> Batch | None:
        batch, slot.batch = slot.batch, None
        if batch is not None:
            self.seconds += now - batch.begun
        return batch

    def _renew_process(self, slot: Slot) -> None:
        self._log("slot_worn", slot=slot.index)
        self._do(Kill(slot.index))
        slot.setup = None

    def _died(self, slot: Slot, kind: FaultKind | Literal["stopped"], trial: int, reason: str, now: float) -> None:
        """The slot's process ended, or was killed, and a new one is there, prepared for nothing."""
        lease, batch = slot.lease, self._leave_batch(slot, now)
        slot.setup = None
        self.faults[kind] += 1
        if lease is None:
            self._release(slot, now)
            return
        self._log("slot_died", slot=slot.index, kind=kind, trial=trial, reason=reason)
        if batch is not None and batch.cancelled:
            self._refuse(batch.query, "cancelled", "cancelled")
        elif batch is not None:
            fault = Fault(batch=batch.id, kind="crashed" if kind == "stopped" else kind, trial=trial, reason=reason[:MAX_TEXT])
            self.kept.put(lease.token, batch.id, codec.encode(fault), now)
            if batch.query is not None:
                self._answer(batch.query, fault)
        slot.deaths += slot.state == SlotState.PREPARING
        slot.state = SlotState.ASSIGNED
        if slot.deaths < PREPARE_ATTEMPTS:
            self._prepare(lease, now)
        elif lease.probe and len(lease.slots) > 1:  # as when the machine has memory for the others only: do without it
            lease.slots.remove(slot)
            lease.wanted = len(lease.slots)
            self._release(slot, now)
        else:
            self._unprepared(slot, f"the simulator's process ended while it was prepared: {reason}", now)
        self._answer_renewals(lease, now)

    def _release(self, slot: Slot, now: float) -> None:
        """A slot has done with its ended lease."""
        slot.state, slot.lease, slot.batch = SlotState.FREE, None, None
        self._assign(now)

    # ---- ends

    def _end(self, lease: Held, why: str, now: float) -> None:
        self._log("lease_" + why.replace("-", "_"), user=lease.user, run=lease.run)
        del self.leases[lease.token]
        self.kept.drop(lease.token)
        self._let_go(lease, "lease-lost", f"the lease was {why.replace('-', ' ')}", now)
        for query, _, _ in lease.renewals:
            self._refuse(query, "lease-lost", f"the lease was {why.replace('-', ' ')}")
        self._assign(now)

    def _let_go(self, lease: Held, code: Refusal, reason: str, now: float) -> None:
        """Refuse a lease's batches and free its slots; one that computes is told to stop first."""
        for batch in [*lease.waiting, *(slot.batch for slot in lease.slots if slot.batch)]:
            self._refuse(batch.query, code, reason)
        lease.waiting.clear()
        for slot in lease.slots:
            slot.lease = None
            if slot.state in (SlotState.BUSY, SlotState.PREPARING):
                if slot.state == SlotState.BUSY:
                    self._do(Stop(slot.index))
                slot.state, slot.since = SlotState.STOPPING, now
            else:
                slot.state = SlotState.FREE
        lease.slots = []

    def _drain(self) -> None:
        self.draining = True
        for lease in self.leases.values():
            for batch in lease.waiting:
                self._refuse(batch.query, "draining", "the server is draining")
            lease.waiting.clear()

    def _tick(self, trials: tuple[int, ...], now: float) -> None:
        for lease in list(self.leases.values()):
            gone = lease.gone_since is not None and now - lease.gone_since > GRACE_S
            if gone or now - lease.last_message > LEASE_S:
                self._end(lease, "expired", now)
                continue
            self._answer_renewals(lease, now)
            for batch in lease.waiting:
                self._hold(batch, batch.done, now)
        for slot in self.slots:
            if slot.state == SlotState.STOPPING and now - slot.since > (STOP_S if slot.batch else PREPARE_S):
                self._do(Kill(slot.index))
                self._died(slot, "stopped", slot.trial, "told to stop", now)
            elif slot.state == SlotState.PREPARING and slot.lease is not None:
                limit_s = PREPARE_S + PROBE_GENOMES * PROBE_SEEDS * slot.lease.setup.trial_timeout_s
                if now - slot.since > limit_s:
                    self._do(Kill(slot.index))
                    self._unprepared(slot, f"the simulator's first trials took longer than {limit_s:g} s", now)
            elif slot.state == SlotState.BUSY and slot.batch is not None and slot.lease is not None:
                self._watch(slot, slot.batch, slot.lease.setup.trial_timeout_s, trials[slot.index], now)

    def _watch(self, slot: Slot, batch: Batch, timeout_s: float, trial: int, now: float) -> None:
        if batch.cancelled:
            if now - slot.since > STOP_S:
                self._do(Kill(slot.index))
                self._died(slot, "stopped", trial, "told to stop", now)
            return
        if trial != slot.trial:
            slot.trial, slot.since = trial, now
        if now - slot.since > timeout_s:
            self._do(Kill(slot.index))
            self._died(slot, "timeout", trial, f"one trial took longer than {timeout_s:g} s", now)
        else:
            self._hold(batch, trial, now)

    def _hold(self, batch: Batch, done: int, now: float) -> None:
        """Answer a query that was held for long; the run asks again."""
        if batch.query is not None and now - batch.since > HOLD_QUERY_S:
            self._answer(batch.query, Running(batch=batch.id, done=done))
            batch.query = None

    # ---- answers

    def _answer_renewals(self, lease: Held, now: float, *, hold: bool = True) -> None:
        """Answer the held renewals that know another state, or were held for long."""
        held, lease.renewals = lease.renewals, []
        for query, known, since in held:
            if hold and known == lease.ready() and not lease.failure and now - since <= HOLD_RENEWAL_S:
                lease.renewals.append((query, known, since))
            else:
                self._answer(query, self._lease(lease))

    def _lease(self, lease: Held) -> Lease:
        ready = lease.ready()
        state: State = "failed" if lease.failure else "ready" if ready else "preparing" if lease.slots else "waiting"
        return Lease(
            lease=lease.token,
            state=state,
            slots=len(lease.slots),
            ready=ready,
            lease_s=LEASE_S,
            probe=lease.probe,
            trial_s=lease.trial_s,
            reason=lease.failure,
        )

    def _answer(self, query: Query, message: Message) -> None:
        self._do(Answer(query, codec.encode(message)))

    def _refuse(self, query: Query | None, code: Refusal, reason: str) -> None:
        if query is not None:
            self._answer(query, Refused(code=code, reason=reason[:MAX_TEXT]))

    def _log(self, event: str, **fields: str | int | float) -> None:
        self._do(Log(event, fields))

    def _do(self, command: Command) -> None:
        self._commands.append(command)


def _same_problem(left: Reserve | None, right: Reserve) -> bool:
    return left is not None and (left.simulator, left.representation, left.version_hash, left.trial_memory_mb) == (
        right.simulator,
        right.representation,
        right.version_hash,
        right.trial_memory_mb,
    )


def _joined(parts: list[Outcomes], last: bytes) -> bytes:
    """The answer to a batch that several processes played, each some trials; the last one's where it is no outcomes."""
    if not parts:
        return last
    rest = codec.decode_reply(last)
    if not isinstance(rest, Outcomes):
        return last
    pieces = [*parts, rest]
    return codec.encode(
        Outcomes(
            batch=rest.batch,
            fitness=b"".join(piece.fitness for piece in pieces),
            metrics=b"".join(piece.metrics for piece in pieces),
            seconds=sum(piece.seconds for piece in pieces),
            error=next((piece.error for piece in pieces if piece.error), ""),
        )
    )
