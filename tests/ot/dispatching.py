"""A dispatch under test: events and plain times in, commands out."""

import numpy as np

from zswarm.ot.dispatch import Answered, Ask, Command, Counted, Dispatch, Event, Note, Seen, Tick, Work
from zswarm.ot.workload import Workload
from zswarm.protocol.messages import Fault, Lease, Offer, Outcomes, Reply

PROBE = b"digest"
NAN = float("nan")


class Optimizer:
    """A dispatch with a clock, that collects what it asks and tells."""

    def __init__(self, **options: object) -> None:
        self.dispatch = Dispatch(1, 0, **{"wanted_slots": 100, "quarantine": False} | options)  # type: ignore[arg-type]
        self.now = 100.0
        self.commands: list[Command] = []  # of the last event
        self.asked: dict[tuple[str, str], Ask] = {}  # the last one of a server and verb
        self.counted: list[int] = []

    def feed(self, event: Event) -> list[Ask]:
        """What is asked now."""
        self.commands = self.dispatch.handle(event, self.now)
        for command in self.commands:
            if isinstance(command, Ask):
                self.asked[command.server, command.verb] = command
            elif isinstance(command, Counted):
                self.counted += command.trials.tolist()
        return [command for command in self.commands if isinstance(command, Ask)]

    def notes(self, event: str) -> list[Note]:
        return [command for command in self.commands if isinstance(command, Note) and command.event == event]

    def answer(self, ask: Ask, reply: Reply | str | None) -> list[Ask]:
        return self.feed(Answered(ask.question, reply))

    def wait(self, seconds: float) -> list[Ask]:
        """Let time pass, with a tick whenever one is wanted; what is asked then."""
        asks, end = [], self.now + seconds
        for _ in range(1000):
            if self.dispatch.next_time() > end:
                self.now = end
                return asks
            self.now = max(self.now, self.dispatch.next_time())
            asks += self.feed(Tick())
        raise AssertionError("a loop without delay")

    def join(self, *servers: str, slots: int = 1, trial_s: float = 1.0) -> None:
        """Servers appear and are ready."""
        for server in servers:
            (ask,) = self.feed(Seen(server))
            (ask,) = self.answer(ask, offer(slots))
            self.answer(ask, lease(server, slots, trial_s=trial_s))

    def work(self, trials: int, genome: bytes = b"g") -> list[Ask]:
        return self.feed(Work(Workload([genome], np.zeros((trials, 1), int), np.arange(trials).astype(np.uint64), 0)))

    @property
    def workload(self) -> Workload:
        assert self.dispatch._workload is not None
        return self.dispatch._workload


def offer(capacity: int = 1, mismatch: str = "", **labels: str) -> Offer:
    return Offer(
        server="", program="", machine="", capacity=capacity, free=0, leases=0, simulators=[], representations=[],
        mismatch=mismatch, labels=labels,
    )  # fmt: skip


def lease(server: str, ready: int, *, state: str = "ready", slots: int = 0, number: int = 0, **fields: object) -> Lease:
    token = f"{server}-{number}".encode().ljust(16)
    fields = {"probe": PROBE if ready else b"", "trial_s": 1.0} | fields
    return Lease(lease=token, state=state, slots=max(slots, ready), ready=ready, lease_s=60.0, **fields)  # type: ignore[arg-type]


def outcomes(ask: Ask, *fitness: float, seconds: float = 1.0) -> Outcomes:
    assert ask.trials is not None
    numbers = np.array(fitness or ask.trials, "<f8")
    return Outcomes(batch=ask.batch, fitness=numbers.tobytes(), metrics=b"", seconds=seconds * len(ask.trials))


def fault(ask: Ask, trial: int = 0) -> Fault:
    return Fault(batch=ask.batch, kind="crashed", trial=trial, reason="killed")


def trials(asks: list[Ask]) -> list[int]:
    """Of all the batches among them."""
    return sorted(trial for ask in asks if ask.trials is not None for trial in ask.trials.tolist())


def verbs(asks: list[Ask]) -> list[tuple[str, str]]:
    return [(ask.server, ask.verb) for ask in asks]
