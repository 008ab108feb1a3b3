"""Play the runs of a study: several at a time, over one connection.

The thread that plays owns all state. Each run has a thread with its record, session and leases; the
calls of its logger come back through a queue.
"""

import contextlib
import os
import queue
import shutil
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from zswarm import experiment
from zswarm.errors import ConfigError, NoServers, Stopped, ZswarmError
from zswarm.experiment import Experiment
from zswarm.ot import evolution
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.cluster.watch import NOBODY, NOBODY_YET
from zswarm.ot.evolution import Evolution
from zswarm.ot.logger import Forwarder, Logger, Result
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.record import stopping
from zswarm.ot.record.folder import DATABASE, EXPERIMENT
from zswarm.ot.study.outcome import RunEnded, StudyLogger
from zswarm.ot.study.plan import Planned, another
from zswarm.system.files import write_whole
from zswarm.system.text import clean

PROGRESS_S = 0.1  # between two reports of a run on its generation
STOP_S = 5.0  # until runs that were asked to stop are abandoned
AGAIN_S = 60.0  # until a line that another run logged is logged again
# Files of a run whose program was killed before it began.
STRANDED = {"lock", EXPERIMENT, f"{EXPERIMENT}.part", "run.part", "run.part-journal"}


class _Running(Forwarder):
    """A run in progress, and the logger that its thread calls."""

    def __init__(
        self, planned: Planned, logger: Logger, inbox: "_Inbox", computes: str
    ) -> None:
        self.planned, self.logger = planned, logger
        self.evolution: Evolution | None = None
        self.trials: int | None = None  # of its generation
        self.repeated = computes  # a line that the study logs itself
        # The next line is about an event that is not worth one in a study.
        self.routine = False
        self._inbox = inbox
        self._reported = (-1, 0.0)  # generation and time of the last progress

    def forward(self, method: str, *arguments: Any) -> None:
        self._inbox.put((self, method, arguments))

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        now = time.monotonic()
        if generation != self._reported[0] or now > self._reported[1] + PROGRESS_S:
            self._reported = (generation, now)
            super().on_progress(generation, counted, trials)


_Inbox = queue.SimpleQueue[tuple[_Running, str, tuple[Any, ...]]]


class Player:
    """Play planned runs of a study, once; ``ended`` takes those that finished or failed."""

    def __init__(
        self,
        folder: Path,
        planned: Sequence[Planned],
        connection: Connection,
        logger: StudyLogger,
        stop: threading.Event,
        ended: list[RunEnded],
    ) -> None:
        self._folder, self._waiting, self._ended = folder, deque(planned), ended
        self._connection, self._logger, self._stop = connection, logger, stop
        self._threads: list[threading.Thread] = []
        self._running: dict[str, _Running] = {}
        self._inbox: _Inbox = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._joined: set[str] = set()  # servers
        self._lines: dict[str, float] = {}  # when each was logged

    @property
    def going_on(self) -> bool:
        """Return whether threads of runs are alive."""
        return any(thread.is_alive() for thread in self._threads)

    def play(self, at_once: int) -> None:
        """Play all runs, ``at_once`` in parallel; 0: as many as keep the slots busy."""
        _ = self._connection.reach  # refuses unusable keys before there is a folder
        try:
            while self._waiting or self._running:
                trials = [running.trials for running in self._running.values()]
                if self._waiting and another(
                    trials, self._connection.slots, at_once=at_once
                ):
                    self._begin(self._waiting.popleft())
                    continue
                with contextlib.suppress(queue.Empty):
                    running, method, arguments = self._inbox.get(timeout=PROGRESS_S)
                    self._take(running, method, *arguments)
                if self._stop.is_set():
                    raise Stopped("stopped")
        finally:
            self._leave()

    def _begin(self, planned: Planned) -> None:
        computes = self._connection.who_computes()
        logger = self._logger.run_logger(planned)
        line = f"{planned.experiment.name}: {computes}"
        running = self._running[planned.name] = _Running(
            planned, logger, self._inbox, line
        )
        thread = threading.Thread(
            target=self._run, args=(running,), name=planned.name, daemon=True
        )
        self._threads.append(thread)
        thread.start()

    def _take(self, running: _Running, method: str, *arguments: Any) -> None:
        """Pass on a call of a run's logger, or the end of its thread."""
        match method, arguments:
            case "finished", (Result() as result,):
                self._end(RunEnded(running.planned, result))
            case "broke", (BaseException() as error,):
                self._fail(running, error)
            case "on_say", (str() as line,):
                if (
                    not running.routine
                    and line != running.repeated
                    and stopping.BUDGET_USED not in line  # as planned
                    and self._is_new(line)
                ):
                    running.logger.on_say(line)
                running.routine = False
            case "on_event", (Note() as note,):
                running.routine = self._is_routine(note)
            case "on_progress", (_, _, int() as trials):
                running.trials = trials
            case "on_start" | "on_wait" | "on_generation", _:
                getattr(running.logger, method)(*arguments)

    def _is_routine(self, note: Note) -> bool:
        match note.event:
            case RunEvent.SERVER_JOINED:
                known = note.server in self._joined
                self._joined.add(note.server)
                return known
            case RunEvent.SERVER_LEFT:
                self._joined.discard(note.server)
        return note.event == RunEvent.LEASE_WAITING  # mostly for another run of the study

    def _is_new(self, line: str) -> bool:
        """Return whether no run logged this line just now; waiting for another run is not news."""
        if line in (NOBODY, NOBODY_YET) and self._connection.slots:
            return False
        now = time.monotonic()
        if now <= self._lines.get(line, -AGAIN_S) + AGAIN_S:
            return False
        self._lines[line] = now
        return True

    def _fail(self, running: _Running, error: BaseException) -> None:
        """End a run that failed; raise the error if it stops the whole study."""
        failed = isinstance(error, (ZswarmError, sqlite3.Error, OSError))
        if not failed or isinstance(error, (NoServers, Stopped)):
            raise error
        self._end(RunEnded(running.planned, None, clean(str(error))))
        local = self._connection.local
        if local is not None and local.ended():
            raise error

    def _end(self, ended: RunEnded) -> None:
        del self._running[ended.planned.name]
        self._ended.append(ended)
        self._logger.on_run(ended)

    def _leave(self) -> None:
        """Stop the runs in progress, and wait a few seconds until they have recorded everything."""
        self._stopping.set()
        for running in self._running.values():
            if running.evolution is not None:
                running.evolution.stop()
        deadline = time.monotonic() + STOP_S
        for thread in self._threads:
            # Ctrl-C may have prevented its start: then it cannot be joined.
            if thread.is_alive():
                thread.join(max(0.0, deadline - time.monotonic()))

    # ---- a run's thread

    def _run(self, running: _Running) -> None:
        try:
            with self._opened(running.planned, running) as running.evolution:
                if self._stopping.is_set():
                    running.evolution.stop()
                result = running.evolution.finish()
        except BaseException as error:  # raised again by the thread that plays
            running.forward("broke", error)
        else:
            running.forward("finished", result)

    def _opened(
        self, planned: Planned, logger: Logger
    ) -> contextlib.AbstractContextManager[Evolution]:
        folder, name = self._folder / planned.name, planned.name
        if (folder / DATABASE).exists():
            _lengthen(folder, planned.experiment)
            return evolution.resume(folder, self._connection, logger)
        if os.path.lexists(folder):
            _remove(folder)
        complete = planned.experiment
        return evolution.start(
            complete, name, self._folder, self._connection, logger, name=name
        )


def _lengthen(folder: Path, now: Experiment) -> None:
    """Write the generations, the limits and the label that the study's experiment has now."""
    began = experiment.load(folder / EXPERIMENT)
    changed = msgspec.structs.replace(
        began, generations=now.generations, stop=now.stop, label=now.label
    )
    if began != changed:
        write_whole(folder / EXPERIMENT, experiment.to_toml(changed).encode())


def _remove(folder: Path) -> None:
    """Remove a run whose program was killed before it began.

    Raises:
        ConfigError: the folder holds something else.
    """
    expected = f"{folder}: expected a run's folder or none"
    try:
        if more := set(os.listdir(folder)) - STRANDED:
            raise ConfigError(f"{expected}, but it holds {clean(min(more))}")
        shutil.rmtree(folder)
    except OSError as error:
        raise ConfigError(f"{expected}: {error.strerror or error}") from None
