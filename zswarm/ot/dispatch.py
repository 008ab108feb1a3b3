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

from zswarm.errors import LocalProtocolError, RemoteProtocolError
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
RETRY_S = (0.05, 0.2, 1.0)  # before asking again after an empty answer; then the server is put aside
PAUSE_S = 1.0  # before a server that has no room, or not our lease any more, is asked again
ASIDE_S = 30.0  # before a server that did not answer is looked at again, unless it is seen again before
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
    IDLE = auto()  # it left, or cannot or does not want to serve; it is looked at again when it is seen again
    ASIDE = auto()  # it is looked at again after a time
    RESERVING = auto()
    LEASED = auto()
    LEAVING = auto()  # its token vanished: what it has may still come back


class Batch(msgspec.Struct, eq=False):
    """Trials that a server has."""

    id: int
    trials: np.ndarray
    empties: int = 0  # empty answers in a row


class Server(msgspec.Struct, eq=False):
    """What is known of a server."""

    id: str
    phase: Phase = Phase.SEEN
    lease: bytes = b""  # while LEASED or LEAVING
    capacity: int = 0
    slots: int = 0
    ready: int = 0
    trial_s: float = 0.0  # measured, 0.0: not yet
    last_asked: float = 0.0
    renewing: bool = False
    paused_until: float = 0.0  # it had no room for a batch
    batches: dict[int, Batch] = {}
    abandoned: list[int] = []  # batches given elsewhere that it may still have
    empties: int = 0  # in a row, of questions without a batch
    silent: bool = False  # the user was told so


class Question(msgspec.Struct, eq=False):
    """A question that is out, or asked later."""

    server: str
    verb: Verb
    lease: bytes = b""
    batch: Batch | None = None


ASKED_IN = {"offer": Phase.SEEN, "reserve": Phase.RESERVING, "renew": Phase.LEASED}


class Piece(msgspec.Struct, eq=False):
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
        self._genome_bytes = 0  # of the largest
        self._faults: dict[int, list[str]] = {}  # the servers on which a trial ended in one
        self._later: list[tuple[float, Question]] = []  # to ask at a time
        self._renewal = float("inf")  # no renewal is due before
        self._changed = False  # who serves, or what waits
        self._serving: dict[str, Server] = {}
        self._slots = 0  # of them
        self._hungry: Server | None = None  # the one that has just answered
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
                self._work(event.workload, now)
            case Tick():
                self._tick(now)
            case Leave():
                self._leave(now)
        if not (isinstance(event, Answered) and isinstance(event.reply, Outcomes)):  # which come by the thousand a second
            self._changed = True
            self._renewal = min(
                (s.last_asked + RENEW_S for s in self.servers.values() if s.phase == Phase.LEASED and not s.renewing),
                default=float("inf"),
            )
        self._fill(now)
        return self._commands

    def next_time(self) -> float:
        """When the next Tick is due."""
        return min([self._renewal, *(time for time, _ in self._later)])

    # These four may be called by any thread; list() takes a copy that no other thread changes.

    def slots(self) -> int:
        """Slots that evaluate for this run now."""
        return sum(server.ready for server in list(self.servers.values()) if server.phase == Phase.LEASED)

    def serving(self) -> list[str]:
        """Servers that evaluate for this run now."""
        return [server.id for server in list(self.servers.values()) if server.phase == Phase.LEASED and server.ready]

    def leased(self) -> int:
        """Servers that gave this run a lease, with or without a slot yet."""
        return sum(server.phase == Phase.LEASED for server in list(self.servers.values()))

    def preparing(self) -> list[str]:
        """Servers that get ready for this run."""
        return [s.id for s in list(self.servers.values()) if s.phase == Phase.LEASED and s.slots and not s.ready]

    # ---- servers

    def _seen(self, id_: str, now: float) -> None:
        server = self.servers.setdefault(id_, Server(id_, Phase.IDLE))
        if server.phase == Phase.LEAVING:
            server.phase = Phase.LEASED  # the link was cut and is back before its end was noticed
            self._note("server_back", server.id)
            self._cancel_abandoned(server, now)
            self._renew(server, now)
        elif server.phase in (Phase.IDLE, Phase.ASIDE):
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
                self._abandon(server, batch)  # nobody answered already, and nobody will
            self._forget_if_left(server)
        elif server.phase != Phase.LEAVING:
            server.phase = Phase.IDLE

    def _forget_if_left(self, server: Server) -> None:
        if server.phase == Phase.LEAVING and not server.batches:
            self._forget_lease(server, "server_lost", "")

    def _forget_lease(self, server: Server, note: str, text: str) -> None:
        for batch in list(server.batches.values()):
            self._abandon(server, batch)
        server.phase, server.lease, server.slots, server.ready, server.renewing = Phase.IDLE, b"", 0, 0, False
        self._note(note, server.id, text)

    def _abandon(self, server: Server, batch: Batch) -> None:
        """Give a batch elsewhere that the server may still have."""
        del server.batches[batch.id]
        server.abandoned.append(batch.id)
        self._requeue(batch.trials)

    def _cancel_abandoned(self, server: Server, now: float) -> None:
        if server.abandoned:
            self._ask(server, "cancel", now, batches=tuple(server.abandoned))
            server.abandoned = []

    def _put_aside(self, server: Server, time: float) -> None:
        """Use a server no more, until a time or until it is seen again."""
        server.phase = Phase.ASIDE
        self._later.append((time, Question(server.id, "offer")))

    def _drop(self, server: Server, note: str, text: str, now: float) -> None:
        """Give a lease back that is of no use."""
        self._ask(server, "release", now)
        self._forget_lease(server, note, text)

    def _lost(self, server: Server, reason: str, now: float) -> None:
        """The server ended the lease."""
        leaving = server.phase == Phase.LEAVING
        self._forget_lease(server, "lease_lost", reason)
        if not leaving:
            self._put_aside(server, now + PAUSE_S)

    def _leased(self, server: Server, lease: Lease, now: float) -> None:
        was_ready = server.ready
        server.lease, server.slots, server.ready = lease.lease, lease.slots, lease.ready
        if lease.state == "failed":
            self._drop(server, "server_refused", lease.reason, now)
            return
        if server.phase == Phase.RESERVING:
            server.phase = Phase.LEASED
            self._note("lease_" + lease.state, server.id, count=lease.slots)
            self._cancel_abandoned(server, now)  # it may be the lease of before
        if lease.probe and not self.probe:
            self.probe = lease.probe
        if lease.probe and lease.probe != self.probe:
            self._drop(server, "server_differs", "its outcomes of the probe are not those of the other servers", now)
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
            self._ask(server, "renew", now)

    # ---- answers

    def _answered(self, event: Answered, now: float) -> None:
        question = self._questions.pop(event.question, None)
        if question is None:
            return
        server, verb, reply = self.servers[question.server], question.verb, event.reply
        if isinstance(reply, str):
            self._note("malformed", server.id, reply)
            reply = None
        if question.batch is not None:
            self._batch_answered(server, question.batch, reply, now)
            return
        if verb == "renew" and question.lease == server.lease:
            server.renewing = False
        if server.phase != ASKED_IN.get(verb) or question.lease != server.lease:
            return  # to a cancel or release, or to what has changed since
        if reply is not None:
            server.empties, server.silent = 0, False
        match verb, reply:
            case _, None:
                self._empty(server, verb, now)
            case "offer", Offer():
                self._offered(server, reply, now)
            case "reserve" | "renew", Lease():
                self._leased(server, reply, now)
            case "reserve", Refused(code="lease-lost"):
                server.phase = Phase.IDLE
                self._fail(f"{server.id}: {reply.reason}", now)
            case "renew", Refused(code="lease-lost"):
                self._lost(server, reply.reason, now)
            case "offer" | "reserve", Refused():
                server.phase = Phase.IDLE
                self._note("server_refused", server.id, reply.reason)
            case "renew", Refused():
                self._drop(server, "server_refused", reply.reason, now)
            case _:
                self._note("malformed", server.id, f"{type(reply).__name__} is no answer to {verb}")
                self._empty(server, verb, now)

    def _offered(self, server: Server, offer: Offer, now: float) -> None:
        if offer.mismatch:
            server.phase = Phase.IDLE
            self._note("server_mismatch", server.id, offer.mismatch)
            return
        server.phase, server.capacity = Phase.RESERVING, offer.capacity
        self._ask(server, "reserve", now)

    def _empty(self, server: Server, verb: Verb, now: float) -> None:
        """Nobody answered: the server is not known to the link yet, or left, or is too busy."""
        if server.empties < len(RETRY_S):
            self._later.append((now + RETRY_S[server.empties], Question(server.id, verb, server.lease)))
            server.empties += 1
        else:
            self._fall_silent(server, verb, now)

    def _fall_silent(self, server: Server, verb: Verb, now: float) -> None:
        if server.phase == Phase.LEASED or not server.silent:
            self._forget_lease(server, "server_silent", f"no answer to {verb}")
        server.silent = True
        self._put_aside(server, now + ASIDE_S)

    def _batch_answered(self, server: Server, batch: Batch, reply: Reply | None, now: float) -> None:
        if server.batches.get(batch.id) is not batch:
            if isinstance(reply, Outcomes):
                self.late += len(batch.trials)  # it was given elsewhere, or its workload ended
            return
        if reply is None and server.phase == Phase.LEASED:
            if batch.empties < len(RETRY_S):
                question = Question(server.id, "evaluate", server.lease, batch)
                self._later.append((now + RETRY_S[batch.empties], question))
                batch.empties += 1
            else:
                self._fall_silent(server, "evaluate", now)
            return
        if reply is None:
            self._abandon(server, batch)
        elif isinstance(reply, Running):
            batch.empties = 0
            self._ask(server, "evaluate", now, batch=batch)
        else:
            del server.batches[batch.id]
            match reply:
                case Outcomes():
                    self._count(server, batch, reply, now)
                case Fault():
                    self._faulted(server, batch, reply, now)
                case Refused():
                    self._requeue(batch.trials)
                    self._refused(server, reply, now)
                case _:
                    self._requeue(batch.trials)
                    self._drop(server, "malformed", f"{type(reply).__name__} is no answer to evaluate", now)
        self._forget_if_left(server)

    def _refused(self, server: Server, refused: Refused, now: float) -> None:
        """A server refused a batch."""
        match refused.code:
            case "busy":
                server.paused_until = now + PAUSE_S
                self._later.append((server.paused_until, Question(server.id, "renew", server.lease)))
            case "draining":
                self._gone(server.id)  # its token, too, is on the way out
            case "lease-lost":
                self._lost(server, refused.reason, now)
            case "malformed" | "mismatch":
                self._drop(server, "server_refused", refused.reason, now)

    def _count(self, server: Server, batch: Batch, reply: Outcomes, now: float) -> None:
        workload = self._workload
        assert workload is not None  # noqa: S101  the server's batches are of it
        try:
            if reply.batch != batch.id:
                raise RemoteProtocolError(f"batch {batch.id} was answered with batch {reply.batch}")
            fitness, metrics = codec.outcomes(reply, len(batch.trials), self._participants, self._metrics)
        except RemoteProtocolError as error:
            self._requeue(batch.trials)
            self._drop(server, "malformed", str(error), now)
            return
        measured = reply.seconds / len(batch.trials)
        server.trial_s = measured if not server.trial_s else 0.7 * server.trial_s + 0.3 * measured
        if reply.error:
            self._note("simulator_raised", server.id, reply.error, int(np.isnan(fitness).any(axis=1).sum()))
        workload.fitness[batch.trials] = np.where(np.isnan(fitness), np.nan, fitness)  # one bit pattern of NaN
        workload.metrics[batch.trials] = np.where(np.isnan(metrics), np.nan, metrics)
        self._hungry = server
        self._mark_counted(batch.trials, server.id, reply.seconds)

    def _mark_counted(self, trials: np.ndarray, server: str, seconds: float) -> None:
        workload = self._workload
        assert workload is not None  # noqa: S101  callers have one
        if workload.counted[trials].any():
            raise LocalProtocolError("a trial was counted twice")
        workload.counted[trials] = True
        self._rest -= len(trials)
        self._commands.append(Counted(trials, server, seconds))
        if not self._rest:
            self._workload = None
            self._commands.append(Complete())

    def _faulted(self, server: Server, batch: Batch, fault: Fault, now: float) -> None:
        workload = self._workload
        assert workload is not None  # noqa: S101  the server's batches are of it
        index = min(fault.trial, len(batch.trials) - 1)
        guilty, innocent = batch.trials[index : index + 1], np.delete(batch.trials, index)
        self._requeue(innocent)
        trial = int(guilty[0])
        servers = self._faults.setdefault(trial, [])
        servers.append(server.id)
        self._note("fault", server.id, f"{fault.kind}: {fault.reason} (trial {trial}, attempt {len(servers)})")
        if len(servers) < ATTEMPTS:
            self._requeue(guilty, frozenset(servers))
        elif self._quarantine:
            workload.faulted[trial] = True
            self._mark_counted(guilty, "", 0.0)
        else:
            text = f"a trial ended in a fault {ATTEMPTS} times, last on {server.id}: {fault.kind}: {fault.reason}"
            self._fail(text, now)

    def _fail(self, reason: str, now: float) -> None:
        self._end_workload(now)
        self._commands.append(Failed(reason))

    # ---- work

    def _work(self, workload: Workload, now: float) -> None:
        self._end_workload(now)
        trials = np.flatnonzero(~workload.counted)
        if not len(trials):
            self._commands.append(Complete())
            return
        self._workload = workload
        self._genome_bytes = max(map(len, workload.genomes))
        self._rest = self._unsent = len(trials)
        self._waiting.append(Piece(trials))

    def _end_workload(self, now: float) -> None:
        """Forget what waits, and cancel what is still out."""
        self._workload = None
        self._waiting.clear()
        self._unsent = 0
        self._faults.clear()
        for server in self.servers.values():
            if server.batches:
                self._ask(server, "cancel", now, batches=tuple(server.batches))
                server.batches = {}
                self._forget_if_left(server)

    def _leave(self, now: float) -> None:
        self._end_workload(now)
        for server in self.servers.values():
            if server.lease:
                self._ask(server, "release", now)
            server.phase, server.lease = Phase.IDLE, b""

    def _requeue(self, trials: np.ndarray, avoid: frozenset[str] = frozenset()) -> None:
        if len(trials):
            self._changed = True
            self.requeued += len(trials)
            self._unsent += len(trials)
            self._waiting.appendleft(Piece(trials, avoid))
            self._note("requeued", count=len(trials))

    def _fill(self, now: float) -> None:
        """Keep servers with two batches per slot: first one for every slot of all, then the second."""
        hungry, self._hungry = self._hungry, None
        if self._workload is None or not self._unsent:
            return
        if self._changed:
            self._changed = False
            self._serving = {
                server.id: server
                for server in self.servers.values()
                if server.phase == Phase.LEASED and server.ready and server.paused_until <= now
            }
            self._slots = sum(server.ready for server in self._serving.values())
            servers = list(self._serving.values())
        else:
            servers = [hungry] if hungry is not None and hungry.id in self._serving else []
        for depth in range(1, DEPTH + 1):
            for server in servers:
                while self._unsent and len(server.batches) < depth * server.ready:
                    trials = self._take(server)
                    if trials is None:
                        break
                    batch = Batch(self._next_number(), trials)
                    server.batches[batch.id] = batch
                    self._ask(server, "evaluate", now, batch=batch)

    def _take(self, server: Server) -> np.ndarray | None:
        """Trials for one batch on a server, or None when all that wait should go elsewhere."""
        fitting = (
            index
            for index, piece in enumerate(self._waiting)
            if server.id not in piece.avoid or piece.avoid.issuperset(self._serving)
        )
        index = next(fitting, None)
        if index is None:
            return None
        piece = self._waiting[index]
        size = min(self._size(server), len(piece.trials))
        taken, piece.trials = piece.trials[:size], piece.trials[size:]
        if not len(piece.trials):
            del self._waiting[index]
        self._unsent -= size
        return taken

    def _size(self, server: Server) -> int:
        if not server.trial_s:
            return 1
        share = self._unsent / (2 * self._slots * DEPTH)
        smallest, largest = SMALLEST_BATCH_S / server.trial_s, BATCH_S / server.trial_s
        trial_bytes = (self._genome_bytes + 16) * self._participants + 16
        fits = min(MAX_TRIALS, MAX_GENOMES // self._participants, MAX_MESSAGE // 2 // trial_bytes)
        return int(max(1, min(max(share, smallest), largest, fits)))

    # ---- questions

    def _ask(self, server: Server, verb: Verb, now: float, *, batch: Batch | None = None, batches: tuple[int, ...] = ()) -> None:
        number = self._next_number()
        server.last_asked = now
        self._questions[number] = Question(server.id, verb, server.lease, batch)
        self._commands.append(
            Ask(
                number,
                server.id,
                verb,
                server.lease,
                batch.id if batch else 0,
                batch.trials if batch else None,
                server.ready,
                batches,
            )
        )

    def _tick(self, now: float) -> None:
        due = [question for time, question in self._later if time <= now]
        self._later = [(time, question) for time, question in self._later if time > now]
        for question in due:
            server, batch = self.servers[question.server], question.batch
            if question.verb == "offer" and server.phase == Phase.ASIDE:
                server.phase, server.empties = Phase.SEEN, 0
            if batch is not None:
                if server.batches.get(batch.id) is batch:
                    self._ask(server, "evaluate", now, batch=batch)
            elif server.phase == ASKED_IN[question.verb]:
                if question.verb == "renew":
                    self._renew(server, now)
                else:
                    self._ask(server, question.verb, now)
        for server in self.servers.values():
            if server.phase == Phase.LEASED and server.last_asked + RENEW_S <= now:
                self._renew(server, now)

    def _next_number(self) -> int:
        self._next += 1
        return self._next

    def _note(self, event: str, server: str = "", text: str = "", count: int = 0) -> None:
        self._commands.append(Note(event, server, text, count))
