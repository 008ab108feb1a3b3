"""The runs of a study while they go on: several at a time, over one connection.

The thread that plays owns all state. Each run has a thread of its own, with its record, session and leases, and tells what
happens by a queue.
"""

import contextlib
import os
import queue
import shutil
import sqlite3
import threading
import time
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from zswarm import experiment
from zswarm.errors import ConfigError, NoServers, Stopped, ZswarmError
from zswarm.files import write_whole
from zswarm.ot import evolution
from zswarm.ot.connection import Connection
from zswarm.ot.dispatch import Note
from zswarm.ot.evaluations import NOBODY, NOBODY_YET
from zswarm.ot.evolution import Evolution
from zswarm.ot.logger import Generation, Logger, Result, Started
from zswarm.ot.plan import Planned, another
from zswarm.ot.record import DATABASE, EXPERIMENT
from zswarm.protocol.codec import clean

if TYPE_CHECKING:
    from zswarm.ot.study import Outcome, Study

PROGRESS_S = 0.1  # between two words of a run on its generation
STOP_S = 5.0  # until runs that were told to stop are left
AGAIN_S = 60.0  # what one run says and another one said is told again after so long
LEFT_BY_A_KILL = {"lock", EXPERIMENT, f"{EXPERIMENT}.part", "run.part", "run.part-journal"}  # of a run that never began


class Ended(NamedTuple):
    """A run of a study that ended."""

    planned: Planned
    result: Result | None  # None: it failed
    error: str = ""
    before: bool = False  # it was finished before the study was gone on with


class Follower:
    """Follows a study; by itself does nothing. All calls come from the thread that plays it."""

    def on_start(self, study: "Study", connection: Connection | None) -> None:
        """It begins, or goes on."""

    def on_say(self, line: str, planned: Planned | None) -> None:
        """A line for people, of one run or of all."""

    def on_begin(self, planned: Planned, generation: int) -> None:
        """A run begins, or goes on, at a generation."""

    def on_progress(self, planned: Planned, generation: int, counted: int, trials: int) -> None:
        """Trials of a run's generation that are counted, of so many; some times a second."""

    def on_generation(self, planned: Planned, generation: Generation) -> None:
        """A run's generation ended and is recorded."""

    def on_run(self, ended: Ended) -> None:
        """A run ended."""

    def on_end(self, outcome: "Outcome | None") -> None:
        """The study ended, or was stopped (None); the last call."""


class _Said(NamedTuple):
    line: str


class _Progress(NamedTuple):
    generation: int
    counted: int
    trials: int


class _Broke(NamedTuple):
    """A run's thread ended by an error, or because it was stopped."""

    error: BaseException


_News = Started | _Said | _Progress | Generation | Result | _Broke


class _Going:
    """A run that goes on, in its thread."""

    def __init__(self, planned: Planned) -> None:
        self.planned = planned
        self.trials: int | None = None  # of its generation
        self.evolution: Evolution | None = None


class Player:
    """Plays what is left of a study, once."""

    def __init__(self, study: "Study", connection: Connection, follower: Follower, stop: threading.Event) -> None:
        self._study, self._connection, self._follower, self._stop = study, connection, follower, stop
        self._threads: list[threading.Thread] = []
        self._going: dict[str, _Going] = {}
        self._inbox: queue.SimpleQueue[tuple[str, _News]] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._joined: set[str] = set()  # servers; read and written by the threads of the runs
        self._said: dict[str, float] = {}  # lines for people, and when

    @property
    def going_on(self) -> bool:
        """Whether threads of runs are there."""
        return any(thread.is_alive() for thread in self._threads)

    def play(self) -> None:
        """Play all of it, or until it is stopped; what was ended is added to the study's."""
        _ = self._connection.reach  # refuses unusable keys before there is a folder
        waiting = deque(self._study.left)
        try:
            while waiting or self._going:
                while waiting and another(
                    [going.trials for going in self._going.values()],
                    self._connection.slots,
                    at_once=self._study.experiment.study.at_once,
                ):
                    self._begin(waiting.popleft())
                try:
                    name, news = self._inbox.get(timeout=PROGRESS_S)
                except queue.Empty:
                    pass
                else:
                    self._take(self._going[name], news)
                if self._stop.is_set():
                    raise Stopped("stopped")
        finally:
            self._leave()

    def _begin(self, planned: Planned) -> None:
        going = self._going[planned.name] = _Going(planned)
        thread = threading.Thread(target=self._run, args=(going,), name=planned.name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _take(self, going: _Going, news: _News) -> None:
        planned, follower = going.planned, self._follower
        match news:
            case Started():
                follower.on_begin(planned, news.generation)
            case _Said():
                self._say(planned, news.line)
            case _Progress():
                going.trials = news.trials
                follower.on_progress(planned, *news)
            case Generation():
                follower.on_generation(planned, news)
            case Result():
                self._ended(Ended(planned, news))
            case _Broke(error=error):
                local = self._connection.local
                if isinstance(error, (ZswarmError, sqlite3.Error, OSError)) and not isinstance(error, (NoServers, Stopped)):
                    self._ended(Ended(planned, None, clean(str(error))))
                    if local is None or not local.ended():
                        return
                raise error

    def _say(self, planned: Planned, line: str) -> None:
        """A line of a run, unless another one said it just now, or only waits until others have done."""
        now = time.monotonic()
        if now > self._said.get(line, -AGAIN_S) + AGAIN_S and not (line in (NOBODY, NOBODY_YET) and self._connection.slots):
            self._said[line] = now
            self._follower.on_say(line, planned)

    def _ended(self, ended: Ended) -> None:
        del self._going[ended.planned.name]
        self._study.ended.append(ended)
        self._follower.on_run(ended)

    def _leave(self) -> None:
        """Stop the runs that go on, and wait until they have recorded what they have; at most for some seconds."""
        self._stopping.set()
        for going in self._going.values():
            if going.evolution is not None:
                going.evolution.stop()
        deadline = time.monotonic() + STOP_S
        for thread in self._threads:
            if thread.is_alive():  # one that Ctrl-C kept from starting cannot be waited for
                thread.join(max(0.0, deadline - time.monotonic()))

    # ---- a run's thread

    def _run(self, going: _Going) -> None:
        planned = going.planned
        logger = _Forward(planned.name, self._inbox, self._connection, self._joined)
        try:
            with self._opened(planned, logger) as going.evolution:
                if self._stopping.is_set():
                    going.evolution.stop()
                result = going.evolution.finish()
        except BaseException as error:  # the thread that plays raises what it does not expect
            self._inbox.put((planned.name, _Broke(error)))
        else:
            self._inbox.put((planned.name, result))

    def _opened(self, planned: Planned, logger: Logger) -> contextlib.AbstractContextManager[Evolution]:
        folder = self._study.folder / planned.name
        if (folder / DATABASE).exists():
            _lengthen(folder, planned.experiment.generations)
            return evolution.resume(folder, self._connection, logger)
        if os.path.lexists(folder):
            _remove(folder)
        return evolution.start(planned.experiment, planned.name, self._study.folder, self._connection, logger, name=planned.name)


class _Forward(Logger):
    """Tells what one run does to the thread that plays the study."""

    def __init__(
        self, name: str, inbox: "queue.SimpleQueue[tuple[str, _News]]", connection: Connection, joined: set[str]
    ) -> None:
        self._name, self._inbox, self._joined = name, inbox, joined
        self._known = {connection.who_computes()}
        self._routine = False
        self._told = (-1, 0.0)  # generation and time of the last progress

    def on_start(self, run: Started) -> None:
        """See ``Logger``."""
        self._known = {f"{run.experiment.name}: {line}" for line in self._known}
        self._inbox.put((self._name, run))

    def on_say(self, line: str) -> None:
        """See ``Logger``; what is routine is left out, and what the study itself says."""
        if not self._routine and line not in self._known:
            self._inbox.put((self._name, _Said(line)))
        self._routine = False

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        """See ``Logger``; some times a second."""
        now = time.monotonic()
        if generation != self._told[0] or now > self._told[1] + PROGRESS_S:
            self._told = (generation, now)
            self._inbox.put((self._name, _Progress(generation, counted, trials)))

    def on_generation(self, generation: Generation) -> None:
        """See ``Logger``."""
        self._inbox.put((self._name, generation))

    def on_event(self, event: Note) -> None:
        """See ``Logger``; what is said of it comes next."""
        match event.event:
            case "server_joined":
                self._routine = event.server in self._joined
                self._joined.add(event.server)
            case "server_left":
                self._joined.discard(event.server)
            case "lease_waiting":  # for another run of the study, most of the time
                self._routine = True


def _lengthen(folder: Path, generations: int) -> None:
    """The study's experiment may want more generations than when the run began."""
    began = experiment.load(folder / EXPERIMENT)
    if began.generations != generations:
        write_whole(folder / EXPERIMENT, experiment.to_toml(msgspec.structs.replace(began, generations=generations)).encode())


def _remove(folder: Path) -> None:
    """What is left of a run whose program was killed before it began.

    Raises:
        ConfigError: there is something else.
    """
    try:
        if more := set(os.listdir(folder)) - LEFT_BY_A_KILL:
            raise ConfigError(f"{folder}: expected a run's folder or none, and it holds {clean(min(more))}")
        shutil.rmtree(folder)
    except OSError as error:
        raise ConfigError(f"{folder}: expected a run's folder or none: {error.strerror or error}") from None
