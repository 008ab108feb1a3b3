"""A study: several runs of one experiment over one connection.

Its folder holds the experiment with its ``[study]``, which is authoritative, and an ordinary run's
folder for each run; a lock keeps other programs out.
"""

import contextlib
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Self

from zswarm import experiment
from zswarm.config.decode import read
from zswarm.config.sections import BudgetConfig, StudyConfig
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.build import build
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.record import control_file
from zswarm.ot.record.folder import (
    DATABASE,
    EXPERIMENT,
    load_experiment,
    lock_folder,
    new_folder,
    unusable,
)
from zswarm.ot.record.results import result_after
from zswarm.ot.study.effort import Cell, bounded, cells
from zswarm.ot.study.outcome import RunEnded, StudyLogger, StudyOutcome, summarize
from zswarm.ot.study.plan import Planned, first_of_each, identity, label, plan
from zswarm.ot.study.runner import Player
from zswarm.system.files import write_whole
from zswarm.system.format import plural
from zswarm.system.text import clean


class Study:
    """A study's folder, locked by this program.

    Attributes:
        folder: its folder.
        experiment: complete, with the study.
        planned: all of its runs, in the order in which they begin.
        cells: its settings, with the work of a run of each.
        ended: the runs that ended; at first those that were finished when it was opened.
        others: names of runs in its folder that do not belong to it.
    """

    def __init__(
        self,
        folder: Path,
        complete: Experiment,
        planned: list[Planned],
        lock: int,
        known: list[Cell],
    ) -> None:
        self.folder, self.experiment, self.planned = folder, complete, planned
        self.cells = known
        self.ended = [
            RunEnded(one, result, earlier=True)
            for one in planned
            if (result := result_after(folder / one.name, one.experiment))
        ]
        found = {path.parent.name for path in folder.glob(f"*/{DATABASE}")}
        self.others = sorted(
            clean(name) for name in found - {one.name for one in planned}
        )
        self._lock = lock
        self._stop = control_file.StopRequest(folder)
        self._player: Player | None = None

    @classmethod
    def create(cls, loaded: Experiment, where: str, out: Path) -> Self:
        """Make a study in a new folder below ``out``.

        Raises:
            ConfigError: a setting is impossible, or the folder cannot be written.
        """
        complete = experiment.complete(loaded, where)
        planned, known = checked_plan(complete, where, {})
        text = experiment.to_toml(complete)
        if complete.study == StudyConfig():
            text += "\n[study]\n"
        with contextlib.ExitStack() as undo:
            folder = new_folder(out, complete.name)
            undo.callback(shutil.rmtree, folder, ignore_errors=True)
            lock = lock_folder(folder, "study")
            undo.callback(os.close, lock)
            try:
                write_whole(folder / EXPERIMENT, text.encode())
            except OSError as error:
                why = f"cannot be written: {error.strerror}"
                raise unusable(folder, why) from None
            study = cls(folder, complete, planned, lock, known)
            undo.pop_all()
        return study

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Open a study that was stopped, or whose experiment.toml now has more runs.

        Raises:
            ConfigError: not a study, in use, or its experiment.toml cannot be used.
        """
        complete = load_study(folder)
        with contextlib.ExitStack() as undo:
            lock = lock_folder(folder, "study")
            undo.callback(os.close, lock)
            control_file.forget(folder)
            where = str(folder / EXPERIMENT)
            planned, known = checked_plan(complete, where, _found(folder))
            study = cls(folder, complete, planned, lock, known)
            undo.pop_all()
        return study

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._lock)

    @property
    def left(self) -> list[Planned]:
        """The runs that did not end."""
        done = {ended.planned.name for ended in self.ended}
        return [one for one in self.planned if one.name not in done]

    @property
    def going_on(self) -> bool:
        """Return whether a run has a live thread; after ``play``, one that did not stop in time."""
        return self._player is not None and self._player.going_on

    def stop(self) -> None:
        """Stop within a moment, from any thread: ``play`` raises ``Stopped``. Nothing is lost."""
        self._stop.set()

    def play(self, connection: Connection | None, logger: StudyLogger) -> StudyOutcome:
        """Play the runs that are not finished. A run that fails does not stop the others.

        Raises:
            NoServers: too few servers were found in time.
            EvaluationError: this machine's slots ended.
            Stopped: ``stop`` was called.
        """
        begin, result = time.monotonic(), None
        try:
            for line in self._lines(connection):
                logger.on_say(line)
            for ended in self.ended:
                logger.on_run(ended)
            if connection is not None and (left := self.left):
                player = Player(
                    self.folder, left, connection, logger, self._stop, self.ended
                )
                self._player = player
                player.play(self.experiment.study.at_once)
            seconds = time.monotonic() - begin
            result = summarize(str(self.folder), self.planned, self.ended, seconds)
        finally:
            logger.on_outcome(result)
        return result

    def _lines(self, connection: Connection | None) -> Iterator[str]:
        settings = len(first_of_each(self.planned))
        each = f" of {plural(settings, 'setting')}" if settings > 1 else ""
        computes = (
            f": {connection.who_computes()}"
            if connection is not None and self.left
            else ""
        )
        yield f"{self.experiment.name}, {plural(len(self.planned), 'run')}{each}{computes}"
        if count := len(self.ended):
            yield f"{count} of them {'is' if count == 1 else 'are'} already finished"
        if self.others:
            names = ", ".join(self.others)
            yield f"ignored, because {self.folder / EXPERIMENT} does not ask for them: {names}"


def is_study(folder: Path) -> bool:
    """Return whether a folder holds an experiment with a ``[study]``, and no record."""
    file = folder / EXPERIMENT
    return file.is_file() and not (folder / DATABASE).exists() and "study" in read(file)


def load_study(folder: Path) -> Experiment:
    """Load the experiment of a study's folder.

    Raises:
        ConfigError: not a study, or it cannot be used.
    """
    if not is_study(folder):
        raise ConfigError(
            f"{clean(str(folder))}: not a study; expected a folder with an {EXPERIMENT} that has a "
            "[study]"
        )
    return experiment.complete(
        experiment.load(folder / EXPERIMENT), str(folder / EXPERIMENT)
    )


def not_begun(folder: Path) -> list[str]:
    """Return a note on how many runs of a study have no record, or nothing."""
    if not is_study(folder):
        return []
    total = load_study(folder).study.runs()
    missing = total - len(list(folder.glob(f"*/{DATABASE}")))
    if missing <= 0:
        return []
    shown = clean(str(folder))
    return [
        f"{missing} of the {total} runs of {shown} did not begin: zswarm-ot resume {shown} evolves "
        "them"
    ]


def _found(folder: Path) -> dict[str, str]:
    """Return the identities of a folder's runs by name; omit those that cannot be read."""
    found: dict[str, str] = {}
    for record in folder.glob(f"*/{DATABASE}"):
        with contextlib.suppress(ConfigError):
            found[record.parent.name] = identity(load_experiment(record.parent))
    return found


def checked_plan(
    complete: Experiment, where: str, found: Mapping[str, str]
) -> tuple[list[Planned], list[Cell]]:
    """Plan the runs, and build the parts of each setting once.

    Returns:
        The runs, and the settings with their work.

    Raises:
        ConfigError: a setting is impossible; it is named.
    """
    planned, parts = plan(complete, where, found), []
    for one in first_of_each(planned):
        try:
            parts.append(build(one.experiment))
        except ConfigError as error:
            words = one.experiment.label or label(one.settings, [one.settings])
            raise ConfigError(
                f"{where}: study: with {words}: {error}" if words else str(error)
            ) from None
    known = cells(planned, parts)
    if complete.study.budget != BudgetConfig():
        planned = bounded(planned, known)
    return planned, known
