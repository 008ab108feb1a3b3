"""Which server evaluates what: a pure state machine. Events and the time go in, commands come out.

A server is seen, asked for its offer, reserved, prepared, and then kept with two batches per slot. A batch is as large as
50-100 ms of measured work, and shrinks towards the end of a workload. Every trial is counted once: a result that comes a
second time is dropped, and what a server did not answer goes elsewhere.
"""

from collections import deque
from enum import Enum, auto
from typing import Literal

import msgspec
import numpy as np

from zswarm.errors import RemoteProtocolError
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    MAX_GENOMES,
    MAX_MESSAGE,
    MAX_SLOTS,
    MAX_TRIALS,
    BatchId,
    Fault,
    Lease,
    Offer,
    Outcomes,
    Refused,
    Reply,
    Running,
)

DEPTH = 2  # batches out per slot: one runs, one waits
BATCH_S = 0.075  # of work in a batch, by measured time
SMALLEST_BATCH_S = 0.003  # of work: shorter than the way to a server and back, two batches would not keep a slot busy
RENEW_S = 20.0  # a third of the lease time
RETRY_S = (0.05, 0.2, 1.0)  # before asking again after an empty answer; then the server is left alone until it is seen again
ATTEMPTS = 3  # of a trial that ends in a fault

Verb = Literal["offer", "reserve", "renew", "evaluate", "cancel", "release"]


# ---- events -------------------------------------------------------------------------------------------------------


class Seen(msgspec.Struct, frozen=True):
    """A server's liveliness token is there."""

    server: str


class Gone(msgspec.Struct, frozen=True):
    """A server's liveliness token vanished."""

    server: str


class Answered(msgspec.Struct, frozen=True):
    """A question ended: with a reply, or with None (nobody answered) or a text (why it could not be read)."""

    question: int
    reply: Reply | str | None


class Work(msgspec.Struct, frozen=True):
    """Evaluate this."""

    workload: "Workload"


class Tick(msgspec.Struct, frozen=True):
    """Time passed."""


class Leave(msgspec.Struct, frozen=True):
    """Give all leases back."""


Event = Seen | Gone | Answered | Work | Tick | Leave


# ---- commands -----------------------------------------------------------------------------------------------------


class Ask(msgspec.Struct, frozen=True):
    """Ask a server; the answer comes back as Answered with the same number."""

    question: int
    server: str
    verb: Verb
    lease: bytes = b""
    batch: BatchId = 0
    trials: np.ndarray | None = None  # indices into the workload, of an evaluate
    known_ready: int = -1
    batches: tuple[int, ...] = ()  # of a cancel


class Counted(msgspec.Struct, frozen=True):
    """Trials were evaluated, for the first time; the workload holds their outcomes."""

    trials: np.ndarray
    server: str
    seconds: float


class Complete(msgspec.Struct, frozen=True):
    """All trials of the workload are counted."""


class Failed(msgspec.Struct, frozen=True):
    """A trial ended in faults again and again, and the experiment says to stop then."""

    reason: str


class Note(msgspec.Struct, frozen=True):
    """Something for the record and for the user to know."""

    event: str
    server: str = ""
    text: str = ""
    count: int = 0


Command = Ask | Counted | Complete | Failed | Note


# ---- state --------------------------------------------------------------------------------------------------------


class Workload:
    """Genomes and trials to evaluate, and their outcomes as they come."""

    def __init__(self, genomes: list[bytes], participants: np.ndarray, seeds: np.ndarray, metrics: int) -> None:
        """Start with nothing counted.

        Args:
            participants: (trials, k) integers, indices into genomes.
            seeds: (trials,) uint64.
            metrics: numbers a trial reports beside fitness.
        """
        self.genomes = genomes
        self.participants = participants
        self.seeds = seeds
        self.fitness = np.full(participants.shape, np.nan)
        self.metrics = np.full((len(seeds), metrics), np.nan)
        self.counted = np.zeros(len(seeds), bool)
        self.faulted = np.zeros(len(seeds), bool)

    def batch(self, trials: np.ndarray) -> tuple[list[bytes], np.ndarray, np.ndarray]:
        """The genomes that some trials need, their participants as indices into these, and their seeds."""
        used, participants = np.unique(self.participants[trials], return_inverse=True)
        return [self.genomes[i] for i in used], participants.reshape(len(trials), -1), self.seeds[trials]


class Phase(Enum):
    """How far a server is."""

    SEEN = auto()  # its offer was asked
    IDLE = auto()  # it cannot or does not want to serve; it is looked at again when it is seen again
    RESERVING = auto()
    LEASED = auto()
    LEAVING = auto()  # its token vanished: what it has may still come back


class Batch(msgspec.Struct):
    """Trials that a server has."""

    id: int
    trials: np.ndarray
    empties: int = 0  # empty answers in a row


class Server(msgspec.Struct):
    """What is known of a server."""

    id: str
    phase: Phase = Phase.SEEN
    lease: bytes = b""
    capacity: int = 0
    slots: int = 0
    ready: int = 0
    trial_s: float = 0.0  # measured, 0.0: not yet
    last_asked: float = 0.0
    renewing: bool = False
    batches: dict[int, Batch] = {}
    empties: int = 0  # in a row, of questions without a batch
    counted: int = 0  # trials


class Question(msgspec.Struct):
    """A question that is out."""

    server: str
    verb: Verb
    batch: Batch | None = None


class Piece(msgspec.Struct):
    """Trials that wait, and the servers on which one of them ended in a fault."""

    trials: np.ndarray
    avoid: frozenset[str] = frozenset()


class Dispatch:
    """The state machine; ``handle`` is its only entry, ``next_time`` says when it wants a Tick."""

    def __init__(
        self,
        participants: int,
        metrics: int,
        *,
        wanted_slots: int,
        quarantine: bool,
        probe: bytes = b"",
    ) -> None:
        """Start with no server known.

        Args:
            participants, metrics: numbers per trial, of the simulator.
            wanted_slots: to reserve on every server.
            quarantine: count a trial that faults again and again as NaN, instead of stopping.
            probe: digest of the probe's outcomes that servers must have; b"": the first server's.
        """
        self.servers: dict[str, Server] = {}
        self.probe = probe
        self.requeued = 0  # trials sent again after they were out
        self.late = 0  # results that were counted before
        self._participants = participants
        self._metrics = metrics
        self._wanted = min(wanted_slots, MAX_SLOTS)
        self._quarantine = quarantine
        self._questions: dict[int, Question] = {}
        self._next = 0
        self._workload: Workload | None = None
        self._rest = 0  # trials not counted
        self._waiting: deque[Piece] = deque()
        self._unsent = 0  # trials in _waiting
        self._faults: dict[int, int] = {}
        self._later: list[tuple[float, Ask]] = []  # questions to ask at a time
        self._commands: list[Command] = []

    def handle(self, event: Event, now: float) -> list[Command]:
        """Take an event at a time (seconds, monotonic); give the commands to carry out, in order."""
        self._commands = []
        match event:
            case Seen():
                self._seen(event.server, now)
            case Gone():
                self._gone(event.server)
            case Answered():
                self._answered(event, now)
            case Work():
                self._work(event.workload)
            case Tick():
                self._tick(now)
            case Leave():
                for server in self.servers.values():
                    if server.phase in (Phase.LEASED, Phase.LEAVING):
                        self._ask(server, "release", now, lease=server.lease)
        self._fill(now)
        return self._commands

    def next_time(self) -> float:
        """When the next Tick is due."""
        renewals = [
            server.last_asked + RENEW_S
            for server in self.servers.values()
            if server.phase == Phase.LEASED and not server.renewing
        ]
        return min([*renewals, *(time for time, _ in self._later)], default=float("inf"))

    def slots(self) -> int:
        """Slots that evaluate for this run now."""
        return sum(server.ready for server in self.servers.values() if server.phase == Phase.LEASED)

    def serving(self) -> list[str]:
        """Servers that evaluate for this run now."""
        return [server.id for server in self.servers.values() if server.phase == Phase.LEASED and server.ready]

    def leased(self) -> int:
        """Servers that gave this run a lease, with or without a slot yet."""
        return sum(server.phase == Phase.LEASED for server in self.servers.values())

    def preparing(self) -> list[str]:
        """Servers that get ready for this run."""
        return [s.id for s in self.servers.values() if s.phase == Phase.LEASED and s.slots and not s.ready]

    # ---- servers

    def _seen(self, id_: str, now: float) -> None:
        server = self.servers.get(id_)
        if server is None:
            server = self.servers[id_] = Server(id_)
        elif server.phase == Phase.LEAVING:
            server.phase = Phase.LEASED  # the link was cut and is back before its end was noticed
            self._note("server_back", server.id)
            self._renew(server, now)
            return
        elif server.phase != Phase.IDLE:
            return
        server.phase, server.empties = Phase.SEEN, 0
        self._ask(server, "offer", now)

    def _gone(self, id_: str) -> None:
        """What a server has out ends by itself: with a reply when it drains, with nothing when it died."""
        server = self.servers.get(id_)
        if server is None:
            return
        if server.phase == Phase.LEASED:
            self._note("server_left", id_, f"{sum(len(b.trials) for b in server.batches.values())} trials were with it")
            server.phase = Phase.LEAVING
            for batch in [batch for batch in server.batches.values() if batch.empties]:
                del server.batches[batch.id]  # nobody answered already, and nobody will
                self._requeue(batch.trials)
            if not server.batches:
                self._forget_lease(server, "server_lost", "")
        elif server.phase != Phase.LEAVING:
            server.phase = Phase.IDLE

    def _forget_lease(self, server: Server, note: str, text: str) -> None:
        for batch in server.batches.values():
            self._requeue(batch.trials)
        server.batches = {}
        server.phase, server.lease, server.slots, server.ready = Phase.IDLE, b"", 0, 0
        self._note(note, server.id, text)

    def _leased(self, server: Server, lease: Lease, now: float) -> None:
        was_ready = server.ready
        server.lease, server.slots, server.ready = lease.lease, lease.slots, lease.ready
        if lease.state == "failed":
            self._ask(server, "release", now, lease=lease.lease)
            self._forget_lease(server, "server_refused", lease.reason)
            return
        if server.phase == Phase.RESERVING:
            server.phase = Phase.LEASED
            self._note("lease_" + lease.state, server.id, count=lease.slots)
        if lease.probe and not self.probe:
            self.probe = lease.probe
        if lease.probe and lease.probe != self.probe:
            self._ask(server, "release", now, lease=lease.lease)
            self._forget_lease(server, "server_differs", "its outcomes of the probe are not those of the other servers")
            return
        if not server.trial_s:
            server.trial_s = lease.trial_s
        if lease.ready and not was_ready:
            self._note("server_joined", server.id, count=lease.ready)
        if server.ready < min(self._wanted, server.capacity):
            self._renew(server, now)  # held by the server until more slots are ready

    def _renew(self, server: Server, now: float) -> None:
        if not server.renewing:
            server.renewing = True
            self._ask(server, "renew", now, lease=server.lease, known_ready=server.ready)

    # ---- answers

    def _answered(self, event: Answered, now: float) -> None:
        question = self._questions.pop(event.question, None)
        if question is None:
            return
        server, reply = self.servers[question.server], event.reply
        if question.verb == "renew":
            server.renewing = False
        if isinstance(reply, str):
            self._note("malformed", server.id, reply)
            reply = None
        if question.batch is not None:
            self._batch_answered(server, question.batch, reply, now)
            return
        if reply is None:
            self._empty(server, question, now)
            return
        server.empties = 0
        match question.verb, reply:
            case "offer", Offer():
                self._offered(server, reply, now)
            case "reserve", Refused(code="lease-lost"):
                server.phase = Phase.IDLE
                self._fail(f"{server.id}: {reply.reason}")
            case "offer" | "reserve", Refused():
                server.phase = Phase.IDLE
                self._note("server_refused", server.id, reply.reason)
            case "reserve" | "renew", Lease():
                if server.phase in (Phase.RESERVING, Phase.LEASED):
                    self._leased(server, reply, now)
            case "renew", Refused() if server.lease:
                self._forget_lease(server, "lease_lost", reply.reason)
                self._seen(server.id, now)

    def _offered(self, server: Server, offer: Offer, now: float) -> None:
        if offer.mismatch:
            server.phase = Phase.IDLE
            self._note("server_mismatch", server.id, offer.mismatch)
            return
        server.phase, server.capacity = Phase.RESERVING, offer.capacity
        self._ask(server, "reserve", now)

    def _empty(self, server: Server, question: Question, now: float) -> None:
        """Nobody answered: the server is not known to the link yet, or left."""
        if question.verb in ("cancel", "release"):
            return
        if server.phase == Phase.LEAVING:
            self._forget_lease(server, "server_lost", "")
            return
        if server.phase == Phase.IDLE:
            return
        if server.empties < len(RETRY_S):
            ask = Ask(0, server.id, question.verb, lease=server.lease, known_ready=server.ready)
            self._later.append((now + RETRY_S[server.empties], ask))
            server.empties += 1
        else:
            self._forget_lease(server, "server_silent", f"no answer to {question.verb}")

    def _batch_answered(self, server: Server, batch: Batch, reply: Reply | None, now: float) -> None:
        if server.batches.get(batch.id) is not batch:
            if isinstance(reply, Outcomes):
                self.late += len(batch.trials)  # it was requeued; whoever is first is counted
            return
        match reply:
            case Running():
                batch.empties = 0
                self._ask_batch(server, batch, now)
                return
            case None if server.phase == Phase.LEASED and batch.empties < len(RETRY_S):
                ask = Ask(0, server.id, "evaluate", lease=server.lease, batch=batch.id, trials=batch.trials)
                self._later.append((now + RETRY_S[batch.empties], ask))
                batch.empties += 1
                return
        del server.batches[batch.id]
        match reply:
            case Outcomes():
                self._count(server, batch, reply)
            case Fault():
                self._faulted(server, batch, reply)
            case Refused(code="lease-lost") if server.lease:
                self._requeue(batch.trials)
                self._forget_lease(server, "lease_lost", reply.reason)
                self._seen(server.id, now)
            case Refused(code="malformed") | Refused(code="mismatch"):
                self._requeue(batch.trials)
                self._forget_lease(server, "server_refused", reply.reason)
            case Refused(code="busy"):
                self._requeue(batch.trials)
                server.slots = server.ready = 0
                self._renew(server, now)
            case _:
                self._requeue(batch.trials)
                if reply is None and server.phase == Phase.LEASED:
                    self._forget_lease(server, "server_silent", "no answer to evaluate")
                elif server.phase == Phase.LEAVING and not server.batches:
                    self._forget_lease(server, "server_lost", "")

    def _count(self, server: Server, batch: Batch, reply: Outcomes) -> None:
        workload = self._workload
        if workload is None:
            return
        try:
            fitness, metrics = codec.outcomes(reply, len(batch.trials), self._participants, self._metrics)
        except RemoteProtocolError as error:
            self._requeue(batch.trials)
            self._forget_lease(server, "malformed", str(error))
            return
        measured = reply.seconds / len(batch.trials)
        server.trial_s = measured if not server.trial_s else 0.7 * server.trial_s + 0.3 * measured
        fresh = ~workload.counted[batch.trials]
        trials = batch.trials[fresh]
        self.late += len(batch.trials) - len(trials)
        if reply.error:
            self._note("simulator_raised", server.id, reply.error, int(np.isnan(fitness).any(axis=1).sum()))
        if not len(trials):
            return
        workload.fitness[trials] = np.where(np.isnan(fitness[fresh]), np.nan, fitness[fresh])  # one bit pattern of NaN
        workload.metrics[trials] = np.where(np.isnan(metrics[fresh]), np.nan, metrics[fresh])
        server.counted += len(trials)
        self._mark_counted(trials, server.id, reply.seconds)

    def _mark_counted(self, trials: np.ndarray, server: str, seconds: float) -> None:
        workload = self._workload
        assert workload is not None  # noqa: S101  callers have one
        workload.counted[trials] = True
        self._rest -= len(trials)
        self._commands.append(Counted(trials, server, seconds))
        if not self._rest:
            self._put_aside()
            self._commands.append(Complete())

    def _faulted(self, server: Server, batch: Batch, fault: Fault) -> None:
        workload = self._workload
        index = min(fault.trial, len(batch.trials) - 1)
        guilty, innocent = batch.trials[index : index + 1], np.delete(batch.trials, index)
        self._requeue(innocent)
        trial = int(guilty[0])
        if workload is None or workload.counted[trial]:
            return
        self._faults[trial] = self._faults.get(trial, 0) + 1
        self._note("fault", server.id, f"{fault.kind}: {fault.reason} (trial {trial}, attempt {self._faults[trial]})")
        if self._faults[trial] < ATTEMPTS:
            self._requeue(guilty, frozenset({server.id}))
        elif self._quarantine:
            workload.faulted[trial] = True
            self._mark_counted(guilty, "", 0.0)
        else:
            self._fail(f"a trial ended in a fault {ATTEMPTS} times, last on {server.id}: {fault.kind}: {fault.reason}")

    def _fail(self, reason: str) -> None:
        self._put_aside()
        self._commands.append(Failed(reason))

    def _put_aside(self) -> None:
        """The workload ended: cancel what is still out of it."""
        self._workload = None
        self._waiting.clear()
        self._unsent = 0
        self._faults.clear()
        for server in self.servers.values():
            if server.batches:
                number = self._next_number()
                self._questions[number] = Question(server.id, "cancel")
                self._commands.append(Ask(number, server.id, "cancel", server.lease, batches=tuple(server.batches)))
                server.batches = {}

    # ---- work

    def _work(self, workload: Workload) -> None:
        self._workload = workload
        self._faults = {}
        trials = np.flatnonzero(~workload.counted)
        self._rest = len(trials)
        self._waiting = deque([Piece(trials)]) if len(trials) else deque()
        self._unsent = len(trials)
        if not len(trials):
            self._workload = None
            self._commands.append(Complete())

    def _requeue(self, trials: np.ndarray, avoid: frozenset[str] = frozenset()) -> None:
        if self._workload is None:
            return
        trials = trials[~self._workload.counted[trials]]
        if len(trials):
            self.requeued += len(trials)
            self._unsent += len(trials)
            self._waiting.appendleft(Piece(trials, avoid))
            self._note("requeued", count=len(trials))

    def _fill(self, now: float) -> None:
        """Keep servers with two batches per slot: first one for every slot of all, then the second."""
        if self._workload is None or not self._unsent:
            return
        serving = [server for server in self.servers.values() if server.phase == Phase.LEASED and server.ready]
        slots = sum(server.ready for server in serving)
        for depth in range(1, DEPTH + 1):
            for server in serving:
                while self._unsent and len(server.batches) < depth * server.ready:
                    trials = self._take(server, slots, [s.id for s in serving])
                    if trials is None:
                        break
                    batch = Batch(self._next_number(), trials)
                    server.batches[batch.id] = batch
                    self._ask_batch(server, batch, now)

    def _take(self, server: Server, slots: int, serving: list[str]) -> np.ndarray | None:
        """Trials for one batch on a server, or None when all that wait should go elsewhere."""
        for piece in self._waiting:
            if server.id not in piece.avoid or piece.avoid.issuperset(serving):
                break
        else:
            return None
        size = min(self._size(server, slots), len(piece.trials))
        taken, rest = piece.trials[:size], piece.trials[size:]
        if len(rest):
            piece.trials = rest
        else:
            self._waiting.remove(piece)
        self._unsent -= size
        return taken

    def _size(self, server: Server, slots: int) -> int:
        if not server.trial_s:
            return 1
        assert self._workload is not None  # noqa: S101  callers have one
        share = self._unsent / (2 * slots * DEPTH)
        smallest, largest = SMALLEST_BATCH_S / server.trial_s, BATCH_S / server.trial_s
        genome = max(1, len(self._workload.genomes[0]))
        fits = min(MAX_TRIALS, MAX_GENOMES // self._participants, MAX_MESSAGE // 2 // (genome * self._participants + 16))
        return int(max(1, min(max(share, smallest), largest, fits)))

    # ---- questions

    def _ask_batch(self, server: Server, batch: Batch, now: float) -> None:
        self._ask(server, "evaluate", now, lease=server.lease, batch=batch)

    def _ask(
        self, server: Server, verb: Verb, now: float, *, lease: bytes = b"", batch: Batch | None = None, known_ready: int = -1
    ) -> None:
        number = self._next_number()
        server.last_asked = now
        self._questions[number] = Question(server.id, verb, batch)
        self._commands.append(
            Ask(
                number,
                server.id,
                verb,
                lease,
                batch.id if batch else 0,
                batch.trials if batch else None,
                known_ready,
            )
        )

    def _tick(self, now: float) -> None:
        due = [ask for time, ask in self._later if time <= now]
        self._later = [(time, ask) for time, ask in self._later if time > now]
        for ask in due:
            server = self.servers[ask.server]
            batch = server.batches.get(ask.batch) if ask.verb == "evaluate" else None
            if server.phase == Phase.IDLE or (ask.verb == "evaluate" and batch is None):
                continue
            if ask.verb == "renew":
                self._renew(server, now)
            else:
                self._ask(server, ask.verb, now, lease=server.lease, batch=batch)
        for server in self.servers.values():
            if server.phase == Phase.LEASED and now - server.last_asked >= RENEW_S:
                self._renew(server, now)

    def _next_number(self) -> int:
        self._next += 1
        return self._next

    def _note(self, event: str, server: str = "", text: str = "", count: int = 0) -> None:
        self._commands.append(Note(event, server, text, count))
