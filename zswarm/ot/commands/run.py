"""``zswarm-ot run`` and ``resume``."""

import contextlib
import logging
import os
import signal
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from zswarm import experiment
from zswarm.errors import ZswarmError
from zswarm.ot.commands.options import cluster_options, json_option, set_option, with_cluster
from zswarm.ot.connection import Connection
from zswarm.ot.exits import EXIT_TERMINATED

if TYPE_CHECKING:
    from zswarm.ot.evolution import Evolution

DEFAULT_EXAMPLE = "emergency-exit"


@click.command()
@click.argument("name", default=DEFAULT_EXAMPLE, metavar="[EXPERIMENT.toml|EXAMPLE]")
@set_option
@click.option("--seed", type=click.IntRange(0, 2**63 - 2), help="Seed of the run.")
@cluster_options
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs"),
    show_default=True,
    help="Where the run's folder is made.",
)
@json_option
def run(name: str, overrides: tuple[str, ...], seed: int | None, out: Path, as_json: bool, **cluster: Any) -> None:
    """Evolve a controller; without an argument, the built-in example."""
    path = experiment.find(name)
    more = [f"seed={seed}"] if seed is not None else []
    loaded = with_cluster(experiment.load(path, [*overrides, *more]), cluster)
    _evaluate_nothing()
    with _pictures() as folders, Connection(loaded.cluster) as connection:
        from zswarm.ot import evolution
        from zswarm.ot.display import display

        with evolution.start(loaded, str(path), out, connection, display(as_json=as_json)) as begun, _resumable(begun):
            folders.append(begun.folder)
            begun.finish()


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="RUN")
@cluster_options
@json_option
def resume(folder: Path, as_json: bool, **cluster: Any) -> None:
    """Go on with a run that was stopped, from the last thing it recorded."""
    _evaluate_nothing()
    from zswarm.ot.record import load_experiment

    with _pictures() as folders, Connection(with_cluster(load_experiment(folder), cluster).cluster) as connection:
        from zswarm.ot import evolution
        from zswarm.ot.display import display

        with evolution.resume(folder, connection, display(as_json=as_json)) as begun, _resumable(begun):
            folders.append(begun.folder)
            begun.finish()


@contextlib.contextmanager
def _resumable(begun: "Evolution") -> Iterator[None]:
    """However the run is stopped, it is closed, and a line says how to go on."""
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    except (KeyboardInterrupt, SystemExit, ZswarmError, sqlite3.Error, OSError):
        begun.close()
        click.echo(f"stopped; nothing is lost. Go on with: zswarm-ot resume {begun.folder}", err=True)
        raise


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


def _evaluate_nothing() -> None:
    """This program handles genomes; servers evaluate them. Without numba it starts a third of a second earlier."""
    os.environ["ZSWARM_PLAIN"] = "1"
