"""A study: several runs of one experiment over one connection, as many at the same time as keep the slots busy.

Its folder holds the experiment with its ``[study]``, which is the truth, and an ordinary run's folder for each run; the
folder's lock keeps other programs out. Who plays the runs: ``playing.py``.
"""

import contextlib
import os
import shutil
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.files import write_whole
from zswarm.ot import run
from zswarm.ot.connection import Connection
from zswarm.ot.curves import quartiles
from zswarm.ot.plan import Planned, identity, label, plan
from zswarm.ot.playing import Ended, Follower, Player
from zswarm.ot.reading import outcome
from zswarm.ot.record import DATABASE, EXPERIMENT, load_experiment, lock_folder, new_folder
from zswarm.protocol.codec import clean
from zswarm.strict import read


class Summary(NamedTuple):
    """The finished runs of a setting. Fitness is the best of each run at its end; None: failed candidates only."""

    settings: dict[str, Any]
    label: str
    runs: int
    median: float | None
    q25: float | None
    q75: float | None
    best: float | None
    evaluations: int


class Outcome(NamedTuple):
    """A study that ended."""

    study: str
    runs: int
    finished: int
    failed: list[Ended]
    settings: list[Summary]
    whole: Summary  # over all settings
    seconds: float  # of this program
    relative: bool  # fitness of some runs is a score, which compares within one generation only


class Study:
    """A study's folder, held by this program.

    Attributes:
        folder: its folder.
        experiment: complete, with the study.
        planned: all of its runs, in the order in which they begin.
        ended: those that were finished when it was opened.
        others: names of runs in its folder that are none of its.
    """

    def __init__(self, folder: Path, complete: Experiment, planned: list[Planned], lock: int) -> None:
        self.folder, self.experiment, self.planned = folder, complete, planned
        self.ended = [
            Ended(one, result, before=True)
            for one in planned
            if (result := outcome(folder / one.name, one.experiment.generations))
        ]
        names = {one.name for one in planned}
        self.others = sorted(clean(path.parent.name) for path in folder.glob(f"*/{DATABASE}") if path.parent.name not in names)
        self._lock = lock
        self._stop = threading.Event()
        self._player: Player | None = None

    @classmethod
    def create(cls, loaded: Experiment, where: str, out: Path) -> Self:
        """A new one, in a new folder below ``out``.

        Raises:
            ConfigError: a setting is impossible, or the folder cannot be written.
        """
        complete = experiment.complete(loaded, where)
        planned = _checked_plan(complete, where, {})
        with contextlib.ExitStack() as undo:
            folder = new_folder(out, complete.name)
            undo.callback(shutil.rmtree, folder, ignore_errors=True)
            lock = lock_folder(folder, "study")
            undo.callback(os.close, lock)
            try:
                text = experiment.to_toml(complete) + ("\n[study]\n" if complete.study == experiment.Study() else "")
                write_whole(folder / EXPERIMENT, text.encode())
            except OSError as error:
                raise ConfigError(f"{folder}: cannot be written: {error.strerror}; choose another place with --out") from None
            study = cls(folder, complete, planned, lock)
            undo.pop_all()
        return study

    @classmethod
    def open(cls, folder: Path) -> Self:
        """One that was stopped, or whose experiment.toml now wants more.

        Raises:
            ConfigError: no study, in use, or its experiment.toml cannot be used.
        """
        complete = load_study(folder)
        with contextlib.ExitStack() as undo:
            lock = lock_folder(folder, "study")
            undo.callback(os.close, lock)
            planned = _checked_plan(complete, str(folder / EXPERIMENT), _found(folder))
            study = cls(folder, complete, planned, lock)
            undo.pop_all()
        return study

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        os.close(self._lock)

    @property
    def left(self) -> list[Planned]:
        """Runs that are not finished."""
        done = {ended.planned.name for ended in self.ended}
        return [one for one in self.planned if one.name not in done]

    @property
    def going_on(self) -> bool:
        """Whether threads of runs are there, which is so after ``play`` only where a run did not stop in time."""
        return self._player is not None and self._player.going_on

    def stop(self) -> None:
        """Have it stop within a moment, from any thread: whoever plays it gets a ``Stopped``. Nothing is lost."""
        self._stop.set()

    def play(self, connection: Connection | None, follower: Follower) -> Outcome:
        """Play what is left. A run that fails stops no other.

        Args:
            connection: the servers of all runs; not needed where nothing is left.

        Raises:
            NoServers: the number of servers asked for was not there in time.
            EvaluationError: this machine's slots ended.
            Stopped: ``stop`` was called.
        """
        begin, outcome = time.monotonic(), None
        try:
            follower.on_start(self, connection)
            if self.left and connection is not None:
                self._player = Player(self, connection, follower, self._stop)
                self._player.play()
            outcome = self._outcome(time.monotonic() - begin)
        finally:
            follower.on_end(outcome)
        return outcome

    def _outcome(self, seconds: float) -> Outcome:
        finished = [ended for ended in self.ended if ended.result is not None]
        by_setting: dict[str, list[Ended]] = {}
        for ended in finished:
            by_setting.setdefault(repr(ended.planned.settings), []).append(ended)
        settings = [one.settings for one in _first_of_each(self.planned)]
        paths = [dict.fromkeys(path for setting in settings for path in setting)]
        summaries = [_summary(each, label(each, paths), by_setting.get(repr(each), [])) for each in settings]
        return Outcome(
            str(self.folder),
            len(self.planned),
            len(finished),
            [ended for ended in self.ended if ended.result is None],
            summaries,
            _summary({}, "", finished),
            round(seconds, 3),
            any(ended.result.relative for ended in finished if ended.result),
        )


def is_study(folder: Path) -> bool:
    """Whether a folder is a study's: it holds an experiment with a ``[study]``, and no record of its own."""
    file = folder / EXPERIMENT
    return file.is_file() and not (folder / DATABASE).exists() and "study" in read(file)


def load_study(folder: Path) -> Experiment:
    """The experiment of a study's folder.

    Raises:
        ConfigError: no study there, or it cannot be used.
    """
    if not is_study(folder):
        raise ConfigError(f"{clean(str(folder))}: no study; expected a folder with {EXPERIMENT}, in which there is a [study]")
    return experiment.complete(experiment.load(folder / EXPERIMENT), str(folder / EXPERIMENT))


def _found(folder: Path) -> dict[str, str]:
    """What the runs of a folder are of, by name; one that cannot be read is taken for what its name says."""
    found: dict[str, str] = {}
    for record in folder.glob(f"*/{DATABASE}"):
        try:
            found[record.parent.name] = identity(load_experiment(record.parent))
        except ConfigError:
            continue
    return found


def _checked_plan(complete: Experiment, where: str, found: Mapping[str, str]) -> list[Planned]:
    """The runs, each of whose parts can be built."""
    planned = plan(complete, where, found)
    for one in _first_of_each(planned):
        try:
            run.build(one.experiment)
        except ConfigError as error:
            words = label(one.settings, [one.settings])
            raise ConfigError(f"{where}: study: with {words}: {error}" if words else str(error)) from None
    return planned


def _first_of_each(planned: Sequence[Planned]) -> list[Planned]:
    """A run of each setting: those with the first seed."""
    return [one for one in planned if one.seed == planned[0].seed]


def _summary(settings: dict[str, Any], words: str, ended: Sequence[Ended]) -> Summary:
    results = [one.result for one in ended if one.result is not None]
    best = np.array([-np.inf if np.isnan(result.best) else result.best for result in results])
    low, middle, high, top = (*quartiles(best), best.max()) if len(best) else (np.nan,) * 4
    return Summary(
        settings=settings,
        label=words,
        runs=len(results),
        median=_number(middle),
        q25=_number(low),
        q75=_number(high),
        best=_number(top),
        evaluations=sum(result.evaluations for result in results),
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
