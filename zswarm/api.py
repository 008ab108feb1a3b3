"""The functions that ``import zswarm`` offers to programs and notebooks (docs/python.md).

They do not print, exit or touch signal handlers, and work in any thread.
"""

import contextlib
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Literal

from msgspec.structs import replace

from zswarm import experiment as experiments
from zswarm.errors import ConfigError, EvaluationError
from zswarm.experiment import Experiment
from zswarm.ot import embedding, evolution
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.embedding import Source
from zswarm.ot.evolution import Evolution
from zswarm.ot.logger import Logger
from zswarm.ot.problem import Problem
from zswarm.ot.record.folder import DATABASE, folders_below, load_experiment
from zswarm.ot.record.reader import Run

Folder = str | os.PathLike[str]


# ---- experiments


@embedding.hinted
def load(source: Source, settings: Mapping[str, Any] | None = None) -> Experiment:
    """Load an experiment.

    Args:
        source: a file, the name of an example, the folder of a run, the content of a file as a
            dict, or an experiment.
        settings: changes, by the keys of the file.

    Raises:
        ConfigError: the source is not found, or a key or value cannot be used. The settings of
            parts that are not installed here are checked when the experiment is used.

    Example::

        small = zswarm.load("stadium", {"generations": 20, "optimizer.population": 30})
    """
    settings = {} if settings is None else settings
    loaded, where = embedding.load(source, settings)
    with embedding.named(settings, where):
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
    """Return the problem of an experiment, or of parts, for ``Connection.evaluate``.

    Args:
        source: as for ``load``; the other arguments change it.
        simulator: name.
        settings: of the simulator.
        representation: kind of network, or its table: ``{"kind": "fully-meshed", "hidden": 3}``.
        ranking: kind of ranking, or its table, for games of several participants: ``"swiss"``.
        trials: per candidate.
        seeds: of the trials: "fixed", or "fresh" in each generation.
        seed: the trials' seeds are derived from it, unless the simulator fixes them.

    Raises:
        ConfigError: as ``load``, or the parts do not fit together.

    Example::

        stadium = zswarm.problem("stadium")
        few = zswarm.problem(simulator="emergency-exit", settings={"agents": 5}, trials=4)
    """
    if source is None:
        if simulator is None:
            raise ConfigError(
                "problem: expected an experiment or a simulator, such as zswarm.problem('stadium')"
            )
        parts = {
            "representation": {"kind": "fully-meshed"},
            "optimizer": {"kind": "nnga"},
        }
        named = {"name": "problem", "seed": 0, "generations": 1}
        source = {**named, "problem": {"simulator": simulator}, **parts}
    settings = {} if settings is None else settings
    embedding.check_dict(settings, "{'agents': 5}")
    given = {
        "problem.simulator": simulator,
        **{f"problem.settings.{key}": value for key, value in settings.items()},
        "problem.trials": trials,
        "problem.seeds": seeds,
        "seed": seed,
        "representation": _table(representation),
        "ranking": _table(ranking),
    }
    changes = _without_none(given)
    loaded, where = embedding.load(source, changes)
    with embedding.named(changes, where):
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
    """Connect to servers, for any number of runs and evaluations.

    The arguments are those of ``[cluster]`` in the experiment file. This machine's slots start at
    once and end with ``close`` or the block.

    Args:
        servers: "auto": this machine's slots and every server found; "local": this machine only;
            a number: wait for that many.

    Raises:
        ConfigError: an impossible value.

    Example::

        with zswarm.connect() as cluster:
            first = zswarm.run("stadium", connection=cluster)
            second = zswarm.run("minisim", connection=cluster)
    """
    values = dict(locals())  # the parameters are the keys of [cluster]
    for key in ("connect", "require", "rank"):
        values[key] = list(values[key])
    opened = Connection(experiments.cluster(values))
    opened.open()
    return opened


# ---- runs


@embedding.hinted
def run(
    experiment: Source,
    *,
    connection: Connection | None = None,
    out: Folder = "runs",
    loggers: Sequence[Logger] | Logger = (),
    progress: bool = False,
) -> Run:
    """Evolve to the last generation, and return the record.

    Ctrl-C, or a notebook's stop button, raises ``KeyboardInterrupt`` with a note that says how to
    resume the run.

    Args:
        experiment: as for ``load``.
        connection: servers to use instead of those of the experiment's ``[cluster]``.
        out: where the run's folder is created.
        loggers: one or several that follow the run, each in its own thread.
        progress: show progress as ``zswarm-ot run`` does.

    Raises:
        ConfigError: the experiment or the folder cannot be used.
        EvaluationError: trials cannot be evaluated; the run can be resumed.
        NoServers: the requested number of servers was not found in time.

    Example::

        run = zswarm.run(zswarm.load("stadium", {"seed": 2}), progress=True)
        print(run.best(), run.folder)
    """
    started = start(
        experiment, connection=connection, out=out, loggers=loggers, progress=progress
    )
    with started as running:
        running.finish()
    return running.run


@embedding.hinted
def study(
    experiment: Source,
    *,
    repeat: int | None = None,
    grid: Mapping[str, Sequence[Any]] | None = None,
    connection: Connection | None = None,
    out: Folder = "runs",
    progress: bool = False,
) -> list[Run]:
    """Evolve several runs that share the servers, and return their records in the study's order.

    Ctrl-C stops the study; to resume it, pass its folder as ``experiment``.

    Args:
        experiment: as for ``load``, with or without a ``[study]`` (docs/studies.md); or the folder
            of a study.
        repeat: runs of each setting, with the seeds ``seed``, ``seed`` + 1, ...
        grid: values by keys; every combination is a setting.
        connection, out, progress: as for ``run``.

    Raises:
        ConfigError: a setting or the folder cannot be used.
        EvaluationError: runs failed; the message names them, and the others are finished.
        NoServers: the requested number of servers was not found in time.

    Example::

        runs = zswarm.study("stadium", repeat=5, grid={"representation.hidden": [0, 2]})
        zswarm.plot(*runs).savefig("hidden.pdf")
    """
    from zswarm.ot.study.display import display
    from zswarm.ot.study.outcome import StudyLogger

    changes = _without_none({"study.repeat": repeat, "study.grid": _grid(grid)})
    with embedding.open_study(experiment, changes, connection, Path(out)) as begun:
        servers = (
            embedding.connected(connection, begun.experiment) if begun.left else None
        )
        with servers or contextlib.nullcontext() as used:
            try:
                logger = display(begun, as_json=False) if progress else StudyLogger()
                outcome = begun.play(used, logger)
            except (Exception, KeyboardInterrupt) as error:
                error.add_note(
                    f"nothing is lost; to resume: zswarm.study({str(begun.folder)!r})"
                )
                raise
    if outcome.failed:
        failed = "; ".join(
            f"{ended.planned.name}: {ended.error}" for ended in outcome.failed
        )
        raise EvaluationError(
            f"{len(outcome.failed)} of {outcome.runs} runs failed: {failed}"
        )
    return [Run(begun.folder / planned.name) for planned in begun.planned]


@embedding.hinted
def start(
    experiment: Source,
    *,
    connection: Connection | None = None,
    out: Folder = "runs",
    loggers: Sequence[Logger] | Logger = (),
    progress: bool = False,
) -> AbstractContextManager[Evolution]:
    """Start a run to iterate over. Leaving the block early stops it; ``resume`` continues it.

    Arguments and errors are those of ``run``.

    Example::

        with zswarm.start("stadium") as evolution:
            for generation in evolution:
                if generation.best > 0:
                    break
    """
    loaded, where = embedding.load(experiment, {})
    experiments.check_settings(loaded, where)
    logger = embedding.followers(loggers, progress=progress)

    def begin(used: Connection) -> AbstractContextManager[Evolution]:
        whole = replace(loaded, cluster=used.options)
        return evolution.start(whole, where, Path(out), used, logger)

    return embedding.Block(embedding.evolving(connection, loaded, begin))


def resume(
    run: Folder | Run,
    *,
    connection: Connection | None = None,
    loggers: Sequence[Logger] | Logger = (),
    progress: bool = False,
) -> AbstractContextManager[Evolution]:
    """Resume a stopped run from its last record; otherwise as ``start``.

    Args:
        run: the run, or its folder.

    Raises:
        ConfigError: there is no run, it is damaged or in use, or its experiment was changed.

    Example::

        with zswarm.resume("runs/stadium") as evolution:
            evolution.finish()
    """
    folder = run.folder if isinstance(run, Run) else Path(run)
    loaded = load_experiment(folder)
    logger = embedding.followers(loggers, progress=progress)
    return embedding.Block(
        embedding.evolving(
            connection, loaded, lambda used: evolution.resume(folder, used, logger)
        )
    )


def read(folder: Folder) -> Run:
    """Return a recorded run, finished or not. Nothing is written.

    Raises:
        ConfigError: there is no run, it is damaged, or the folder holds several runs.

    Example::

        history = zswarm.read("runs/stadium").to_pandas()
    """
    path = Path(folder)
    if not (path / DATABASE).exists() and (below := folders_below(path)):
        raise ConfigError(
            f"{str(path)!r}: a folder of runs; read one of them, such as "
            f"{str(below[0])!r}, or all of them with zswarm.tidy({str(path)!r})"
        )
    return Run(path)


# ---- arguments


def _table(part: str | Mapping[str, Any] | None) -> dict[str, Any] | None:
    if part is None:
        return None
    return {"kind": part} if isinstance(part, str) else dict(part)


def _without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _grid(grid: Mapping[str, Sequence[Any]] | None) -> dict[str, list[Any]] | None:
    if grid is None:
        return None
    if not isinstance(grid, Mapping):
        example = "{'optimizer.population': [50, 100]}"
        raise TypeError(
            f"grid: expected a dict of lists, such as {example}, not {grid!r}"
        )
    for key, values in grid.items():
        if isinstance(values, str | bytes | Mapping) or not isinstance(values, Iterable):
            raise TypeError(
                f"grid: {key}: expected a list of values, such as [{values!r}], not {values!r}"
            )
    return {key: list(values) for key, values in grid.items()}
