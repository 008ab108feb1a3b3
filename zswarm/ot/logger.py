"""Loggers follow a run: the displays, the record of a study, and what a user adds."""

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from msgspec import structs

from zswarm.champion.controller import Controller
from zswarm.champion.held_out import HeldOut
from zswarm.experiment import Experiment
from zswarm.ot.notes import Note

WAITING = 1000  # calls that a slow logger may be behind; later ones are dropped
LAST_CALLS_S = 10.0  # for the calls that wait at the end of a run


class Started(NamedTuple):
    """A run that begins or resumes."""

    folder: Path
    experiment: Experiment
    generation: int  # the first that will be evaluated


class Generation(NamedTuple):
    """A generation that ended."""

    generation: int
    best: float
    mean: float
    evaluations: int
    servers: int
    slots: int
    statistics: dict[str, float]  # of the optimizer; best and mean among them
    # Expected: generations of the run, and the assessment's trials as a share of the search's.
    last: int = 0
    after: float = 0.0
    trials: int = 1  # of a candidate: best and mean are those of their sums; 1 for scores


class Result(NamedTuple):
    """A run that ended."""

    run: str
    generations: int
    best: float
    evaluations: int
    requeued: int
    history_hash: str
    seconds: float
    faulted: int
    doubtful: int  # trials of a server that was later proved to compute wrong
    # Best is a score of the last generation, and compares only within it.
    relative: bool = False
    history_version: int = 0  # of the history hash: others do not compare
    champion: HeldOut | None = None  # fitness on held-out seeds, if it was assessed
    # 32 hex digits: of the history and the assessment after it.
    assessment_hash: str = ""
    trials: int = 1  # of a candidate: fitness is their sum; 1 for scores
    repeatable: bool = True  # the same trial has the same outcome

    def as_object(self) -> dict[str, Any]:
        """Return what is reported to programs."""
        champion = None if self.champion is None else structs.asdict(self.champion)
        return {**self._asdict(), "champion": champion}


class Logger:
    """Follow one run at a time; override the calls that matter."""

    def on_start(self, run: Started) -> None:
        """Called when the run begins or resumes."""

    def on_say(self, line: str) -> None:
        """Called with a line for people."""

    def on_wait(self, line: str) -> None:
        """Called with what the run waits for, and since when, until a slot is ready.

        That is when it changes, every 1.5 s in the first minute, and every minute later.
        """

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        """Called several times a second with the finished trials of a generation.

        During the assessment, ``generation`` is the number of all generations, and ``trials``
        is how many the assessment has at most.
        """

    def on_generation(self, generation: Generation) -> None:
        """Called when a generation ended; it is recorded soon after."""

    def on_champion(self, champion: Controller) -> None:
        """Called for a better controller; for each generation's, if scores do not compare.

        After the assessment it is called for the champion, which then has ``held_out``.
        """

    def on_event(self, event: Note) -> None:
        """Called for each event, as in the table ``events`` of the record."""

    def on_end(self, result: Result | None) -> None:
        """Called last, when the run ended or was stopped (None)."""


class Forwarder(Logger):
    """Pass every call to ``forward`` as a method's name and its arguments."""

    def forward(self, method: str, *arguments: Any) -> None:
        """Take a call."""
        raise NotImplementedError


def _forwarding(method: str) -> Callable[..., None]:
    return lambda self, *arguments: self.forward(method, *arguments)


for _method in [name for name in vars(Logger) if name.startswith("on_")]:
    setattr(Forwarder, _method, _forwarding(_method))


class Loggers(Forwarder):
    """Call several loggers, one after the other."""

    def __init__(self, loggers: Iterable[Logger]) -> None:
        self._loggers = list(loggers)

    def forward(self, method: str, *arguments: Any) -> None:
        for logger in self._loggers:
            getattr(logger, method)(*arguments)


class InBackground(Forwarder):
    """Call a user's logger in a thread, so that neither its errors nor its slowness stop the run.

    ``say`` takes lines about it: the first error that it raises, and whether it was too slow.
    """

    def __init__(self, logger: Logger, say: Callable[[str], None]) -> None:
        self._name, self._logger, self._say = type(logger).__name__, logger, say
        self._calls: queue.Queue[tuple[str, tuple[Any, ...]] | None] = queue.Queue(
            WAITING
        )
        self._dropped, self._raised = 0, False
        self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)

    def on_start(self, run: Started) -> None:
        self._thread.start()
        super().on_start(run)

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        if self._calls.empty():  # while it is behind, the next call makes up for this one
            super().on_progress(generation, counted, trials)

    def on_end(self, result: Result | None) -> None:
        """Make the last call, and wait a few seconds for it."""
        if not self._thread.is_alive():
            return
        deadline = time.monotonic() + LAST_CALLS_S
        lasts = (("on_end", (result,)), None)
        try:
            for last in lasts:
                self._calls.put(last, timeout=max(0.0, deadline - time.monotonic()))
        except queue.Full:  # drop what waits: the thread ends if the logger ever returns
            with contextlib.suppress(queue.Empty):
                while True:
                    self._calls.get_nowait()
            for last in lasts:
                self._calls.put_nowait(last)
        self._thread.join(max(0.0, deadline - time.monotonic()))
        if self._thread.is_alive():
            self._say(f"logger {self._name} hangs and was abandoned")
        elif self._dropped:
            self._say(
                f"logger {self._name} was too slow: {self._dropped} of its calls were dropped"
            )

    def forward(self, method: str, *arguments: Any) -> None:
        try:
            self._calls.put_nowait((method, arguments))
        except queue.Full:
            self._dropped += 1

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            method, arguments = call
            try:
                getattr(self._logger, method)(*arguments)
            except (Exception, SystemExit) as error:
                # In the user's code: the run continues.
                if not self._raised:
                    reason = f"{type(error).__name__}: {error}"
                    self._say(f"logger {self._name}: {reason}; the run continues")
                self._raised = True
