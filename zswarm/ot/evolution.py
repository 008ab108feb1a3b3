"""A run in progress: started or resumed, iterated generation by generation, stopped at any time."""

import contextlib
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path

from msgspec import structs

from zswarm import experiment
from zswarm.config.sections import StudyConfig
from zswarm.errors import ConfigError, Stopped
from zswarm.experiment import Experiment
from zswarm.ot import identity, run
from zswarm.ot.build import Parts, build
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.cluster.shell import Cluster
from zswarm.ot.logger import Generation, Logger, Result, Started
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.record import control_file as control
from zswarm.ot.record import epochs
from zswarm.ot.record.folder import load_experiment
from zswarm.ot.record.reader import Run
from zswarm.ot.record.results import finished_result
from zswarm.ot.record.writer import Record
from zswarm.plugins.version_hash import version_hash
from zswarm.system.text import clean

Generations = Generator[Generation, None, Result]
CHANGED = "results may differ from here on"


class Evolution:
    """Iterate it once: it yields each generation when it ended, which is recorded soon after.

    Attributes:
        folder: of the run.
        result: once the last generation ended.
    """

    def __init__(
        self,
        folder: Path,
        evolve: Callable[[threading.Event], Generations],
        logger: Logger,
        sync: Callable[[], None] = lambda: None,
    ) -> None:
        self.folder = folder
        self.result: Result | None = None
        self._sync = sync  # waits until everything is recorded
        self._stop = control.StopRequest(folder)
        self._logger = logger
        self._generations = self._follow(evolve(self._stop))

    def __iter__(self) -> Iterator[Generation]:
        return self._generations

    @property
    def run(self) -> Run:
        """Everything so far, once it is recorded."""
        self._sync()
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
        """Stop within a moment, from any thread: iterating raises ``Stopped``. Nothing is lost."""
        self._stop.set()

    def close(self) -> None:
        """Stop it between two generations, from the thread that iterates."""
        self._generations.close()

    def _follow(self, generations: Generations) -> Generator[Generation, None, None]:
        try:
            with contextlib.closing(generations):
                while True:
                    try:
                        generation = next(generations)
                    except StopIteration as end:
                        self.result = end.value
                        return
                    yield generation
        finally:
            self._logger.on_end(self.result)


class Requests:
    """What the control file of a run asks for, between two generations."""

    def __init__(self, folder: Path, logger: Logger, stop: threading.Event) -> None:
        self._folder, self._logger, self._stop = folder, logger, stop

    def obey(self, cluster: Cluster) -> None:
        """Pause or stop. A run that pauses holds no slots, and loses nothing that was counted.

        Raises:
            Stopped: the run is to end after this generation.
        """
        asked = control.asked(self._folder)
        if asked == "pause":
            self._logger.on_say("paused, as requested; continue it in the dashboard")
            cluster.pause(paused=True)
            while asked == "pause" and not self._stop.is_set():
                time.sleep(control.CHECK_S)
                asked = control.asked(self._folder)
            cluster.pause(paused=False)
        if asked == "drain":
            raise Stopped("stopped after a generation, as requested")


@contextlib.contextmanager
def start(
    loaded: Experiment,
    where: str,
    out: Path,
    connection: Connection,
    logger: Logger,
    *,
    name: str = "",
) -> Iterator[Evolution]:
    """Start one run in a new folder, ignoring the experiment's study.

    Args:
        loaded, where: the experiment, and its name in errors.
        out, name: where the folder is made, and its name if not the experiment's.
        connection, logger: the servers, and what follows the run.

    Raises:
        ConfigError: the experiment or the folder cannot be used.
    """
    complete = experiment.complete(structs.replace(loaded, study=StudyConfig()), where)
    parts = build(complete)
    _ = connection.reach  # refuses unusable keys before there is a folder
    metrics = parts.problem.simulator.metrics
    more = {"relative": 1} if parts.optimizer.relative else {}
    record = Record.create(out, complete, _code(complete), metrics, name=name, **more)
    with (
        record,
        contextlib.closing(_evolution(parts, record, connection, logger)) as evolution,
    ):
        yield evolution


@contextlib.contextmanager
def resume(
    folder: Path, connection: Connection, logger: Logger, trusted: Sequence[str] = ()
) -> Iterator[Evolution]:
    """Resume a run from the last thing it recorded; of a finished one, only return the result.

    Args:
        trusted: machines that were banned, and are used again.

    Raises:
        ConfigError: there is none, it is damaged or in use, its experiment was changed, or a
            machine is not banned.
    """
    loaded = load_experiment(folder)
    if (result := finished_result(folder, loaded)) is not None:

        def finished(_: threading.Event) -> Generations:
            logger.on_start(Started(folder, loaded, loaded.generations))
            yield from ()
            return result

        with contextlib.closing(Evolution(folder, finished, logger)) as evolution:
            yield evolution
        return
    record, complete = Record.open(folder)
    with record:
        control.forget(folder)
        _trust(record, trusted)
        parts = build(complete)
        if not parts.optimizer.portable and (machine := record.machine_changed()):
            logger.on_say(f"this run was made with {machine}; {CHANGED}")
        before = epochs.epochs(Run(folder))[-1:]
        now = identity.here(complete, record.resumed().generation)
        portable = parts.optimizer.portable
        if before and (how := identity.change(before[0], now, portable=portable)):
            where = f"before generation {now.generation + 1}"
            logger.on_say(f"what computes was changed {where}: {how}; {CHANGED}")
        with contextlib.closing(
            _evolution(parts, record, connection, logger)
        ) as evolution:
            yield evolution


def _trust(record: Record, machines: Sequence[str]) -> None:
    """Record that machines which were banned are used again."""
    banned = record.known().banned
    for machine in machines:
        if machine not in banned:
            names = ", ".join(clean(name) for name in sorted(banned)) or "none"
            raise ConfigError(
                f"{record.folder}: {clean(machine)!r} is not banned; banned machines: {names}"
            )
        text = f"{clean(machine)} is used again, as requested"
        record.note(Note(RunEvent.SERVER_TRUSTED, banned[machine], text, 0, machine))


def _code(complete: Experiment) -> str:
    return version_hash(complete.problem.simulator, complete.representation.kind)


def _evolution(
    parts: Parts, record: Record, connection: Connection, logger: Logger
) -> Evolution:
    def evolve(stop: threading.Event) -> Generations:
        with connection.run():
            obey = Requests(record.folder, logger, stop).obey
            return (yield from run.evolve(parts, record, connection, logger, stop, obey))

    if record.on_network:
        logger.on_say(
            f"{record.folder} is on a network file system, so the record has no write-ahead log"
        )
    return Evolution(record.folder, evolve, logger, record.sync)
