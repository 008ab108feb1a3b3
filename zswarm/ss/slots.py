"""Slots, leases and batches of a server: a pure state machine. Events and the time go in, commands come out.

A lease holds slots for one run. Leases share the slots evenly: one that has more gives slots back, each when its piece is done,
as soon as another one has fewer; a lease that takes over another one takes its place. A slot is prepared once for its lease's
problem; the first compiles, and the others are prepared when it is ready, so that they find the compiled code.

A batch is handed out to all slots of its lease, piece by piece, smaller ones towards the end; its query is answered when the
last piece is done, or earlier when slots have nothing to do while outcomes are there that the run does not know. Outcomes are
kept for a run that asks again. A process that has little memory left is replaced by a new one. Every query is answered once.
"""

import math
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from enum import Enum, auto
from typing import Any, Literal

import msgspec

from zswarm.errors import LocalProtocolError
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    MAX_TEXT,
    MAX_TRIALS,
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
HUNGRY_S = 0.01  # a slot without work for longer, and outcomes are told that wait for others of their batch
PIECE_S = 0.003  # of work in a piece, at least: some twenty times as long as a slot waits for the next one
SHARED_S = 0.00025  # of work in a piece, at least, where little work is shared by idle slots
STOP_S = 2.0  # a batch told to stop that goes on longer is killed
PREPARE_S = 60.0  # to compile; a preparation may take this and the time of the probe's trials
STALL_S = 2.0  # without an event although slots work: the server itself stood still, and that is no slot's fault
PREPARE_ATTEMPTS = 3  # of a slot whose process ends while it is prepared
EPOCHS = 10_000  # runs whose highest epoch is remembered

Query = int  # stands for a query to answer


# ---- events -------------------------------------------------------------------------------------------------------


class Asked(msgspec.Struct, frozen=True):
    """A run asks."""

    query: Query
    user: str
    run: str
    message: Request


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
    """A slot's piece ended; ``reply`` is the encoded answer: outcomes, or why it is no batch."""

    slot: int
    reply: bytes
    worn: bool = False  # its process has little memory left


class Exhausted(msgspec.Struct, frozen=True):
    """A slot's process has no memory left for the rest of its piece, though no single trial is to blame yet."""

    slot: int
    part: Outcomes  # of the trials that it finished
    done: int  # trials of the piece that are finished, with those of the processes before
    alone: int  # the trial to be played by itself, to see whether it is to blame; -1: none


class Died(msgspec.Struct, frozen=True):
    """A slot's process ended by itself, in the given trial of its piece; a new one was started."""

    slot: int
    trial: int
    reason: str
    kind: FaultKind = "crashed"


class Tick(msgspec.Struct, frozen=True):
    """Time passed; ``trials`` are the trials of their pieces that the slots are at."""

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
    """Evaluate a piece of a batch in a slot; answered by Finished, Exhausted or Died."""

    slot: int
    body: bytes  # an encoded Evaluate
    first: int = 0  # trial to begin with
    alone: int = -1  # trial to play by itself
    begin: int = 0  # which trial of the run's batch is the first of the piece


class Stop(msgspec.Struct, frozen=True):
    """Let a slot's piece end before its next trial."""

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
    STOPPING = auto()  # its lease ended; its piece or preparation goes on a little


class Batch(msgspec.Struct, eq=False):
    """Work of a lease that is not finished."""

    message: Evaluate
    query: Query | None
    since: float  # when the query came
    trials: int
    whole: bool  # it cannot be cut: a slot will refuse it
    given: int = 0  # trials that were handed out
    again: list["Piece"] = []  # handed out, and to be gone on with in another process
    running: int = 0  # pieces in slots
    parts: list["Part"] = []
    told: int = 0  # of these
    fault: Fault | None = None
    refusal: Refused | None = None  # by a slot
    cancelled: bool = False

    def rests(self) -> int:
        """Trials that wait for a slot."""
        return self.trials - self.given + sum(piece.end - piece.first - piece.done for piece in self.again)


class Part(msgspec.Struct, eq=False):
    """Outcomes of some trials of a batch, from first to before end."""

    first: int
    end: int
    outcomes: Outcomes


class Piece(msgspec.Struct, eq=False):
    """Trials of a batch that a slot has, from first to before end."""

    batch: Batch
    first: int
    end: int
    begun: float = 0.0  # in its slot
    done: int = 0  # trials, by processes that ran out of memory
    alone: int = -1  # the trial to play by itself


class Slot(msgspec.Struct, eq=False):
    """Room for one evaluation."""

    index: int
    state: SlotState = SlotState.FREE
    lease: "Held | None" = None
    setup: Reserve | None = None  # what its process is prepared for
    piece: Piece | None = None
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
    batches: dict[int, Batch] = {}  # that are not answered for good
    waiting: deque[Batch] = msgspec.field(default_factory=deque)  # of them, with trials to hand out
    rest: int = 0  # these trials
    hungry_since: float | None = None  # a slot has nothing to do
    renewals: list[tuple[Query, int, float]] = []  # query, ready slots known, since
    probe: bytes = b""
    probe_s: float = 0.0  # of one trial of the probe
    trial_s: float = 0.0  # measured
    failure: str = ""

    def ready(self) -> int:
        """Slots that evaluate or could."""
        return sum(slot.state in (SlotState.READY, SlotState.BUSY) for slot in self.slots)


class Slots:
    """The state machine; ``handle`` is its only entry.

    Attributes:
        trials: whose outcomes are there, of all leases so far.
        seconds: that slots spent on batches.
        offer: what is told in phase 1; free slots and leases are filled in.
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
            offer: see above.
            mismatch: why this server cannot serve such a problem, or "".
            new_token: 16 random bytes.
        """
        self.slots = [Slot(index) for index in range(capacity)]
        self.leases: dict[bytes, Held] = {}
        self.draining = False
        self.trials = 0
        self.seconds = 0.0
        self.faults: Counter[str] = Counter()
        self.offer = offer
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
                self._drain(now)
        if self.draining and not any(slot.state == SlotState.BUSY for slot in self.slots):
            for lease in self.leases.values():
                self._answer_renewals(lease, now, hold=False)
            self._do(Drained())
        return self._commands

    def next_time(self) -> float:
        """When a Tick is due before the next one of the clock."""
        hungry = [lease.hungry_since for lease in self.leases.values() if lease.hungry_since is not None]
        return min(hungry) + HUNGRY_S if hungry else math.inf

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
                    msgspec.structs.replace(self.offer, free=self.free(), leases=len(self.leases), mismatch=mismatch),
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
        kept = self.kept.get(lease.token, message.batch, now)
        if kept is not None:
            self._do(Answer(event.query, kept))
            return
        if (batch := lease.batches.get(message.batch)) is not None:
            self._refuse(batch.query, "cancelled", "asked again")
            batch.query, batch.since = event.query, now
            self._start(lease, now)
            return
        most = 2 * len(lease.slots)
        if self.draining:
            self._refuse(event.query, "draining", "the server is draining")
        elif lease.failure:
            self._refuse(event.query, "mismatch", lease.failure)
        elif sum(not batch.cancelled for batch in lease.batches.values()) >= most:
            self._refuse(event.query, "busy", f"{len(lease.slots)} slots take {most} batches at once")
        else:
            trials = len(message.seeds) // 8
            whole = not 1 <= trials <= MAX_TRIALS or len(message.seeds) % 8 > 0 or len(message.participants) % (4 * trials) > 0
            batch = lease.batches[message.batch] = Batch(message, event.query, now, max(1, trials), whole)
            lease.waiting.append(batch)
            lease.rest += batch.trials
            self._start(lease, now)

    def _cancel(self, lease: Held, ids: set[int], now: float) -> None:
        for batch in [lease.batches[id_] for id_ in ids if id_ in lease.batches]:
            if batch.cancelled:
                continue
            batch.cancelled = True
            self._close(lease, batch)
            for slot in lease.slots:
                if slot.piece is not None and slot.piece.batch is batch:
                    slot.since = now
                    self._do(Stop(slot.index))
            self._conclude_if_done(lease, batch, now)

    def _close(self, lease: Held, batch: Batch) -> None:
        """Hand nothing more of a batch out; what runs may end."""
        if batch in lease.waiting:
            lease.waiting.remove(batch)
            lease.rest -= batch.rests()
        batch.given, batch.again = batch.trials, []

    def _conclude_if_done(self, lease: Held, batch: Batch, now: float) -> None:
        """Answer a batch of which nothing runs or waits any more."""
        if batch.running or batch.again or batch.given < batch.trials:
            return
        del lease.batches[batch.message.batch]
        if batch.cancelled:
            self._refuse(batch.query, "cancelled", "cancelled")
            return
        outcomes = self._outcomes(batch.parts)
        if batch.refusal is not None:
            reply: Message = batch.refusal
        elif batch.fault is not None:
            reply = msgspec.structs.replace(batch.fault, **outcomes)
        elif not batch.parts:
            self._refuse(batch.query, "draining", "the server is draining")
            return
        else:
            every = sum(part.end - part.first for part in batch.parts) == batch.trials
            reply = Outcomes(batch=batch.message.batch, **outcomes | ({"trials": b""} if every else {}))
        body = codec.encode(reply)
        self.kept.put(lease.token, batch.message.batch, body, now)
        if batch.query is not None:
            self._do(Answer(batch.query, body))

    def _outcomes(self, parts: list[Part]) -> dict[str, Any]:
        """Fields that tell outcomes, in the order of the trials."""
        parts = sorted(parts, key=lambda part: part.first)
        pieces = [part.outcomes for part in parts]
        return {
            "trials": codec.indices(trial for part in parts for trial in range(part.first, part.end)),
            "fitness": b"".join(piece.fitness for piece in pieces),
            "metrics": b"".join(piece.metrics for piece in pieces),
            "seconds": sum(piece.seconds for piece in pieces),
            "error": next((piece.error for piece in pieces if piece.error), ""),
        }

    # ---- slots

    def _assign(self, now: float) -> None:
        """Give slots to the leases that have less than their share, prefering slots that are prepared already."""
        if self.draining:
            return
        shares = self._shares()
        leases = sorted((self.leases[token] for token in shares), key=lambda lease: lease.place)
        for slot in [slot for lease in leases for slot in lease.slots if slot.state in (SlotState.READY, SlotState.ASSIGNED)]:
            self._give_back(slot, shares, now)
        for lease in leases:
            free = [slot for slot in self.slots if slot.state == SlotState.FREE]
            free.sort(key=lambda slot: not _same_problem(slot.setup, lease.setup))
            for slot in free[: max(0, shares[lease.token] - len(lease.slots))]:
                slot.state, slot.lease, slot.deaths = SlotState.ASSIGNED, lease, 0
                lease.slots.append(slot)
            self._prepare(lease, now)
            self._start(lease, now)
            self._answer_renewals(lease, now)

    def _shares(self) -> dict[bytes, int]:
        """Slots by lease: as many for each, as far as it wants them; of what cannot be divided the earlier ones have more."""
        leases = [lease for lease in self.leases.values() if not lease.failure]
        leases = sorted(leases, key=lambda lease: lease.place)[: len(self.slots)]
        shares, left = {lease.token: 0 for lease in self.leases.values() if not lease.failure}, len(self.slots)
        for number, lease in enumerate(sorted(leases, key=lambda lease: (lease.wanted, -lease.place))):
            shares[lease.token] = min(lease.wanted, left // (len(leases) - number))
            left -= shares[lease.token]
        return shares

    def _give_back(self, slot: Slot, shares: dict[bytes, int], now: float) -> bool:
        """Free a slot that does nothing if its lease has more than its share, and another one less than that is coming for."""
        lease = slot.lease
        if lease is None or len(lease.slots) <= shares.get(lease.token, len(self.slots)):
            return False
        missing = sum(max(0, share - len(self.leases[token].slots)) for token, share in shares.items())
        if missing <= sum(slot.state in (SlotState.FREE, SlotState.STOPPING) for slot in self.slots):
            return False
        lease.slots.remove(slot)
        slot.state, slot.lease = SlotState.FREE, None
        self._log("slot_given_back", user=lease.user, run=lease.run, slot=slot.index)
        self._answer_renewals(lease, now)
        return True

    def _share(self, slot: Slot, now: float) -> None:
        """A slot has done its piece, or was prepared: it may be another lease's turn."""
        if len(self.leases) > 1 and not self.draining and self._give_back(slot, self._shares(), now):
            self._assign(now)

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
            lease.probe, lease.probe_s, lease.trial_s = event.probe, event.trial_s, event.trial_s
            self._log("lease_ready", user=lease.user, run=lease.run, trial_s=event.trial_s)
        self._share(slot, now)
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
        """Hand out what waits to the slots that are ready."""
        idle = [slot for slot in lease.slots if slot.state == SlotState.READY]
        for number, slot in enumerate(idle):
            if not lease.waiting:
                break
            piece = slot.piece = self._next_piece(lease, len(idle) - number)
            slot.state, slot.trial, slot.since, piece.begun = SlotState.BUSY, -1, now, now
            piece.batch.running += 1
            message = piece.batch.message if piece.batch.whole else codec.cut(piece.batch.message, piece.first, piece.end)
            begin = 0 if piece.batch.whole else piece.first
            self._do(Run(slot.index, codec.encode(message), piece.done, piece.alone, begin))
        hungry = not lease.waiting and any(slot.state == SlotState.READY for slot in idle)
        untold = hungry and any(batch.told < len(batch.parts) and batch.query is not None for batch in lease.batches.values())
        lease.hungry_since = (lease.hungry_since or now) if untold else None

    def _next_piece(self, lease: Held, idle: int) -> Piece:
        """Half of a slot's share of what waits, a little work at least; little work is shared by the slots that are idle."""
        batch = lease.waiting[0]
        if batch.again:
            piece = batch.again.pop(0)
        else:
            least, shared = (PIECE_S / lease.trial_s, SHARED_S / lease.trial_s) if lease.trial_s else (1.0, 1.0)
            size = math.ceil(max(shared, min(max(lease.rest / (2 * len(lease.slots)), least), lease.rest / idle)))
            first = batch.given
            if batch.trials - first - size < shared / 2:
                size = batch.trials - first
            batch.given = batch.trials if batch.whole else min(first + size, batch.trials)
            piece = Piece(batch, first, batch.given)
        lease.rest -= piece.end - piece.first - piece.done
        if not batch.again and batch.given == batch.trials:
            lease.waiting.popleft()
        return piece

    def _finished(self, slot: Slot, event: Finished, now: float) -> None:
        lease, piece = slot.lease, self._leave_piece(slot, now)
        if event.worn:
            self._renew_process(slot)
        if lease is None:
            self._release(slot, now)
            return
        if piece is None:
            raise LocalProtocolError(f"slot {slot.index} finished a batch it does not have")
        slot.state = SlotState.ASSIGNED if event.worn else SlotState.READY
        batch = piece.batch
        if not batch.cancelled:
            reply = codec.decode_reply(event.reply)
            if isinstance(reply, Outcomes):
                self._add(lease, batch, Part(piece.first + piece.done, piece.end, reply))
            elif isinstance(reply, Refused):
                batch.refusal = reply
                self._close(lease, batch)
        self._conclude_if_done(lease, batch, now)
        self._share(slot, now)
        if event.worn:
            self._prepare(lease, now)
            self._answer_renewals(lease, now)
        self._start(lease, now)

    def _add(self, lease: Held, batch: Batch, part: Part) -> None:
        """Outcomes are there."""
        if trials := part.end - part.first:
            batch.parts.append(part)
            lease.trials += trials
            self.trials += trials
            measured = part.outcomes.seconds / trials
            lease.trial_s = measured if not lease.trial_s else 0.7 * lease.trial_s + 0.3 * measured

    def _exhausted(self, slot: Slot, event: Exhausted, now: float) -> None:
        """The piece goes on in whatever slot is ready first; this one gets a new process."""
        lease, piece = slot.lease, self._leave_piece(slot, now)
        self._renew_process(slot)
        if lease is None:
            self._release(slot, now)
            return
        if piece is None:
            raise LocalProtocolError(f"slot {slot.index} ran out of memory for a batch it does not have")
        slot.state = SlotState.ASSIGNED
        batch = piece.batch
        if not batch.cancelled:
            self._add(lease, batch, Part(piece.first + piece.done, piece.first + event.done, event.part))
            if not (self.draining or batch.fault or batch.refusal):
                piece.done, piece.alone = event.done, event.alone
                batch.again.append(piece)
                if batch in lease.waiting:
                    lease.waiting.remove(batch)
                lease.waiting.appendleft(batch)
                lease.rest += piece.end - piece.first - piece.done
        self._conclude_if_done(lease, batch, now)
        self._prepare(lease, now)
        self._start(lease, now)
        self._answer_renewals(lease, now)

    def _leave_piece(self, slot: Slot, now: float) -> Piece | None:
        piece, slot.piece = slot.piece, None
        if piece is not None:
            self.seconds += now - piece.begun
            piece.batch.running -= 1
        return piece

    def _renew_process(self, slot: Slot) -> None:
        self._log("slot_worn", slot=slot.index)
        self._do(Kill(slot.index))
        slot.setup = None

    def _died(self, slot: Slot, kind: FaultKind | Literal["stopped"], trial: int, reason: str, now: float) -> None:
        """The slot's process ended, or was killed, and a new one is there, prepared for nothing."""
        lease, piece = slot.lease, self._leave_piece(slot, now)
        slot.setup = None
        self.faults[kind] += 1
        if lease is None:
            self._release(slot, now)
            return
        self._log("slot_died", slot=slot.index, kind=kind, trial=trial, reason=reason)
        if piece is not None:
            batch, blame = piece.batch, "crashed" if kind == "stopped" else kind
            if not batch.cancelled and batch.fault is None:
                simulator = lease.setup.simulator.kind
                named = reason if reason.startswith(f"simulator {simulator!r}") else f"simulator {simulator}: {reason}"
                batch.fault = Fault(batch=batch.message.batch, kind=blame, trial=piece.first + trial, reason=named[:MAX_TEXT])
                self._close(lease, batch)
            self._conclude_if_done(lease, batch, now)
        slot.deaths += slot.state == SlotState.PREPARING
        slot.state = SlotState.ASSIGNED
        if slot.deaths < PREPARE_ATTEMPTS:
            self._prepare(lease, now)
        elif lease.probe and len(lease.slots) > 1:  # as when the machine has memory for the others only: do without it
            lease.slots.remove(slot)
            lease.wanted = min(lease.wanted, len(self.slots)) - 1
            self._release(slot, now)
        else:
            self._unprepared(slot, f"the simulator's process ended while it was prepared: {reason}", now)
        self._answer_renewals(lease, now)

    def _release(self, slot: Slot, now: float) -> None:
        """A slot has done with its ended lease."""
        slot.state, slot.lease, slot.piece = SlotState.FREE, None, None
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
        for batch in lease.batches.values():
            self._refuse(batch.query, code, reason)
        lease.batches, lease.rest, lease.hungry_since = {}, 0, None
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

    def _drain(self, now: float) -> None:
        self.draining = True
        for lease in self.leases.values():
            for batch in list(lease.waiting):
                self._close(lease, batch)
                self._conclude_if_done(lease, batch, now)

    def _tick(self, trials: tuple[int, ...], now: float) -> None:
        for lease in list(self.leases.values()):
            gone = lease.gone_since is not None and now - lease.gone_since > GRACE_S
            if gone or now - lease.last_message > LEASE_S:
                self._end(lease, "expired", now)
                continue
            self._answer_renewals(lease, now)
        for slot in self.slots:
            if slot.state == SlotState.STOPPING and now - slot.since > (STOP_S if slot.piece else PREPARE_S):
                self._do(Kill(slot.index))
                self._died(slot, "stopped", slot.trial, "told to stop", now)
            elif slot.state == SlotState.PREPARING and slot.lease is not None:
                limit_s = PREPARE_S + PROBE_GENOMES * PROBE_SEEDS * slot.lease.setup.trial_timeout_s
                if now - slot.since > limit_s:
                    self._do(Kill(slot.index))
                    self._unprepared(slot, f"the simulator's first trials took longer than {limit_s:g} s", now)
            elif slot.state == SlotState.BUSY and slot.piece is not None and slot.lease is not None:
                self._watch(slot, slot.piece, slot.lease.setup.trial_timeout_s, trials[slot.index], now)
        for lease in self.leases.values():
            for batch in lease.batches.values():
                self._hold(lease, batch, now)
            if lease.hungry_since is not None and now - lease.hungry_since >= HUNGRY_S:
                lease.hungry_since = None

    def _watch(self, slot: Slot, piece: Piece, timeout_s: float, trial: int, now: float) -> None:
        if piece.batch.cancelled:
            if now - slot.since > STOP_S:
                self._do(Kill(slot.index))
                self._died(slot, "stopped", trial, "told to stop", now)
            return
        if trial != slot.trial:
            slot.trial, slot.since = trial, now
        if now - slot.since > timeout_s:
            self._do(Kill(slot.index))
            self._died(slot, "timeout", trial, f"one trial took longer than {timeout_s:g} s (cluster.trial_timeout_s)", now)

    def _hold(self, lease: Held, batch: Batch, now: float) -> None:
        """Answer a query that was held for long, or of which outcomes are there while slots have nothing to do.

        The run asks again.
        """
        hungry = lease.hungry_since is not None and now - lease.hungry_since >= HUNGRY_S and batch.told < len(batch.parts)
        if batch.query is not None and not batch.cancelled and (hungry or now - batch.since > HOLD_QUERY_S):
            done = sum(part.end - part.first for part in batch.parts)
            done += sum(max(0, slot.trial - slot.piece.done) for slot in lease.slots if slot.piece and slot.piece.batch is batch)
            told, batch.told = batch.told, len(batch.parts)
            outcomes = self._outcomes(batch.parts[told:])
            self._answer(batch.query, Running(batch=batch.message.batch, done=done, given=not batch.rests(), **outcomes))
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
            trial_s=lease.probe_s,
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
    return left is not None and _problem(left) == _problem(right)


def _problem(setup: Reserve) -> tuple[Any, ...]:
    return setup.simulator, setup.representation, setup.version_hash, setup.trial_memory_mb, setup.asks
