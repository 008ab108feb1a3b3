"""Whoever follows a run: the terminal, and what a user adds. One protocol: a logger overrides the calls it wants."""

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from zswarm.controller import Controller
from zswarm.experiment import Experiment
from zswarm.ot.dispatch import Note

WAITING = 1000  # calls that a slow logger may be behind; later ones are dropped
LAST_CALLS_S = 10.0  # at most, at the end of a run


class Started(NamedTuple):
    """A run that begins, or goes on."""

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
    statistics: dict[str, float]  # the optimizer's; best and mean among them


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
    relative: bool = False  # best is the last generation's best score, which compares within that generation only


class Logger:
    """Follows one run at a time; by itself it does nothing."""

    def on_start(self, run: Started) -> None:
        """The run begins, or goes on."""

    def on_say(self, line: str) -> None:
        """A line for people."""

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        """Trials of a generation that are counted, of so many; some times a second."""

    def on_generation(self, generation: Generation) -> None:
        """A generation ended and is recorded."""

    def on_champion(self, champion: Controller) -> None:
        """The run found a better controller than before; of scores, which do not compare: a generation's best."""

    def on_event(self, event: Note) -> None:
        """Something happened, as in the table ``events`` of the record."""

    def on_end(self, result: Result | None) -> None:
        """The run ended, or was stopped (None); the last call."""


class Loggers(Logger):
    """All of them, each in turn."""

    def __init__(self, loggers: Iterable[Logger]) -> None:
        self._loggers = list(loggers)

    def on_start(self, run: Started) -> None:
        """See ``Logger``."""
        for logger in self._loggers:
            logger.on_start(run)

    def on_say(self, line: str) -> None:
        """See ``Logger``."""
        for logger in self._loggers:
            logger.on_say(line)

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        """See ``Logger``."""
        for logger in self._loggers:
            logger.on_progress(generation, counted, trials)

    def on_generation(self, generation: Generation) -> None:
        """See ``Logger``."""
        for logger in self._loggers:
            logger.on_generation(generation)

    def on_champion(self, champion: Controller) -> None:
        """See ``Logger``."""
        for logger in self._loggers:
            logger.on_champion(champion)

    def on_event(self, event: Note) -> None:
        """See ``Logger``."""
        for logger in self._loggers:
            logger.on_event(event)

    def on_end(self, result: Result | None) -> None:
        """See ``Logger``."""
        for logger in self._loggers:
            logger.on_end(result)


class InBackground(Logger):
    """A logger of the user's, called in a thread of its own: what it raises is told once, and its slowness stops no run.

    Args:
        logger: it.
        say: takes a line about it.
    """

    def __init__(self, logger: Logger, say: Callable[[str], None]) -> None:
        self._name, self._logger, self._say = type(logger).__name__, logger, say
        self._calls: queue.Queue[Callable[[], None] | None] = queue.Queue(WAITING)
        self._dropped, self._raised = 0, False
        self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)

    def on_start(self, run: Started) -> None:
        """See ``Logger``."""
        self._thread.start()
        self._put(lambda: self._logger.on_start(run))

    def on_say(self, line: str) -> None:
        """See ``Logger``."""
        self._put(lambda: self._logger.on_say(line))

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        """See ``Logger``; left out while it is behind, for the next call says more."""
        if self._calls.empty():
            self._put(lambda: self._logger.on_progress(generation, counted, trials))

    def on_generation(self, generation: Generation) -> None:
        """See ``Logger``."""
        self._put(lambda: self._logger.on_generation(generation))

    def on_champion(self, champion: Controller) -> None:
        """See ``Logger``."""
        self._put(lambda: self._logger.on_champion(champion))

    def on_event(self, event: Note) -> None:
        """See ``Logger``."""
        self._put(lambda: self._logger.on_event(event))

    def on_end(self, result: Result | None) -> None:
        """See ``Logger``; waits some seconds for it."""
        if not self._thread.is_alive():
            return
        deadline = time.monotonic() + LAST_CALLS_S
        lasts = (lambda: self._logger.on_end(result), None)
        try:
            for last in lasts:
                self._calls.put(last, timeout=max(0.0, deadline - time.monotonic()))
        except queue.Full:  # what waits is dropped: its thread ends if the logger ever comes back
            with contextlib.suppress(queue.Empty):
                while True:
                    self._calls.get_nowait()
            for last in lasts:
                self._calls.put_nowait(last)
        self._thread.join(max(0.0, deadline - time.monotonic()))
        if self._thread.is_alive():
            self._say(f"logger {self._name} is behind and was left")
        elif self._dropped:
            self._say(f"logger {self._name} was behind: {self._dropped} of its calls were dropped")

    def _put(self, call: Callable[[], None]) -> None:
        try:
            self._calls.put_nowait(call)
        except queue.Full:
            self._dropped += 1

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            try:
                call()
            except (Exception, SystemExit) as error:  # of the user's code: the run goes on
                if not self._raised:
                    self._say(f"logger {self._name}: {type(error).__name__}: {error}; the run goes on")
                self._raised = True
