"""Events that go into the dispatch, and commands that come out."""

import math

import msgspec
import numpy as np

from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.workload import Workload
from zswarm.protocol.messages import Reply, Request, Verb, verb

MAX_TEXTS = 16  # of a machine's notes of one event, where servers can have any number


class Seen(msgspec.Struct, frozen=True):
    """A server's liveliness token appeared."""

    server: str


class Gone(msgspec.Struct, frozen=True):
    """A server's liveliness token vanished: it drains or ended, or its link is cut."""

    server: str


class Answered(msgspec.Struct, frozen=True):
    """A query ended: with a reply, without one (None), or with why the reply could not be read.

    Zenoh ends a query without a reply when its time is over, and earlier when the link breaks, or
    if no program is there to answer.
    """

    question: int
    reply: Reply | str | None
    machine: str = ""  # that answered; "": not known


class Work(msgspec.Struct, frozen=True):
    """Evaluate a workload, instead of the present one."""

    workload: Workload


class Arbitrated(msgspec.Struct, frozen=True):
    """This machine computed the outcome of a disputed trial."""

    trial: int
    fitness: np.ndarray  # (participants,) float64
    metrics: np.ndarray  # (metrics,) float64


class ProbeArbitrated(msgspec.Struct, frozen=True):
    """This machine computed the digest of the probe's outcomes."""

    digest: bytes


class TimePassed(msgspec.Struct, frozen=True):
    """The time that was asked for has come."""


class Pause(msgspec.Struct, frozen=True):
    """The run pauses, and holds no slots; or the pause is over."""

    paused: bool


class Leave(msgspec.Struct, frozen=True):
    """Release all leases."""


Event = (
    Seen
    | Gone
    | Answered
    | Work
    | Arbitrated
    | ProbeArbitrated
    | TimePassed
    | Pause
    | Leave
)


class Ask(msgspec.Struct, frozen=True):
    """Send a message to a server; the answer comes as Answered with the same number."""

    question: int
    server: str
    message: Request
    trials: np.ndarray | None = None  # of an Evaluate: indices into the workload


class Counted(msgspec.Struct, frozen=True):
    """Trials were evaluated for the first time; the workload holds their outcomes."""

    trials: np.ndarray
    server: str
    seconds: float


class Disputed(msgspec.Struct, frozen=True):
    """Two servers computed different outcomes of a trial: to be answered with Arbitrated."""

    trial: int


class ProbeDisputed(msgspec.Struct, frozen=True):
    """Two servers have different digests of the probe: to be answered with ProbeArbitrated."""

    trials: int  # first ones of the probe; the last of them differs


class Retracted(msgspec.Struct, frozen=True):
    """Trials that were counted for a server do not count: it computes wrong outcomes."""

    server: str


class Complete(msgspec.Struct, frozen=True):
    """All trials of the workload are counted, and checked if they are to be."""


class Failed(msgspec.Struct, frozen=True):
    """The workload cannot be evaluated."""

    reason: str


Command = Ask | Counted | Disputed | ProbeDisputed | Retracted | Complete | Failed | Note


class OpenQuery(msgspec.Struct, frozen=True):
    """A query that was sent and not answered yet."""

    server: str
    verb: Verb
    batch: int = 0
    question: int = 0

    def not_answered_by(self, reply: Reply | None) -> str:
        """Describe a reply of a kind that does not answer the query."""
        return f"{type(reply).__name__} is not an answer to {self.verb}"


class Outbox(msgspec.Struct, eq=False):
    """Collect the commands of one event; remember open queries, and when to send one again."""

    now: float = 0.0  # time of the event
    failure: str = ""  # why the workload cannot be evaluated; "" if it can
    commands: list[Command] = []
    queries: dict[int, OpenQuery] = {}
    _later: list[tuple[float, OpenQuery]] = []
    _noted: dict[tuple[RunEvent, str], set[str]] = {}  # texts, by event and machine
    _numbers: int = 0

    def number(self) -> int:
        """Return a new number, for a question or a batch."""
        self._numbers += 1
        return self._numbers

    def ask(self, server: str, message: Request, trials: np.ndarray | None = None) -> int:
        """Send a query; return its number."""
        number = self.number()
        batch = getattr(message, "batch", 0)
        self.queries[number] = OpenQuery(server, verb(message), batch, number)
        self.commands.append(Ask(number, server, message, trials))
        return number

    def note(
        self,
        event: RunEvent,
        server: str = "",
        text: str = "",
        count: int = 0,
        machine: str = "",
    ) -> None:
        """Add a note."""
        self.commands.append(Note(event, server, text, count, machine))

    def note_once(self, event: RunEvent, server: str, text: str, machine: str) -> None:
        """Add a note unless there was one of this machine and text, or too many of the machine."""
        texts = self._noted.setdefault((event, machine), set())
        if text not in texts and len(texts) < MAX_TEXTS:
            texts.add(text)
            self.note(event, server, text, machine=machine)

    def later(self, delay_s: float, query: OpenQuery) -> None:
        """Repeat a query, of a batch, after a delay."""
        self._later.append((self.now + delay_s, query))

    def due(self) -> list[OpenQuery]:
        """Return the queries that are to be repeated now."""
        due = [query for time, query in self._later if time <= self.now]
        self._later = [(time, query) for time, query in self._later if time > self.now]
        return due

    def next_time(self) -> float:
        """Return when the next query is to be repeated."""
        return min((time for time, _ in self._later), default=math.inf)
