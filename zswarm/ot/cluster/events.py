"""Events that go into the dispatch, and commands that come out."""

import heapq
import math

import msgspec
import numpy as np

from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.workload import Workload
from zswarm.protocol.messages import Reply, Request, Verb, verb

# Until zenoh ends a query without an answer (docs/protocol.md, "Times of a lease").
QUERY_S: dict[Verb, float] = {
    "offer": 3.0,
    "reserve": 10.0,
    "renew": 25.0,
    "evaluate": 60.0,
    "cancel": 3.0,
    "release": 3.0,
}
# After that, a query that zenoh did not end counts as not answered.
MARGIN_S = 15.0
MAX_TEXTS = 16  # of a machine's notes of one event, where servers can have any number


class Seen(msgspec.Struct, frozen=True):
    """A server's liveliness token appeared."""

    server: str
    own: bool = False  # it is this machine's: its token came from the child


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


class Superseded(msgspec.Struct, frozen=True):
    """A server reports that another program resumed the run; the run's record shows if it did."""

    server: str
    reason: str


Command = (
    Ask
    | Counted
    | Disputed
    | ProbeDisputed
    | Retracted
    | Complete
    | Failed
    | Superseded
    | Note
)


class OpenQuery(msgspec.Struct, frozen=True):
    """A query that was sent and not answered yet."""

    server: str
    verb: Verb
    batch: int = 0
    question: int = 0
    asked_at: float = 0.0

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
    _deadlines: list[tuple[float, int]] = []  # of open queries, and of answered ones
    # Names and texts, by event and machine.
    _noted: dict[tuple[RunEvent, str], set[tuple[str, str]]] = {}
    _numbers: int = 0

    def number(self) -> int:
        """Return a new number, for a question or a batch."""
        self._numbers += 1
        return self._numbers

    def ask(self, server: str, message: Request, trials: np.ndarray | None = None) -> int:
        """Send a query; return its number."""
        number = self.number()
        batch, what = getattr(message, "batch", 0), verb(message)
        self.queries[number] = OpenQuery(server, what, batch, number, self.now)
        heapq.heappush(self._deadlines, (self.now + QUERY_S[what] + MARGIN_S, number))
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

    def note_once(
        self, event: RunEvent, server: str, text: str, machine: str, name: str
    ) -> None:
        """Add a note unless there was one of this name and text, or too many of the machine."""
        noted = self._noted.setdefault((event, machine), set())
        if (name, text) not in noted and len(noted) < MAX_TEXTS:
            noted.add((name, text))
            self.note(event, server, text, machine=machine)

    def later(self, delay_s: float, query: OpenQuery) -> None:
        """Repeat a query, of a batch, after a delay."""
        self._later.append((self.now + delay_s, query))

    def due(self) -> list[OpenQuery]:
        """Return the queries that are to be repeated now."""
        due = [query for time, query in self._later if time <= self.now]
        self._later = [(time, query) for time, query in self._later if time > self.now]
        return due

    def overdue(self) -> list[int]:
        """Return the numbers of the open queries whose time is over."""
        numbers = []
        while self._deadline() <= self.now:
            numbers.append(heapq.heappop(self._deadlines)[1])
        return numbers

    def next_time(self) -> float:
        """Return when the next query is to be repeated, or its time is over."""
        return min((self._deadline(), *(time for time, _ in self._later)))

    def _deadline(self) -> float:
        while self._deadlines and self._deadlines[0][1] not in self.queries:
            heapq.heappop(self._deadlines)
        return self._deadlines[0][0] if self._deadlines else math.inf
