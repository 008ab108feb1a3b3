"""What Python programs and notebooks use: ``import zswarm`` has these names (docs/python.md).

Nothing here prints, ends the program or touches signal handlers; everything works in any thread, in a notebook and in a test.
"""

import contextlib
import logging
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import msgspec

from zswarm import experiment as experiments
from zswarm.errors import ConfigError, EvaluationError
from zswarm.experiment import Experiment
from zswarm.ot import evolution, grouping, reading
from zswarm.ot.connection import Connection
from zswarm.ot.evolution import Evolution
from zswarm.ot.logger import InBackground, Logger, Loggers
from zswarm.ot.problem import Problem
from zswarm.ot.reading import Run
from zswarm.ot.record import EXPERIMENT, load_experiment
from zswarm.strict import read as read_toml

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from zswarm.ot.curves import Axis
    from zswarm.ot.figures import Size

Source = str | os.PathLike[str] | Mapping[str, Any] | Experiment
LOG = logging.getLogger("zswarm")


# ---- experiments


def load(source: Source, settings: Mapping[str, Any] | None = None) -> Experiment:
    """An experiment.

    Args:
        source: a file, the name of an example, the folder of a run, what a file would say as a dict, or an experiment.
        settings: what differs from it, by the keys of the file.

    Raises:
        ConfigError: nothing of that name, or something in it is unknown or impossible. Of parts that are not installed here
            the settings are checked when it is used.

    Example::

        small = zswarm.load("stadium", {"generations": 20, "optimizer.population": 30})
    """
    loaded, where = _complete(source, {} if settings is None else settings)
    experiments.check_settings(loaded, where)
    return loaded


def problem(
    source: Source | None = None,
    *,
    simulator: str | None = None,
    settings: Mapping[str, Any] | None = None,
    representation: str | Mapping[str, Any] | None = None,
    ranking: str | Mapping[str, Any] | None = None,
    trials: int | None = None,
    seeds: Literal["fixed", "fresh"] | None = None,
    seed: int | None = None,
) -> Problem:
    """What candidates are judged by, for ``Connection.evaluate``: that of an experiment, or of parts, or both.

    Args:
        source: as for ``load``; what else is given differs from it.
        simulator: its name.
        settings: of the simulator.
        representation: kind of network, or its table of the experiment file: ``{"kind": "fully-meshed", "hidden": 3}``.
        ranking: kind of ranking, or its table, for games of several participants: ``"swiss"``.
        trials: per candidate.
        seeds: of the trials: "fixed", or "fresh" in each generation.
        seed: from which these are derived, where the simulator does not fix them.

    Raises:
        ConfigError: as ``load``, or the parts do not fit together.

    Example::

        stadium = zswarm.problem("stadium")
        few = zswarm.problem(simulator="emergency-exit", settings={"agents": 5}, trials=4)
    """
    if source is None:
        if simulator is None:
            raise ConfigError("problem: expected an experiment or a simulator, such as zswarm.problem('stadium')")
        source = {
            "name": "problem", "seed": 0, "generations": 1, "problem": {"simulator": simulator},
            "representation": {"kind": "fully-meshed"}, "optimizer": {"kind": "nnga"},
        }  # fmt: skip
    settings = {} if settings is None else settings
    _check_dict(settings, "{'agents': 5}")
    changes: dict[str, Any] = {f"problem.settings.{key}": value for key, value in settings.items()}
    given = {"problem.simulator": simulator, "problem.trials": trials, "problem.seeds": seeds, "seed": seed}
    changes |= {key: value for key, value in given.items() if value is not None}
    for part, kind in (("representation", representation), ("ranking", ranking)):
        if kind is not None:
            changes[part] = {"kind": kind} if isinstance(kind, str) else dict(kind)
    loaded, where = _complete(source, changes)
    return Problem(experiments.complete(loaded, where))


# ---- servers


def connect(
    servers: Literal["auto", "local"] | int = "auto",
    *,
    realm: str = "default",
    connect: Sequence[str] = (),
    multicast: bool = True,
    through_router: bool = False,
    local_slots: int = 0,
    require: Sequence[str] = (),
    rank: Sequence[str] = (),
    max_slots: int = 0,
    trial_timeout_s: float = 300.0,
    trial_memory_mb: int = 0,
    on_fault: Literal["pause", "quarantine"] = "pause",
    verify: float = 0.0,
    controller: Literal["server", "optimizer"] = "server",
    messages: Literal["turn", "agent"] = "turn",
) -> Connection:
    """Servers for any number of runs and evaluations; this machine's slots start at once and end with ``close`` or the block.

    Args:
        servers: "auto": this machine's slots and every server found; "local": this machine only; a number: wait for so many.
        realm, connect, multicast, through_router, local_slots: as in ``[cluster]`` of the experiment file, like all that follow.
        require, rank, max_slots, trial_timeout_s, trial_memory_mb, on_fault, verify, controller, messages: likewise.

    Raises:
        ConfigError: an impossible value.

    Example::

        with zswarm.connect() as cluster:
            first = zswarm.run("stadium", connection=cluster)
            second = zswarm.run("minisim", connection=cluster)
    """
    options = experiments.cluster(
        {
            "servers": servers, "realm": realm, "connect": list(connect), "multicast": multicast,
            "through_router": through_router, "local_slots": local_slots, "require": list(require), "rank": list(rank),
            "max_slots": max_slots, "trial_timeout_s": trial_timeout_s,
            "trial_memory_mb": trial_memory_mb, "on_fault": on_fault, "verify": verify, "controller": controller,
            "messages": messages,
        }
    )  # fmt: skip
    opened = Connection(options)
    opened.open()
    return opened


# ---- runs


def run(
    experiment: Source,
    *,
    connection: Connection | None = None,
    out: str | os.PathLike[str] = "runs",
    loggers: Sequence[Logger] | Logger = (),
    progress: bool = False,
) -> Run:
    """Evolve to the last generation; what was recorded.

    Ctrl-C, or a notebook's stop button, stops it: a ``KeyboardInterrupt``, whose note says how to resume. Nothing is lost.

    Args:
        experiment: as for ``load``.
        connection: servers to use instead of those of the experiment's ``[cluster]``.
        out: where the run's folder is made.
        loggers: one or several that follow it, each in a thread of its own.
        progress: show how it goes, as ``zswarm-ot run`` does.

    Raises:
        ConfigError: the experiment or the folder cannot be used.
        EvaluationError: trials cannot be evaluated; the run can be resumed.
        NoServers: the number of servers asked for was not there in time.

    Example::

        run = zswarm.run(zswarm.load("stadium", {"seed": 2}), progress=True)
        print(run.best(), run.folder)
    """
    with start(experiment, connection=connection, out=out, loggers=loggers, progress=progress) as begun:
        begun.finish()
    return begun.run


def study(
    experiment: Source,
    *,
    repeat: int | None = None,
    grid: Mapping[str, Sequence[Any]] | None = None,
    connection: Connection | None = None,
    out: str | os.PathLike[str] = "runs",
    progress: bool = False,
) -> list[Run]:
    """Evolve several runs, over seeds and settings; they share the servers. What was recorded, in the order of the study.

    Ctrl-C stops it; the folder of a study, as ``experiment``, goes on with what is not finished.

    Args:
        experiment: as for ``load``, with or without a ``[study]`` (docs/studies.md); or the folder of a study.
        repeat: runs of each setting, with the seeds ``seed``, ``seed`` + 1, ...
        grid: values by keys; every combination is a setting.
        connection: servers to use instead of those of the experiment's ``[cluster]``.
        out: where the study's folder is made.
        progress: show how it goes, as ``zswarm-ot run`` does.

    Raises:
        ConfigError: a setting or the folder cannot be used.
        EvaluationError: runs failed; it names them, and the others are finished.
        NoServers: the number of servers asked for was not there in time.

    Example::

        runs = zswarm.study("stadium", repeat=5, grid={"representation.hidden": [0, 2]})
        zswarm.plot(*runs).savefig("hidden.pdf")
    """
    from zswarm.ot import study as studies
    from zswarm.ot.playing import Follower

    follower = Follower()
    if progress:
        from zswarm.ot.study_display import follower as shown

        follower = shown(as_json=False)
    given = {"study.repeat": repeat, "study.grid": None if grid is None else _grid(grid)}
    changes = {key: value for key, value in given.items() if value is not None}
    if isinstance(experiment, str | os.PathLike) and studies.is_study(Path(experiment)):
        if changes:
            raise ConfigError(f"{experiment}: a study goes on as it is; change its experiment.toml instead")
        held = studies.Study.open(Path(experiment))
    else:
        loaded, where = _complete(experiment, changes)
        if connection is not None:
            loaded = msgspec.structs.replace(loaded, cluster=connection.options)
        held = studies.Study.create(loaded, where, Path(out))
    with held as begun, _connected(connection, begun.experiment) if begun.left else contextlib.nullcontext() as used:
        try:
            outcome = begun.play(used, follower)
        except (Exception, KeyboardInterrupt) as error:
            error.add_note(f"nothing of the study is lost; to go on: zswarm.study({str(begun.folder)!r})")
            raise
    if outcome.failed:
        failed = "; ".join(f"{ended.planned.name}: {ended.error}" for ended in outcome.failed)
        raise EvaluationError(f"{len(outcome.failed)} of {outcome.runs} runs failed: {failed}")
    return [Run(begun.folder / planned.name) for planned in begun.planned]


def start(
    experiment: Source,
    *,
    connection: Connection | None = None,
    out: str | os.PathLike[str] = "runs",
    loggers: Sequence[Logger] | Logger = (),
    progress: bool = False,
) -> AbstractContextManager[Evolution]:
    """A run to iterate over; leave the block before its end, and it is stopped and can be resumed.

    Arguments and errors are those of ``run``.

    Example::

        with zswarm.start("stadium") as evolution:
            for generation in evolution:
                if generation.best > 0:
                    break
    """
    loaded, where = _complete(experiment, {})
    experiments.check_settings(loaded, where)
    return _Block(_started(loaded, where, Path(out), connection, _followers(loggers, progress=progress)))


def resume(
    run: str | os.PathLike[str] | Run,
    *,
    connection: Connection | None = None,
    loggers: Sequence[Logger] | Logger = (),
    progress: bool = False,
) -> AbstractContextManager[Evolution]:
    """A run that was stopped, from the last thing it recorded; otherwise as ``start``.

    Args:
        run: it, or its folder.

    Raises:
        ConfigError: there is none, it is damaged or in use, or its experiment was changed.

    Example::

        with zswarm.resume("runs/stadium") as evolution:
            evolution.finish()
    """
    folder = run.folder if isinstance(run, Run) else Path(run)
    return _Block(_resumed(folder, load_experiment(folder), connection, _followers(loggers, progress=progress)))


def read(folder: str | os.PathLike[str]) -> Run:
    """A recorded run: finished, stopped or going on; nothing is written.

    Raises:
        ConfigError: there is none, or it is damaged.

    Example::

        history = zswarm.read("runs/stadium").to_pandas()
    """
    return Run(Path(folder))


def plot(
    *runs: str | os.PathLike[str] | Run,
    x: "Axis" = "generation",
    size: "Size" = "column",
    title: str = "",
    lowest: float | None = None,
) -> "Figure":
    """The learning curves of runs, as a figure of matplotlib that a notebook shows: repeats as a median with a band.

    Args:
        runs: they, or folders of runs or that hold runs.
        x: along the horizontal axis: "generation", "evaluations" or "time".
        size: "column" or "page" of a paper, or "slides".
        title: above it.
        lowest: fitness on the vertical axis; None: all that there is.

    Raises:
        ConfigError: no runs there, none finished a generation or reaches ``lowest``, or matplotlib is missing.
        ValueError: another x or size.

    Example::

        seeds = [zswarm.run(zswarm.load("stadium", {"seed": seed})) for seed in range(5)]
        zswarm.plot(*seeds).savefig("stadium.pdf")
    """
    from zswarm.ot import figures

    found = [one for run in runs for one in ([run] if isinstance(run, Run) else reading.runs_below([Path(run)]))]
    if not found:
        raise ConfigError("plot: expected a run at least")
    return figures.for_notebooks(figures.of_runs(grouping.groups(found), x, size, title, lowest))


# ---- helpers


class _Block(AbstractContextManager[Evolution]):
    """What ``with`` makes a run of; whoever forgets it is told."""

    def __init__(self, block: AbstractContextManager[Evolution]) -> None:
        self._block = block

    def __enter__(self) -> Evolution:
        return self._block.__enter__()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> bool | None:
        return self._block.__exit__(kind, error, trace)

    def __iter__(self) -> NoReturn:
        raise TypeError(_NEEDS_WITH)

    def __getattr__(self, name: str) -> NoReturn:
        raise AttributeError(f"no attribute {name!r}" if name.startswith("_") else _NEEDS_WITH)


_NEEDS_WITH = "a run needs a block: `with zswarm.start(...) as evolution:`, and in it `for generation in evolution:`"


@contextlib.contextmanager
def _started(loaded: Experiment, where: str, out: Path, connection: Connection | None, logger: Logger) -> Iterator[Evolution]:
    with _connected(connection, loaded) as used:
        loaded = msgspec.structs.replace(loaded, cluster=used.options)
        with evolution.start(loaded, where, out, used, logger) as begun, _noting(begun):
            yield begun


@contextlib.contextmanager
def _resumed(folder: Path, loaded: Experiment, connection: Connection | None, logger: Logger) -> Iterator[Evolution]:
    with _connected(connection, loaded) as used, evolution.resume(folder, used, logger) as begun, _noting(begun):
        yield begun


def _complete(source: Source, changes: Mapping[str, Any]) -> tuple[Experiment, str]:
    """An experiment with changes, and what errors call it."""
    _check_dict(changes, "{'optimizer.population': 100}")
    if isinstance(source, Experiment):
        if not changes:
            return source, source.name
        mapping, where = experiments.to_mapping(source), source.name
    elif isinstance(source, Mapping):
        mapping, where = dict(source), "experiment"
    elif not isinstance(source, str | os.PathLike):
        raise TypeError(
            f"experiment: expected a file, the name of an example, the folder of a run, a dict or an experiment, not {source!r}"
        )
    else:
        path = Path(source)
        path = path / EXPERIMENT if (path / EXPERIMENT).is_file() else experiments.find(os.fspath(source))
        mapping, where = read_toml(path), str(path)
    return experiments.check(experiments.changed(mapping, changes, where), where), where


def _check_dict(settings: Any, example: str) -> None:
    if not isinstance(settings, Mapping):
        raise TypeError(f"settings: expected a dict, such as {example}, not {settings!r}")


def _grid(grid: Mapping[str, Sequence[Any]]) -> dict[str, list[Any]]:
    if not isinstance(grid, Mapping):
        raise TypeError(f"grid: expected a dict of lists, such as {{'optimizer.population': [50, 100]}}, not {grid!r}")
    for key, values in grid.items():
        if isinstance(values, str | bytes | Mapping) or not hasattr(values, "__iter__"):
            raise TypeError(f"grid: {key}: expected a list of values, such as [{values!r}], not {values!r}")
    return {key: list(values) for key, values in grid.items()}


@contextlib.contextmanager
def _connected(connection: Connection | None, loaded: Experiment) -> Iterator[Connection]:
    """The connection that is given, which stays open, or one of the experiment's own."""
    if connection is not None:
        connection.open()
        yield connection
    else:
        with Connection(loaded.cluster) as own:
            yield own


def _followers(given: Sequence[Logger] | Logger, *, progress: bool) -> Logger:
    shown = _display() if progress else _Quiet()
    loggers = [given] if isinstance(given, Logger) or not isinstance(given, Iterable) else list(given)
    for logger in loggers:
        if not isinstance(logger, Logger):
            raise TypeError(f"loggers: expected objects of subclasses of zswarm.Logger, not {logger!r}")
    return Loggers([shown, *(InBackground(logger, LOG.warning if not progress else shown.on_say) for logger in loggers)])


class _Quiet(Logger):
    """Lines for people go to Python's ``logging``, which shows them to whoever asks for."""

    def on_say(self, line: str) -> None:
        """See ``Logger``."""
        LOG.info("%s", line)


def _display() -> Logger:
    """The one that fits where the program runs."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if type(shell).__name__ == "ZMQInteractiveShell":
        from zswarm.ot.notebook import NotebookDisplay

        return NotebookDisplay()
    from zswarm.ot.display import display

    return display(as_json=False)


@contextlib.contextmanager
def _noting(begun: Evolution) -> Iterator[None]:
    """Who is stopped is told how to go on."""
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        if begun.result is None:
            error.add_note(f"nothing of the run is lost; to go on: zswarm.resume({str(begun.folder)!r})")
        raise
