"""Simulate a lab of unequal machines: real state machines on both sides, and links with a rate."""

import heapq
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from msgspec import structs

from tests.ot.cluster.dispatching import offer, terms
from zswarm.ot.cluster.dispatch import Dispatch
from zswarm.ot.cluster.events import (
    Answered,
    Ask,
    Complete,
    Counted,
    Event,
    Failed,
    Gone,
    Seen,
    TimePassed,
    Work,
)
from zswarm.ot.notes import Note
from zswarm.ot.workload import Workload
from zswarm.protocol import codec, messages
from zswarm.protocol.messages import Evaluate, Outcomes, Refused
from zswarm.ss.slots import events
from zswarm.ss.slots.table import SlotTable

TICK_S = 0.25
PREPARE_S = 1.0
RUN = "run"


class Machine(NamedTuple):
    """A server and its link."""

    slots: int = 4
    trial_s: float = 1.0  # of a trial of length 1
    delay_s: float = 0.0005  # one way
    rate: float = 1e8  # bytes/s, each way


class Lab:
    """A run on some machines.

    Args:
        genome: bytes of a candidate.
        length: returns the length of a trial with a seed, in units of a machine's ``trial_s``.
    """

    def __init__(
        self,
        machines: dict[str, Machine],
        *,
        genome: int = 240,
        length: Callable[[int], float] = lambda _seed: 1.0,
        verify: float = 0.0,
    ) -> None:
        self.now = 0.0
        self.length, self.genome = length, genome
        self.notes: list[Note] = []
        self.counted: dict[str, int] = {}  # trials by server, in this generation
        asked = terms(65_535, verify=verify)
        patient = structs.replace(asked.reserve, trial_timeout_s=3600.0)
        self._dispatch = Dispatch(structs.replace(asked, reserve=patient))
        self._heap: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._complete = False
        self.machines: dict[str, _Server] = {}
        for name, machine in machines.items():
            self.add(name, machine)
        self._run(self.now + 2 * PREPARE_S + 1.0)  # one slot is prepared first

    def add(self, name: str, machine: Machine) -> None:
        """Let a server join."""
        self.machines[name] = _Server(self, name, machine)
        self.feed(Seen(name))

    def generation(
        self,
        trials: int,
        *,
        each: int = 1,
        faults: dict[float, Callable[[], None]] | None = None,
    ) -> float:
        """Evaluate a generation of different candidates; return the seconds that it took.

        Args:
            each: trials of a candidate.
            faults: what happens during it, by the seconds after its beginning.
        """
        begun, self._complete, self.counted = self.now, False, {}
        for at, happen in (faults or {}).items():
            self.at(at, happen)
        genomes = [bytes(self.genome)] * math.ceil(trials / each)
        participants = (np.arange(trials) // each).reshape(-1, 1)
        self.workload = Workload(genomes, participants, np.arange(trials, dtype="u8"), 0)
        self.feed(Work(self.workload))
        self._run(begun + 1e5)
        assert self._complete
        assert self.workload.fitness[:, 0].tolist() == list(range(trials))
        return self.now - begun

    def rest(self, seconds: float) -> None:
        """Let time pass between two generations."""
        self._complete = False
        self._run(self.now + seconds)

    def noted(self, event: str) -> int:
        """Return the sum of the counts of an event's notes."""
        return sum(note.count for note in self.notes if note.event == event)

    # ---- time

    def at(self, delay: float, call: Callable[[], None]) -> None:
        """Schedule a call after a time."""
        heapq.heappush(self._heap, (self.now + delay, next(self._order), call))

    def _run(self, until: float) -> None:
        while not self._complete:
            due = max(self.now, self._dispatch.next_time())
            if min(due, self._heap[0][0] if self._heap else math.inf) > until:
                self.now = until
                return
            if self._heap and self._heap[0][0] <= due:
                self.now, _, call = heapq.heappop(self._heap)
                call()
            else:
                self.now = due
                self.feed(TimePassed())

    def feed(self, event: Event) -> None:
        """Give the dispatch an event, and carry out its commands."""
        for command in self._dispatch.handle(event, self.now):
            match command:
                case Ask():
                    self.machines[command.server].asked(command)
                case Counted():
                    trials = len(command.trials)
                    self.counted[command.server] = (
                        self.counted.get(command.server, 0) + trials
                    )
                case Complete():
                    self._complete = True
                case Note():
                    self.notes.append(command)
                case Failed():
                    raise AssertionError(command.reason)


class _Server:
    """A machine with the real slot table, and its link."""

    def __init__(self, lab: Lab, name: str, machine: Machine) -> None:
        self.lab, self.name, self.machine = lab, name, machine
        self.dead = False
        self._stalled_until = 0.0
        self._open: set[int] = set()  # questions
        self._free_at = {"there": 0.0, "back": 0.0}  # the link's directions
        token = name.encode().ljust(16, b"-")
        self._table = SlotTable(
            machine.slots, offer(machine.slots), lambda _: "", lambda: token
        )
        self._lives = [0] * machine.slots
        self._running: dict[int, float] = {}  # when the trial of a slot ends
        self._tick()

    def die(self) -> None:
        """Die: its token vanishes, and its queries end without an answer."""
        self.dead = True
        self.lab.at(0.01, lambda: self.lab.feed(Gone(self.name)))
        for question in self._open:
            self.lab.at(0.02, lambda q=question: self.lab.feed(Answered(q, None)))  # type: ignore[misc]

    def stall(self, seconds: float) -> None:
        """Answer nothing for a while."""
        self._stalled_until = self.lab.now + seconds

    def asked(self, ask: Ask) -> None:
        """Carry a question to the server."""
        if self.dead:
            self.lab.at(0.01, lambda: self.lab.feed(Answered(ask.question, None)))
            return
        self._open.add(ask.question)
        message = ask.message
        batch = isinstance(message, Evaluate)
        size = len(codec.encode(message)) if batch else 200
        event = events.Asked(ask.question, "user", RUN, message)
        self._travel("there", size, lambda: self._handle(event), wait=batch)

    def _travel(
        self, way: str, size: int, arrive: Callable[[], None], *, wait: bool
    ) -> None:
        """Call after the time that some bytes take; without ``wait`` they overtake others."""
        begin = max(self.lab.now, self._free_at[way]) if wait else self.lab.now
        sent = begin + size / self.machine.rate
        if way == "back":
            sent = max(sent, self._stalled_until)
        if wait:
            self._free_at[way] = sent
        self.lab.at(sent - self.lab.now + self.machine.delay_s, arrive)

    def _handle(self, event: events.Event) -> None:
        if self.dead:
            return
        for command in self._table.handle(event, self.lab.now):
            match command:
                case events.Answer():
                    self._answer(command)
                case events.PrepareSlot():
                    done = events.Prepared(command.slot, bytes(64), self.machine.trial_s)
                    self._later(PREPARE_S, done)
                case events.RunChunk():
                    self._evaluate(command)
                case events.StopSlot():
                    stopped = events.Finished(
                        command.slot, Refused(code="cancelled", reason="")
                    )
                    self._lives[command.slot] += 1
                    self._later(self._running[command.slot] - self.lab.now, stopped)
                case events.KillSlot():
                    self._lives[command.slot] += 1
        if (due := self._table.next_time()) < math.inf:
            # Not at once: due times are rounded.
            self.lab.at(max(1e-4, due - self.lab.now), self._look)

    def _answer(self, answer: events.Answer) -> None:
        reply = codec.decode_reply(answer.body)
        wait = isinstance(reply, messages.Outcomes | messages.Running)

        def arrive() -> None:
            if not self.dead:
                self._open.discard(answer.query)
                self.lab.feed(Answered(answer.query, reply))

        self._travel("back", len(answer.body), arrive, wait=wait)

    def _evaluate(self, run: events.RunChunk) -> None:
        seeds = np.frombuffer(run.work.seeds, "<u8").tolist()
        lengths = [self.machine.trial_s * self.lab.length(seed) for seed in seeds]
        reply = Outcomes(
            batch=run.work.batch,
            fitness=np.array(seeds, "<f8").tobytes(),
            metrics=b"",
            seconds=sum(lengths),
        )
        self._running[run.slot] = self.lab.now + lengths[0]
        self._later(sum(lengths), events.Finished(run.slot, reply))

    def _later(self, delay: float, event: events.SlotEvent) -> None:
        life = self._lives[event.slot]

        def happen() -> None:
            if life == self._lives[event.slot]:
                self._handle(event)

        self.lab.at(max(0.0, delay), happen)

    def _look(self) -> None:
        self._handle(events.Tick((0,) * self.machine.slots))

    def _tick(self) -> None:
        if not self.dead:
            self._look()
            self.lab.at(TICK_S, self._tick)
