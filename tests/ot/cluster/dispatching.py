"""Test a dispatch: events and plain times in, commands out."""

from typing import Any

import numpy as np

from zswarm.ot.cluster.dispatch import Dispatch
from zswarm.ot.cluster.events import (
    Answered,
    Ask,
    Command,
    Counted,
    Event,
    Seen,
    TimePassed,
    Work,
)
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.notes import Note
from zswarm.ot.workload import Workload
from zswarm.protocol.messages import (
    FEATURES,
    Evaluate,
    Fault,
    Lease,
    Offer,
    Outcomes,
    Part,
    Reply,
    Requirements,
    Reserve,
    verb,
)

PROBE = b"digest"
NAN = float("nan")


def terms(slots: int = 100, *, nonce: bytes = bytes(16), **options: Any) -> Terms:
    """Return the terms of a run."""
    reserve = Reserve(
        nonce=nonce,
        epoch=0,
        slots=slots,
        simulator=Part("", {}),
        representation=Part("", {}),
        version_hash="",
        trial_timeout_s=60.0,
    )
    return Terms(requirements=Requirements(), reserve=reserve, **options)


class Optimizer:
    """A dispatch with a clock, which collects its commands."""

    def __init__(self, slots: int = 100, **options: Any) -> None:
        self.dispatch = Dispatch(terms(slots, **options))
        self.requeued = 0  # trials
        self.now = 100.0
        self.commands: list[Command] = []  # of the last event
        self.asked: dict[tuple[str, str], Ask] = {}  # the last one of a server and verb
        self.counted: list[int] = []

    def feed(self, event: Event) -> list[Ask]:
        """Feed an event; return the new questions."""
        self.commands = self.dispatch.handle(event, self.now)
        for command in self.commands:
            if isinstance(command, Ask):
                self.asked[command.server, verb(command.message)] = command
            elif isinstance(command, Note) and command.event == "requeued":
                self.requeued += command.count
            elif isinstance(command, Counted):
                self.counted += command.trials.tolist()
        return [command for command in self.commands if isinstance(command, Ask)]

    def notes(self, event: str) -> list[Note]:
        return [
            command
            for command in self.commands
            if isinstance(command, Note) and command.event == event
        ]

    def answer(self, ask: Ask, reply: Reply | str | None) -> list[Ask]:
        return self.feed(Answered(ask.question, reply))

    def wait(self, seconds: float) -> list[Ask]:
        """Let time pass, with a tick whenever one is wanted; return the new questions."""
        asks, end = [], self.now + seconds
        for _ in range(1000):
            if self.dispatch.next_time() > end:
                self.now = end
                return asks
            self.now = max(self.now, self.dispatch.next_time())
            asks += self.feed(TimePassed())
        raise AssertionError("a loop without delay")

    def join(self, *servers: str, slots: int = 1, trial_s: float = 1.0) -> None:
        """Let servers appear and become ready."""
        for server in servers:
            (ask,) = self.feed(Seen(server))
            (ask,) = self.answer(ask, offer(slots))
            self.answer(ask, lease(server, slots, trial_s=trial_s))

    def work(self, trials: int, genome: bytes = b"g") -> list[Ask]:
        return self.feed(
            Work(
                Workload(
                    [genome],
                    np.zeros((trials, 1), int),
                    np.arange(trials).astype(np.uint64),
                    0,
                )
            )
        )

    @property
    def workload(self) -> Workload:
        assert self.dispatch.batches.workload is not None
        return self.dispatch.batches.workload


def offer(
    capacity: int = 1, mismatch: str = "", *, free: int | None = None, **labels: str
) -> Offer:
    names = dict.fromkeys(("server", "program", "machine"), "")
    none = {"leases": 0, "simulators": [], "representations": []}
    none["free"] = capacity if free is None else free
    fields = {"capacity": capacity, "mismatch": mismatch, "features": FEATURES}
    return Offer(**names, **none, **fields, labels=labels)  # type: ignore[arg-type]


def lease(
    server: str,
    ready: int,
    *,
    state: str = "ready",
    slots: int = 0,
    number: int = 0,
    **fields: object,
) -> Lease:
    token = f"{server}-{number}".encode().ljust(16)
    fields = {"probe": PROBE if ready else b"", "trial_s": 1.0} | fields
    return Lease(lease=token, state=state, slots=max(slots, ready), ready=ready, **fields)  # type: ignore[arg-type]


def outcomes(ask: Ask, *fitness: float, seconds: float = 1.0) -> Outcomes:
    assert ask.trials is not None
    numbers = np.array(fitness or ask.trials, "<f8").tobytes()
    return Outcomes(
        batch=batch(ask), fitness=numbers, metrics=b"", seconds=seconds * len(ask.trials)
    )


def fault(ask: Ask, trial: int = 0) -> Fault:
    return Fault(batch=batch(ask), kind="crashed", trial=trial, reason="killed")


def trials(asks: list[Ask]) -> list[int]:
    """Return the trials of all batches among the commands."""
    return sorted(
        trial for ask in asks if ask.trials is not None for trial in ask.trials.tolist()
    )


def verbs(asks: list[Ask]) -> list[tuple[str, str]]:
    return [(ask.server, verb(ask.message)) for ask in asks]


def batch(ask: Ask) -> int:
    """Return the id of the batch that is asked for."""
    assert isinstance(ask.message, Evaluate)
    return ask.message.batch
