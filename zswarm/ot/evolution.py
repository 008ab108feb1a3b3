"""A run under way: begun or resumed, followed generation by generation, stopped at any time."""

import contextlib
import threading
import time
from collections.abc import Callable, Generator, Iterator
from functools import partial
from pathlib import Path

from msgspec import structs

from zswarm import experiment
from zswarm.errors import Stopped
from zswarm.experiment import Experiment, Study
from zswarm.ot import control, run
from zswarm.ot.connection import Connection
from zswarm.ot.logger import Generation, Logger, Result, Started
from zswarm.ot.reading import Run, told_again
from zswarm.ot.record import Record, load_experiment
from zswarm.ot.run import Parts
from zswarm.version_hash import version_hash

Evolve = Callable[[threading.Event], Generator[Generation, None, Result]]  # until the event is set


class Evolution:
    """Iterate it once: it yields each generation when it is recorded.

    Attributes:
        folder: of the run.
        result: once the last generation is over.
    """

    def __init__(self, folder: Path, evolve: Evolve, logger: Logger) -> None:
        self.folder = folder
        self.result: Result | None = None
        self._stop = control.Stop(folder)
        self._logger = logger
        self._generations = self._follow(evolve(self._stop))

    def __iter__(self) -> Iterator[Generation]:
        return self._generations

    @property
    def run(self) -> Run:
        """What is recorded so far."""
        return Run(self.folder)

    def finish(self) -> Result:
        """Evolve to the last generation.

        Raises:
            RuntimeError: it was stopped before.
        """
        for _ in self:
            pass
        if self.result is None:
            raise RuntimeError(f"this run was stopped: resume it from {self.folder}")
        return self.result

    def stop(self) -> None:
        """Have it stop within a moment, from any thread: whoever iterates gets a ``Stopped``. Nothing is lost."""
        self._stop.set()

    def close(self) -> None:
        """Stop it; from the thread that iterates, between two generations."""
        self._generations.close()

    def _follow(self, generations: Generator[Generation, None, Result]) -> Generator[Generation, None, None]:
        try:
            with contextlib.closing(generations):
                while True:
                    try:
                        generation = next(generations)
                    except StopIteration as end:
                        self.result = end.value
                        return
                    yield generation
                    self._do_what_is_asked()
        finally:
            self._logger.on_end(self.result)

    def _do_what_is_asked(self) -> None:
        """Between two generations; the servers have the next one already, and keep it while the run pauses.

        Raises:
            Stopped: that was asked.
        """
        asked = control.asked(self.folder)
        if asked == "pause":
            self._logger.on_say("the run pauses, as it was asked to; it goes on when it is asked to")
        while asked == "pause" and not self._stop.is_set():
            time.sleep(control.LOOK_S)
            asked = control.asked(self.folder)
        if asked == "drain":
            raise Stopped("stopped after a generation, as it was asked to")


@contextlib.contextmanager
def start(
    loaded: Experiment, where: str, out: Path, connection: Connection, logger: Logger, *, name: str = ""
) -> Iterator[Evolution]:
    """A new run, in a new folder below ``out``; one run, whatever the experiment's study says.

    Args:
        where: what errors call the experiment, such as its file.
        name: of the folder, if not the experiment's.

    Raises:
        ConfigError: the experiment or the folder cannot be used.
    """
    complete = experiment.complete(structs.replace(loaded, study=Study()), where)
    parts = run.build(complete)
    code = version_hash(complete.problem.simulator, complete.representation.kind)
    _ = connection.reach  # refuses unusable keys before there is a folder
    relative = {"relative": 1} if parts.optimizer.relative else {}
    record = Record.create(out, complete, code, parts.problem.simulator.metrics, name=name, **relative)
    with record, contextlib.closing(_evolution(parts, record, connection, logger)) as begun:
        if record.on_network:
            logger.on_say(f"{record.folder} is on a network file system: the record is kept without a write-ahead log there")
        yield begun


@contextlib.contextmanager
def resume(folder: Path, connection: Connection, logger: Logger) -> Iterator[Evolution]:
    """A run that was stopped, from the last thing it recorded. One that is finished is told again: its record stays as it is.

    Raises:
        ConfigError: there is none, it is damaged or in use, or its experiment was changed.
    """
    loaded = load_experiment(folder)
    if (result := told_again(folder, loaded)) is not None:
        started = Started(folder, loaded, loaded.generations)
        with contextlib.closing(Evolution(folder, partial(_tell_again, started, result, logger), logger)) as ended:
            yield ended
        return
    record, complete = Record.open(folder)
    with record:
        control.forget(folder)
        parts = run.build(complete)
        if not parts.optimizer.portable and (before := record.machine_changed()):
            logger.on_say(f"this run was made with {before}; results may differ from here on")
        if record.meta("version_hash") != version_hash(complete.problem.simulator, complete.representation.kind):
            logger.on_say("the code that computes was changed since this run began; results may differ from here on")
        if record.on_network:
            logger.on_say(f"{record.folder} is on a network file system: the record is kept without a write-ahead log there")
        with contextlib.closing(_evolution(parts, record, connection, logger)) as begun:
            yield begun


def _evolution(parts: Parts, record: Record, connection: Connection, logger: Logger) -> Evolution:
    def evolve(stop: threading.Event) -> Generator[Generation, None, Result]:
        with connection.run():
            return (yield from run.evolve(parts, record, connection, logger, stop))

    return Evolution(record.folder, evolve, logger)


def _tell_again(started: Started, result: Result, logger: Logger, _stop: threading.Event) -> Generator[Generation, None, Result]:
    logger.on_start(started)
    yield from ()
    return result
