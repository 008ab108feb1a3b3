"""Which server evaluates what: a pure state machine. Events and the time go in, commands come out.

A server is seen, asked for its offer, reserved, prepared, and then kept with two batches, which it hands out to its slots by
itself. A batch is as large as 75 ms of measured work for each of these slots, and shrinks towards the end of a workload that
several servers share. Every trial is counted once: a result that comes a second time is dropped, and what a server did not
answer goes elsewhere, or is asked for again when the server is back first.
A share of the trials may be evaluated a second time elsewhere; a server that computes other bits is used no more.
"""

from collections.abc import Sequence
from enum import Enum, auto
from typing import Literal

import msgspec
import numpy as np

from zswarm.errors import LocalProtocolError, RemoteProtocolError
from zswarm.ot.matching import Choice
from zswarm.ot.verification import Checks
from zswarm.ot.waiting import Waiting
from zswarm.ot.workload import Workload, one_nan
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

DEPTH = 2  # batches out per server: of one trials run, the other waits
BATCH_S = 0.075  # of work in a batch for each slot, by measured time
SERVER_S = 0.002  # of work for each slot for each server that serves: messages cost the optimizer a quarter of its time at most
SMALLEST_BATCH_S = 0.003  # of work for each slot: shorter than the way to a server and back, two batches would not keep it busy
RENEW_S = 20.0  # a third of the lease time; whatever else is asked, for slots may have gone to other runs
RETRY_S = (0.05, 0.2, 1.0)  # before asking again after an empty answer; then the server is put aside
SETTLE_S = 1.0  # from the first offer until slots are reserved, where not all there are may be: the best ones come, too
PAUSE_S = 1.0  # before a server that has no room, or not our lease any more, is asked again
ASIDE_S = 30.0  # before a server that did not answer is looked at again, unless it is seen again before
ATTEMPTS = 3  # of a trial that ends in a fault
BLAMED = 3  # trials that end in a fault on a server and in an outcome elsewhere: so many, and this share of what it did,
BLAMED_SHARE = 0.01  # and the server is put aside
FAULTY_S = 600.0

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

    workload: Workload


class Settled(msgspec.Struct, frozen=True):
    """What a disputed trial's outcome is, by the optimizer's own machine."""

    trial: int
    fitness: np.ndarray  # (participants,) float64
    metrics: np.ndarray  # (metrics,) float64


class ProbeSettled(msgspec.Struct, frozen=True):
    """What the digest of the probe's outcomes is, by the optimizer's own machine."""

    digest: bytes


class Tick(msgspec.Struct, frozen=True):
    """Time passed."""


class Leave(msgspec.Struct, frozen=True):
    """Give all leases back."""


Event = Seen | Gone | Answered | Work | Settled | ProbeSettled | Tick | Leave


# ---- commands -----------------------------------------------------------------------------------------------------


class Ask(msgspec.Struct, frozen=True):
    """Ask a server; the answer comes back as Answered with the same number."""

    question: int
    server: str
    verb: Verb
    lease: bytes = b""
    batch: BatchId = 0
    trials: np.ndarray | None = None  # indices into the workload, of an evaluate
    slots: int = 0  # of a reserve
    known_ready: int = -1
    batches: tuple[int, ...] = ()  # of a cancel


class Counted(msgspec.Struct, frozen=True):
    """Trials were evaluated, for the first time; the workload holds their outcomes."""

    trials: np.ndarray
    server: str
    seconds: float


class Disputed(msgspec.Struct, frozen=True):
    """Two servers computed different outcomes of a trial: answered by Settled."""

    trial: int


class ProbeDisputed(msgspec.Struct, frozen=True):
    """Two servers have different digests of the probe's outcomes: answered by ProbeSettled."""


class Retracted(msgspec.Struct, frozen=True):
    """What a server counted for in this workload is counted no more: it computes wrong."""

    server: str


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


Command = Ask | Counted | Disputed | ProbeDisputed | Retracted | Complete | Failed | Note


# ---- state --------------------------------------------------------------------------------------------------------


class Phase(Enum):
    """How far a server is."""

    SEEN = auto()  # its offer was asked
    IDLE = auto()  # it left, or cannot or does not want to serve; it is looked at again when it is seen again
    ASIDE = auto()  # it is looked at again after a time
    SPARE = auto()  # it matches, and its slots are not wanted now
    RESERVING = auto()
    LEASED = auto()
    LEAVING = auto()  # its token vanished: what it has may still come back
    BARRED = auto()  # it computes wrong: never used again


class Batch(msgspec.Struct, eq=False):
    """Trials that a server has."""

    id: int
    trials: np.ndarray
    avoid: frozenset[str] = frozenset()  # servers on which a trial of it ended in a fault
    check: bool = False  # its trials are counted: evaluated a second time, to compare
    empties: int = 0  # empty answers in a row
    given: bool = False  # none of it waits for a slot any more
    left: int = -1  # trials whose outcomes did not come
    told: np.ndarray | None = None  # (trials,) bool, whether the outcome came; None: of none

    def __post_init__(self) -> None:
        self.left = len(self.rest())

    def rest(self) -> np.ndarray:
        """These trials."""
        return self.trials if self.told is None else self.trials[~self.told]


class Server(msgspec.Struct, eq=False):
    """What is known of a server."""

    id: str
    phase: Phase = Phase.SEEN
    lease: bytes = b""  # while LEASED or LEAVING
    probe: bytes = b""  # digest of its outcomes of the probe
    former: bytes = b""  # the lease that was left to itself
    capacity: int = 0
    place: tuple[float, ...] = ()  # among the servers, by rank
    mismatch: str = ""  # that the user was told
    wanted: int = 0  # slots that were asked for, while RESERVING, LEASED or LEAVING
    slots: int = 0
    ready: int = 0
    trial_s: float = 0.0  # measured, 0.0: not yet
    renewed: float = 0.0  # its lease was asked for then
    renewing: bool = False
    paused_until: float = 0.0  # it had no room for a batch
    batches: dict[int, Batch] = {}
    left: dict[int, Batch] = {}  # batches that it may still have, and that wait for whoever is first
    abandoned: list[int] = []  # batches of its lease that it may still have and that nobody wants any more
    counted: int = 0  # trials
    blamed: int = 0  # trials that ended in a fault here and in an outcome elsewhere
    faulty: bool = False  # put aside for that
    empties: int = 0  # in a row, of questions without a batch
    silent: bool = False  # the user was told so


class Question(msgspec.Struct, eq=False):
    """A question that is out, or asked later."""

    server: str
    verb: Verb
    lease: bytes = b""
    batch: Batch | None = None


ASKED_IN = {"offer": Phase.SEEN, "reserve": Phase.RESERVING, "renew": Phase.LEASED}


class Dispatch:
    """The state machine; ``handle`` is its only entry, ``next_time`` says when it wants a Tick."""

    def __init__(
        self,
        participants: int,
        metrics: int,
        *,
        wanted_slots: int,
        quarantine: bool,
        choice: Choice = Choice(),  # noqa: B008  it never changes
        probe: bytes = b"",
        verify: float = 0.0,
    ) -> None:
        """Start with no server known.

        Args:
            participants, metrics: numbers per trial, of the simulator.
            wanted_slots: to reserve on every server.
            quarantine: count a trial that faults again and again as NaN, instead of stopping.
            choice: which servers, in which order, and how many slots of them all.
            probe: digest of the probe's outcomes that servers have; b"": the first server's. On the first difference the
                optimizer's own machine decides.
            verify: share of the trials to evaluate on a second server, too.
        """
        self.servers: dict[str, Server] = {}
        self.probe = probe
        self._probe_disputed = self._probe_settled = False
        self.requeued = 0  # trials sent again after they were out
        self.late = 0  # results that were counted before
        self._participants = participants
        self._metrics = metrics
        self._wanted = min(wanted_slots, MAX_SLOTS)
        self._choice = choice
        self._allot_at = float("inf")  # slots may be missing, and are reserved then
        self._quarantine = quarantine
        self._questions: dict[int, Question] = {}
        self._next = 0
        self._workload: Workload | None = None
        self._rest = 0  # trials not counted
        self._waiting = Waiting()
        self._genome_bytes = 0  # of the largest
        self._faults: dict[int, list[str]] = {}  # the servers on which a trial ended in one
        self._checks = Checks(verify)
        self._alone = False  # the user was told that there is no second server
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
            case Settled():
                self._settled(event, now)
            case ProbeSettled():
                self._settle_probe(event.digest, now)
            case Tick():
                self._tick(now)
            case Leave():
                self._leave(now)
        if self._allot_at <= now:
            self._allot(now)
        self._fill(now)
        return self._commands

    def next_time(self) -> float:
        """When the next Tick is due."""
        return min([self._renewal, self._allot_at, *(time for time, _ in self._later)])

    # These five may be called by any thread; list() takes a copy that no other thread changes.

    def slots(self) -> int:
        """Slots that evaluate for this run now."""
        return sum(server.ready for server in list(self.servers.values()) if server.phase == Phase.LEASED)

    def serving(self) -> list[str]:
        """Servers that evaluate for this run now."""
        return [server.id for server in list(self.servers.values()) if server.phase == Phase.LEASED and server.ready]

    def leased(self) -> int:
        """Servers that gave this run a lease, with or without a slot yet."""
        return sum(server.phase == Phase.LEASED for server in list(self.servers.values()))

    def spare(self) -> int:
        """Servers that match, and whose slots are not wanted now."""
        return sum(server.phase == Phase.SPARE for server in list(self.servers.values()))

    def preparing(self) -> list[str]:
        """Servers that get ready for this run."""
        return [s.id for s in list(self.servers.values()) if s.phase == Phase.LEASED and s.slots and not s.ready]

    # ---- servers

    def _seen(self, id_: str, now: float) -> None:
        server = self.servers.setdefault(id_, Server(id_, Phase.IDLE))
        if server.phase == Phase.LEAVING:
            server.phase = Phase.LEASED  # the link was cut and is back before its end was noticed
            self._changed = True
            self._allot_soon()
            self._note("server_back", server.id)
            self._return_to(server, now)
            self._renew(server, now)
        elif server.phase in (Phase.IDLE, Phase.ASIDE, Phase.SPARE):
            server.phase, server.empties = Phase.SEEN, 0
            self._ask(server, "offer", now)

    def _gone(self, id_: str) -> None:
        """What a server has out ends by itself: with a reply when it drains, with nothing when it died."""
        server = self.servers.get(id_)
        if server is None:
            return
        if server.phase == Phase.LEASED:
            self._note("server_left", id_, f"{sum(batch.left for batch in server.batches.values())} trials were with it")
            server.phase = Phase.LEAVING
            self._changed = True
            self._allot_soon()
            for batch in [batch for batch in server.batches.values() if batch.empties]:
                self._abandon(server, batch)  # nobody answered already, and nobody will
            self._forget_if_left(server)
        elif server.phase not in (Phase.LEAVING, Phase.BARRED):
            if server.phase == Phase.RESERVING:
                self._allot_soon()
            server.phase = Phase.IDLE

    def _forget_if_left(self, server: Server) -> None:
        if server.phase == Phase.LEAVING and not server.batches:
            self._forget_lease(server, "server_lost", "")

    def _forget_lease(self, server: Server, note: str, text: str, *, ended: bool = False) -> None:
        """Do without a lease; one that has not ended is gone back to when the server is there again in time."""
        for batch in list(server.batches.values()):
            self._abandon(server, batch)
        self._changed = True
        self._allot_soon()
        server.former = server.lease or server.former
        if ended:
            self._end_former(server)
        server.phase, server.lease, server.slots, server.ready, server.renewing = Phase.IDLE, b"", 0, 0, False
        self._note(note, server.id, text)

    def _abandon(self, server: Server, batch: Batch) -> None:
        """Give a batch elsewhere that the server may still have; it is the server's again if that is back before."""
        del server.batches[batch.id]
        if batch.check:
            server.abandoned.append(batch.id)
            self._give_back(batch)
        else:
            batch.empties = 0
            server.left[batch.id] = batch
            self._requeue(batch.rest(), batch.avoid, (server.id, batch.id))

    def _return_to(self, server: Server, now: float) -> None:
        """The lease of before stands: ask for what it has and still is wanted, and cancel the rest."""
        for number, _ in self._waiting.take_left(server.id):
            batch = msgspec.structs.replace(server.left.pop(number))  # another one: answers of before are not for it
            server.batches[number] = batch
            self._ask(server, "evaluate", now, batch=batch)
        if server.abandoned:
            self._ask(server, "cancel", now, batches=tuple(server.abandoned))
            server.abandoned = []

    def _end_former(self, server: Server) -> None:
        """The lease of before has ended, and with it what the server had."""
        server.former, server.abandoned, server.left = b"", [], {}
        self._waiting.forget_left(server.id)

    def _put_aside(self, server: Server, time: float) -> None:
        """Use a server no more, until a time or until it is seen again."""
        server.phase = Phase.ASIDE
        self._allot_soon()
        self._later.append((time, Question(server.id, "offer")))

    def _drop(self, server: Server, note: str, text: str, now: float) -> None:
        """Give a lease back that is of no use."""
        self._ask(server, "release", now)
        self._forget_lease(server, note, text, ended=True)

    def _lost(self, server: Server, reason: str, now: float) -> None:
        """The server ended the lease."""
        leaving = server.phase == Phase.LEAVING
        self._forget_lease(server, "lease_lost", reason, ended=True)
        if not leaving:
            self._put_aside(server, now + PAUSE_S)

    def _leased(self, server: Server, lease: Lease, now: float) -> None:
        was_ready = server.ready
        server.lease, server.slots, server.ready = lease.lease, lease.slots, lease.ready
        self._allot_soon()
        if lease.state == "failed":
            self._drop(server, "server_refused", lease.reason, now)
            return
        if server.phase == Phase.RESERVING:
            server.phase = Phase.LEASED
            self._note("lease_" + lease.state, server.id, count=lease.slots)
            if lease.lease == server.former:
                self._return_to(server, now)
            self._end_former(server)
        if lease.probe:
            server.probe, self.probe = lease.probe, self.probe or lease.probe
            if server.probe != self.probe:
                self._differs(server, now)
                return
        if not server.trial_s:
            server.trial_s = lease.trial_s
        self._changed |= lease.ready != was_ready
        self._renew_by(server.renewed + RENEW_S)
        if lease.ready != was_ready:
            self._note("server_slots" if was_ready else "server_joined", server.id, count=lease.ready)
        if server.ready < min(server.wanted, server.capacity):
            self._renew(server, now)  # held by the server until more slots are ready

    def _renew_by(self, time: float) -> None:
        self._renewal = min(self._renewal, time)

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
            self._renew_by(server.renewed + RENEW_S)
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
                self._allot_soon()
                self._note("server_refused", server.id, reply.reason)
            case "renew", Refused():
                self._drop(server, "server_refused", reply.reason, now)
            case _:
                self._note("malformed", server.id, f"{type(reply).__name__} is no answer to {verb}")
                self._empty(server, verb, now)

    def _offered(self, server: Server, offer: Offer, now: float) -> None:
        if mismatch := self._choice.mismatch(offer):
            server.phase = Phase.IDLE
            if server.mismatch != mismatch:
                self._note("server_mismatch", server.id, mismatch)
            server.mismatch = mismatch
            return
        server.phase, server.capacity, server.place, server.mismatch = Phase.SPARE, offer.capacity, self._choice.place(offer), ""
        if self._choice.max_slots:
            self._allot_at = min(self._allot_at, now + SETTLE_S)
        else:
            self._reserve(server, self._wanted, now)

    def _reserve(self, server: Server, slots: int, now: float) -> None:
        server.phase, server.wanted = Phase.RESERVING, slots
        self._ask(server, "reserve", now)

    def _allot_soon(self) -> None:
        """Slots came or went."""
        if self._choice.max_slots:
            self._allot_at = 0.0

    def _allot(self, now: float) -> None:
        """Hold as many slots as may be, those of the best servers first. What is held stays; what is too much is given back."""
        self._allot_at = float("inf")
        by_place = sorted(self.servers.values(), key=lambda server: server.place)
        room = self._choice.max_slots
        for server in by_place:
            if server.phase == Phase.RESERVING:
                room -= server.wanted
            elif server.phase == Phase.LEASED:
                room -= server.slots  # one that is busy for others may have none, and get some later
        for server in reversed(by_place):
            if room < 0 and server.phase == Phase.LEASED and server.slots:
                room += server.slots
                self._drop(server, "server_spare", "as many slots as wanted are held without it", now)
                server.phase = Phase.SPARE
        for server in by_place:
            if room > 0 and server.phase == Phase.SPARE:
                self._reserve(server, min(room, server.capacity, self._wanted), now)
                room -= server.wanted
        self._allot_at = float("inf")  # the leases that were given back just now are allowed for

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
        if self._workload is None or server.batches.get(batch.id) is not batch:
            if isinstance(reply, Outcomes):
                self.late += len(batch.trials)  # it was given elsewhere, or its workload ended
            return
        self._hungry = server
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
            batch.empties, batch.given = 0, batch.given or reply.given
            if self._count(server, batch, reply, now):
                if batch.left:
                    self._ask(server, "evaluate", now, batch=batch)
                else:
                    del server.batches[batch.id]
        else:
            del server.batches[batch.id]
            match reply:
                case Outcomes():
                    if self._count(server, batch, reply, now):
                        self._give_back(batch)
                case Fault():
                    if self._count(server, batch, reply, now):
                        self._faulted(server, batch, reply.trial, f"{reply.kind}: {reply.reason}", now)
                case Refused(code="malformed"):
                    self._faulted(server, batch, 0, f"refused: {reply.reason}", now)
                case Refused():
                    self._give_back(batch)
                    self._refused(server, reply, now)
                case _:
                    self._give_back(batch)
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
            case "mismatch":
                self._drop(server, "server_refused", refused.reason, now)

    def _count(self, server: Server, batch: Batch, reply: Outcomes | Running | Fault, now: float) -> bool:
        """Take the outcomes that are new; False: they are none of the batch's, and the server is used no more."""
        workload = self._workload
        assert workload is not None  # noqa: S101  the server's batches are of it
        try:
            if reply.batch != batch.id:
                raise RemoteProtocolError(f"batch {batch.id} was answered with batch {reply.batch}")
            rows, fitness, metrics = codec.outcomes(reply, len(batch.trials), self._participants, self._metrics)
        except RemoteProtocolError as error:
            server.batches.pop(batch.id, None)
            self._give_back(batch)
            self._drop(server, "malformed", str(error), now)
            return False
        if not len(rows):
            return True
        measured = reply.seconds / len(rows)
        server.trial_s = measured if not server.trial_s else 0.7 * server.trial_s + 0.3 * measured
        if batch.told is None:
            batch.told = np.zeros(len(batch.trials), bool)
        elif len(new := np.flatnonzero(~batch.told[rows])) < len(rows):
            if not len(new):
                return True
            rows, fitness, metrics = rows[new], fitness[new], metrics[new]
        batch.told[rows] = True
        batch.left -= len(rows)
        trials, fitness, metrics = batch.trials[rows], one_nan(fitness), one_nan(metrics)
        if reply.error and np.isnan(fitness).any():
            self._note("simulator_raised", server.id, reply.error, int(np.isnan(fitness).any(axis=1).sum()))
        if batch.check:
            self._compare(server, trials, fitness, metrics)
            return True
        workload.fitness[trials], workload.metrics[trials] = fitness, metrics
        server.counted += len(trials)
        self._choose_checks(trials, [server.id] * len(trials))
        self._mark_counted(trials, server.id, measured * len(trials))
        if self._faults:
            self._clear_of_blame(trials, server, now)
        return True

    def _mark_counted(self, trials: np.ndarray, server: str, seconds: float) -> None:
        workload = self._workload
        assert workload is not None  # noqa: S101  callers have one
        if workload.counted[trials].any():
            raise LocalProtocolError("a trial was counted twice")
        workload.counted[trials], workload.source[trials] = True, server
        self._rest -= len(trials)
        self._commands.append(Counted(trials, server, seconds))
        self._complete_if_done()

    def _complete_if_done(self) -> None:
        if self._workload is not None and not self._rest and not self._checks.open:
            self._workload = None
            self._commands.append(Complete())

    # ---- faults

    def _faulted(self, server: Server, batch: Batch, index: int, text: str, now: float) -> None:
        workload, rest = self._workload, batch.rest()
        if workload is None or not len(rest):
            return  # it blames a trial whose outcome it told, or that nobody waits for any more
        trial = int(batch.trials[min(index, len(batch.trials) - 1)])
        if trial not in rest:
            trial = int(rest[0])
        which = f"trial {trial}, its seed {workload.seeds[trial]}"
        guilty = rest[rest == trial]
        self._give_back(Batch(batch.id, rest[rest != trial], batch.avoid, batch.check))
        if batch.check:
            self._note("fault", server.id, f"{text} ({which}, when it was verified)")
            self._checks.drop([trial])
            self._blame(server, now)
            self._complete_if_done()
            return
        servers = self._faults.setdefault(trial, [])
        servers.append(server.id)
        self._note("fault", server.id, f"{text} ({which}, attempt {len(servers)})")
        if len(servers) < ATTEMPTS:
            self._requeue(guilty, frozenset(servers))
        elif self._quarantine:
            workload.faulted[trial] = True
            self._mark_counted(guilty, "", 0.0)
        else:
            self._fail(f"a trial ended in a fault {ATTEMPTS} times, last on {server.id}: {text} ({which})", now)

    def _clear_of_blame(self, trials: np.ndarray, by: Server, now: float) -> None:
        """Trials that ended in faults ended in outcomes elsewhere: the machines were guilty."""
        for trial in trials:
            for id_ in set(self._faults.get(int(trial), [])) - {by.id}:
                self._blame(self.servers[id_], now)

    def _blame(self, server: Server, now: float) -> None:
        server.blamed += 1
        too_many = server.blamed >= max(BLAMED, BLAMED_SHARE * server.counted)
        if too_many and server.phase == Phase.LEASED and set(self.serving()) - {server.id}:
            self._drop(server, "server_faulty", f"{server.blamed} trials that failed on it did not fail elsewhere", now)
            server.blamed, server.counted, server.faulty = 0, 0, True
            self._put_aside(server, now + FAULTY_S)

    def _recall_faulty(self, now: float) -> None:
        """A server that fails at times is better than none."""
        for server in self.servers.values():
            if server.phase == Phase.ASIDE and server.faulty:
                server.faulty = False
                self._put_aside(server, now + PAUSE_S)

    # ---- verification

    def _choose_checks(self, trials: np.ndarray, sources: Sequence[str]) -> None:
        self._checks.choose(trials, sources)
        self._changed |= bool(self._checks.waiting)  # others may be idle

    def _compare(self, server: Server, trials: np.ndarray, fitness: np.ndarray, metrics: np.ndarray) -> None:
        workload = self._workload
        assert workload is not None  # noqa: S101  the server's batches are of it
        disputed = self._checks.compare(server.id, trials, fitness, metrics, workload)
        self._commands += [Disputed(trial) for trial in disputed]
        self._complete_if_done()

    def _settled(self, event: Settled, now: float) -> None:
        for id_ in self._checks.settle(event.trial, event.fitness, event.metrics):
            server = self.servers.setdefault(id_, Server(id_, Phase.IDLE))  # one of before a resume may be gone
            if server.phase != Phase.BARRED:
                self._bar(server, f"its outcome of trial {event.trial} is wrong", now)
        self._complete_if_done()

    def _differs(self, server: Server, now: float) -> None:
        if self._probe_settled:
            self._bar(server, "its outcomes of the probe are wrong", now)
            return
        text = "its outcomes of the probe are not those of other servers; this machine decides who is right"
        self._drop(server, "server_differs", text, now)
        self._put_aside(server, now + ASIDE_S)
        if not self._probe_disputed:
            self._probe_disputed = True
            self._commands.append(ProbeDisputed())

    def _settle_probe(self, digest: bytes, now: float) -> None:
        self.probe, self._probe_settled = digest, True
        for server in list(self.servers.values()):
            if server.probe and server.probe != digest and server.phase != Phase.BARRED:
                self._bar(server, "its outcomes of the probe are wrong", now)
            elif server.probe == digest and server.phase == Phase.ASIDE:
                self._put_aside(server, now)  # it was right: ask it at once

    def _bar(self, server: Server, text: str, now: float) -> None:
        """Use a server never again, and evaluate again what it counted for."""
        if server.lease:
            self._ask(server, "release", now)
        self._commands.append(Retracted(server.id))  # before it is told: the record may end between the two
        self._forget_lease(server, "server_wrong", text, ended=True)
        server.phase = Phase.BARRED
        if self._workload is not None:
            trials = self._workload.retract(server.id)
            self._checks.drop(trials.tolist())
            self._rest += len(trials)
            self._requeue(trials)

    def _do_without_checks(self) -> None:
        """Trials are counted unverified when there is no second server."""
        lonely = self._checks.lonely(self._serving.keys())
        if lonely and not self._alone:
            self._note("unverified", text="no second server is there to verify with")
        self._alone = bool(lonely)
        if lonely:
            self._checks.drop(lonely)
            self._complete_if_done()

    def _fail(self, reason: str, now: float) -> None:
        self._end_workload(now)
        self._commands.append(Failed(reason))

    # ---- work

    def _work(self, workload: Workload, now: float) -> None:
        self._end_workload(now)
        self._workload, self._changed = workload, True
        self._genome_bytes = max(map(len, workload.genomes), default=0)
        trials = np.flatnonzero(~workload.counted)
        self._rest = len(trials)
        if len(trials):
            self._waiting.put(trials)
        restored = np.flatnonzero(workload.source != "")
        self._choose_checks(restored, workload.source[restored].tolist())  # counted, and perhaps not verified
        self._complete_if_done()

    def _end_workload(self, now: float) -> None:
        """Forget what waits, and cancel what is still out."""
        for left in self._waiting.clear():
            self._leave_behind(*left)
        self._workload = None
        self._faults.clear()
        self._checks.clear()
        for server in self.servers.values():
            if server.batches:
                self._ask(server, "cancel", now, batches=tuple(server.batches))
                server.batches = {}
                self._forget_if_left(server)

    def _leave_behind(self, server: str, batch: int) -> None:
        """Nobody wants any more what a server was left with."""
        self.servers[server].abandoned.append(batch)
        del self.servers[server].left[batch]

    def _leave(self, now: float) -> None:
        self._end_workload(now)
        for server in self.servers.values():
            if server.lease:
                self._ask(server, "release", now)
            server.phase, server.lease = Phase.IDLE, b""

    def _give_back(self, batch: Batch) -> None:
        """What is left of a batch that its server does not have any more."""
        rest = batch.rest()
        if batch.check and self._workload is not None:
            self._changed |= bool(len(rest))
            self._checks.give_back(rest, self._workload)
        elif not batch.check:
            self._requeue(rest, batch.avoid)

    def _requeue(self, trials: np.ndarray, avoid: frozenset[str] = frozenset(), left: tuple[str, int] | None = None) -> None:
        if len(trials):
            self._changed = True
            self.requeued += len(trials)
            self._waiting.put(trials, avoid, left)
            self._note("requeued", count=len(trials))

    def _fill(self, now: float) -> None:
        """Keep servers with two batches to hand out to their slots: first one for all servers, then the second."""
        hungry, self._hungry = self._hungry, None
        if self._workload is None or not (self._waiting.trials or self._checks.waiting):
            return
        if self._changed:
            self._changed = False
            self._serving = {
                server.id: server
                for server in self.servers.values()
                if server.phase == Phase.LEASED and server.ready and server.paused_until <= now
            }
            if self._choice.rank:  # who has the first of what is too little for all
                self._serving = dict(sorted(self._serving.items(), key=lambda item: item[1].place))
            self._slots = sum(server.ready for server in self._serving.values())
            if not self._serving:
                self._recall_faulty(now)
            servers = list(self._serving.values())
        else:
            servers = [hungry] if hungry is not None and hungry.id in self._serving else []
        for depth in range(1, DEPTH + 1):
            for server in servers:
                while size := self._size(server, depth):
                    batch = self._take(server, size)
                    if batch is None:
                        break
                    server.batches[batch.id] = batch
                    self._ask(server, "evaluate", now, batch=batch)
        if self._checks.waiting and not self._rest:
            self._do_without_checks()

    def _take(self, server: Server, size: int) -> Batch | None:
        """A batch for a server, or None when all that waits should go elsewhere; trials to verify come last."""
        piece = self._waiting.take(server.id, size, self._serving)
        if piece is None:
            checks = self._checks.take(server.id, size) if self._checks.waiting else None
            return Batch(self._next_number(), checks, check=True) if checks is not None else None
        if piece.left:
            self._leave_behind(*piece.left)
        return Batch(self._next_number(), piece.trials, piece.avoid)

    def _size(self, server: Server, depth: int) -> int:
        """Trials of the next batch for a server that is to have so many batches; 0: it has them.

        Of long trials it has as many for each slot. When it serves alone, what waits is not kept back for others.
        """
        batches = server.batches.values()
        missing = depth * server.ready - sum(batch.left for batch in batches)
        enough = missing <= 0 and sum(not batch.given for batch in batches) >= depth
        if enough or len(batches) >= DEPTH * server.ready:
            return 0
        least = max(1, missing)
        if server.trial_s:
            parts = 2 * DEPTH if len(self._serving) > 1 else 1
            share = self._waiting.trials * server.ready / (self._slots * parts)
            smallest = server.ready * SMALLEST_BATCH_S / server.trial_s
            largest = server.ready * max(1.0, BATCH_S / server.trial_s, len(self._serving) * SERVER_S / server.trial_s)
            least = max(least, int(min(max(share, smallest), largest)))
        sent = (self._genome_bytes + 16) * self._participants + 16
        answered = 8 * (self._participants + self._metrics) + 4
        fits = min(MAX_TRIALS, MAX_GENOMES // self._participants, MAX_MESSAGE // 2 // max(sent, answered))
        return max(1, min(least, fits))

    # ---- questions

    def _ask(self, server: Server, verb: Verb, now: float, *, batch: Batch | None = None, batches: tuple[int, ...] = ()) -> None:
        number = self._next_number()
        if verb in ("reserve", "renew"):
            server.renewed = now
            self._renew_by(now + RENEW_S)
        self._questions[number] = Question(server.id, verb, server.lease, batch)
        self._commands.append(
            Ask(
                number,
                server.id,
                verb,
                server.lease,
                batch.id if batch else 0,
                batch.trials if batch else None,
                server.wanted,
                server.ready,
                batches,
            )
        )

    def _tick(self, now: float) -> None:
        due = [question for time, question in self._later if time <= now]
        self._later = [(time, question) for time, question in self._later if time > now]
        self._changed |= bool(due)  # a pause may have ended
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
            if server.phase == Phase.LEASED and server.renewed + RENEW_S <= now:
                self._renew(server, now)
        self._renewal = min(
            (s.renewed + RENEW_S for s in self.servers.values() if s.phase == Phase.LEASED and not s.renewing),
            default=float("inf"),
        )

    def _next_number(self) -> int:
        self._next += 1
        return self._next

    def _note(self, event: str, server: str = "", text: str = "", count: int = 0) -> None:
        self._commands.append(Note(event, server, text, count))
