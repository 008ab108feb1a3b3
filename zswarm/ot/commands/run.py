"""``zswarm-ot run`` and ``resume``."""

import contextlib
import logging
import os
import signal
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from zswarm import experiment
from zswarm.errors import ZswarmError
from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import (
    cluster_options,
    dashboard_option,
    json_lines_option,
    named,
    out_option,
    set_option,
    with_cluster,
)
from zswarm.ot.connection import Connection
from zswarm.ot.exits import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_TERMINATED
from zswarm.protocol.codec import clean

if TYPE_CHECKING:
    from zswarm.ot.evolution import Evolution
    from zswarm.ot.study import Study

DEFAULT_EXAMPLE = "emergency-exit"


@click.command()
@click.argument("name", default=DEFAULT_EXAMPLE, metavar="[EXPERIMENT.toml|EXAMPLE]", shell_complete=suggestions.experiments)
@set_option
@click.option("--seed", type=click.IntRange(0, experiment.LAST_SEED), help="Seed of the run.")
@click.option(
    "--repeat",
    type=click.IntRange(1, experiment.MAX_RUNS),
    metavar="N",
    help="Runs of each setting, with the seeds SEED, SEED + 1, ...; they share the servers.",
)
@cluster_options
@out_option
@dashboard_option
@json_lines_option
def run(
    name: str,
    overrides: tuple[str, ...],
    seed: int | None,
    repeat: int | None,
    out: Path,
    with_dashboard: bool,
    as_json: bool,
    **cluster: Any,
) -> None:
    """Evolve a controller.

    The experiment is a file, or an example by name (zswarm-ot list); without one the built-in example is run.

    \b
      zswarm-ot run stadium
      zswarm-ot run my.toml --set optimizer.population=100
      zswarm-ot run my.toml --servers local

    Servers are found by themselves. Ctrl-C stops it; nothing is lost, and "zswarm-ot resume RUN" goes on. Afterwards
    "zswarm-ot evaluate RUN" plays the champion on unseen seeds.
    """  # noqa: D301  click's mark for text that is not to be wrapped
    path = experiment.find(name)
    more = [f"{key}={value}" for key, value in (("seed", seed), ("study.repeat", repeat)) if value is not None]
    with named(overrides, path):
        loaded = with_cluster(experiment.load(path, [*overrides, *more]), cluster)
    _evaluate_nothing(loaded)
    if loaded.study.runs() > 1 or loaded.study.settings() != [{}]:
        from zswarm.ot.study import Study

        with contextlib.ExitStack() as stack:
            folders, connection = stack.enter_context(_pictures()), stack.enter_context(Connection(loaded.cluster))
            with named(overrides, path):
                study = stack.enter_context(Study.create(loaded, str(path), out))
            _play(study, connection, folders, as_json=as_json, with_dashboard=with_dashboard)
        return
    with _pictures() as folders, Connection(loaded.cluster) as connection, named(overrides, path):
        from zswarm.ot import evolution
        from zswarm.ot.display import display

        shown = display(as_json=as_json)
        with evolution.start(loaded, str(path), out, connection, shown) as begun, _resumable(begun):
            folders.append(begun.folder)
            with _dashboard(begun.folder, shown.on_say, wanted=with_dashboard):
                begun.finish()


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="RUN|STUDY", shell_complete=suggestions.runs)
@cluster_options
@dashboard_option
@json_lines_option
def resume(folder: Path, with_dashboard: bool, as_json: bool, **cluster: Any) -> None:
    """Go on with a run or a study that was stopped.

    It goes on from the last thing that was recorded, and ends as if nothing had happened: with the same history.

    \b
      zswarm-ot resume runs/stadium
    """  # noqa: D301  click's mark for text that is not to be wrapped
    file = folder / "experiment.toml"
    _evaluate_nothing(with_cluster(experiment.load(file), cluster) if file.is_file() else None)
    from zswarm.ot.display import display, summary
    from zswarm.ot.reading import told_again
    from zswarm.ot.record import DATABASE, load_experiment

    if not (folder / DATABASE).exists() and _is_study(folder):  # a run's program starts without what studies import
        from zswarm.ot.study import Study

        with _pictures() as folders, Study.open(folder) as study:
            options = with_cluster(study.experiment, cluster).cluster
            with Connection(options) if study.left else contextlib.nullcontext() as connection:
                _play(study, connection, folders, as_json=as_json, with_dashboard=with_dashboard)
        return
    complete = with_cluster(load_experiment(folder), cluster)
    if (told := told_again(folder, complete)) is not None:
        click.echo(f"{clean(str(folder))} is finished; to go on longer, raise generations in its experiment.toml", err=True)
        if as_json:
            display(as_json=True).on_end(told)
        else:
            click.echo(summary(told))
        return
    with _pictures() as folders, Connection(complete.cluster) as connection:
        from zswarm.ot import evolution

        shown = display(as_json=as_json)
        with evolution.resume(folder, connection, shown) as begun, _resumable(begun):
            folders.append(begun.folder)
            with _dashboard(begun.folder, shown.on_say, wanted=with_dashboard):
                begun.finish()


@contextlib.contextmanager
def _dashboard(folder: Path, say: Callable[[str], None], *, wanted: bool) -> Iterator[None]:
    """Of the run or study, while it goes on."""
    if not wanted:
        yield
        return
    from zswarm.ot import beside

    with beside.dashboard(folder, say):
        yield


def _is_study(folder: Path) -> bool:
    from zswarm.ot.study import is_study

    return is_study(folder)


def _play(study: "Study", connection: Connection | None, folders: list[Path], *, as_json: bool, with_dashboard: bool) -> None:
    """However the study is stopped, its runs are closed, and a line says how to go on."""
    from zswarm.ot.study_display import follower

    signal.signal(signal.SIGTERM, _terminate)
    try:
        with _dashboard(study.folder, lambda line: click.echo(line, err=True), wanted=with_dashboard):
            outcome = study.play(connection, follower(as_json=as_json))
    except (KeyboardInterrupt, SystemExit, ZswarmError, sqlite3.Error, OSError) as error:
        _say_how_to_go_on(study.folder, error)
        if study.going_on:  # a second Ctrl-C, or a disk that takes nothing: nobody waits for their threads
            if connection is not None:
                connection.close()
            for line in getattr(error, "__notes__", []):
                click.echo(f"zswarm-ot: {error}\n{line}", err=True)
            codes = {KeyboardInterrupt: EXIT_INTERRUPTED, SystemExit: EXIT_TERMINATED}
            os._exit(codes.get(type(error), EXIT_FAILED))
        raise
    folders.append(study.folder)
    if outcome.failed:
        raise SystemExit(EXIT_FAILED)


@contextlib.contextmanager
def _resumable(begun: "Evolution") -> Iterator[None]:
    """However the run is stopped, it is closed, and a line says how to go on."""
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    except (KeyboardInterrupt, SystemExit, ZswarmError, sqlite3.Error, OSError) as error:
        begun.close()
        _say_how_to_go_on(begun.folder, error)
        raise


def _say_how_to_go_on(folder: Path, error: BaseException) -> None:
    """Where the program ends with a reason, that is said first."""
    line = f"stopped; nothing is lost. Go on with: zswarm-ot resume {folder}"
    if isinstance(error, (KeyboardInterrupt, SystemExit)):
        click.echo(line, err=True)
    else:
        error.add_note(line)


@contextlib.contextmanager
def _pictures() -> Iterator[list[Path]]:
    """Takes the folders in which a picture is to be left when all else is done."""
    folders: list[Path] = []
    try:
        yield folders
    finally:
        if folders:
            from zswarm.ot import figures

            logging.getLogger("matplotlib").setLevel(logging.ERROR)  # where it keeps its fonts is no matter of a run
            for folder in folders:
                figures.leave(folder, lambda line: click.echo(line, err=True))


def _terminate(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(EXIT_TERMINATED)


def _evaluate_nothing(loaded: experiment.Experiment | None) -> None:
    """This program handles genomes; servers evaluate them. Without numba it starts a third of a second earlier."""
    if loaded is None or loaded.cluster.controller == "server":
        os.environ["ZSWARM_PLAIN"] = "1"
