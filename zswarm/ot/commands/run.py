"""``zswarm-ot run``: evolve a controller."""

import contextlib
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from zswarm import experiment
from zswarm.config import overrides as changes
from zswarm.config.sections import MAX_RUNS, ClusterConfig
from zswarm.errors import ConfigError
from zswarm.experiment import LAST_SEED, Experiment
from zswarm.ot.commands.shared import options, suggestions
from zswarm.system.format import plural
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.ot.study.study import Study

MENU = ("Evolve", 1)
EXAMPLE = "stadium"  # that is run if none is named
SEARCHER, SEARCH_S = (
    "search",
    1.0,
)  # the thread that finds servers that such a run does not use


@click.command("run")
@click.argument(
    "name",
    required=False,
    metavar="[EXPERIMENT.toml|EXAMPLE]",
    shell_complete=suggestions.experiments,
)
@options.set_option
@click.option("--seed", type=click.IntRange(0, LAST_SEED), help="Seed of the run.")
@options.number_option("--generations", help="Generations to evolve.")
@options.number_option("--population", help="Candidates of a generation.")
@options.number_option("--trials", help="Trials that judge each candidate.")
@click.option(
    "--repeat",
    type=click.IntRange(1, MAX_RUNS),
    metavar="N",
    help="Repeat the run, or each setting of a study, with the seeds SEED, SEED + 1, ...",
)
@options.cluster_options
@options.out_option
@options.dashboard_option
@options.detach_option
@options.json_lines_option
def command(
    name: str | None,
    overrides: tuple[str, ...],
    seed: int | None,
    generations: int | None,
    population: int | None,
    trials: int | None,
    repeat: int | None,
    out: Path,
    with_dashboard: bool,
    detach: bool,
    as_json: bool,
    **cluster: Any,
) -> None:
    """Evolve a controller.

    The experiment is a file, or an example by name (zswarm-ot list). Without one, the example
    stadium is run on this machine only, unless an option is about servers.

    \b
      zswarm-ot run stadium
      zswarm-ot run my.toml --set optimizer.population=100
      zswarm-ot run my.toml --servers local

    Servers are found automatically. Ctrl-C stops the run; nothing is lost, and "zswarm-ot resume
    RUN" continues it. Afterwards "zswarm-ot evaluate RUN" tests the champion on held-out seeds.
    """
    from zswarm.ot.commands.shared import detaching

    # Before it starts threads or other processes.
    settle = detaching.detach(wanted=detach, as_json=as_json)
    from zswarm.ot import evolution
    from zswarm.ot.cluster.connection import Connection
    from zswarm.ot.commands.shared import playing
    from zswarm.ot.display.progress import display

    path = experiment.find(name or EXAMPLE)
    given = {"seed": seed, "generations": generations, "study.repeat": repeat}
    given |= {"optimizer.population": population, "problem.trials": trials}
    blamed = partial(changes.blamed, _words(overrides, given), str(path))
    with blamed():
        loaded = _load(path, overrides, given, cluster)
    shown = {"as_json": as_json, "with_dashboard": with_dashboard}
    with contextlib.ExitStack() as stack:
        folders = stack.enter_context(playing.figures())
        if name is None and not _about_servers(overrides, cluster):
            stack.enter_context(naming_unused_servers(loaded.cluster))
            loaded = options.with_cluster(loaded, {"servers": "local"})
        connection = stack.enter_context(Connection(loaded.cluster))
        stack.enter_context(blamed())
        if loaded.study.asks_for_runs():
            with _study(loaded, path, out) as study:
                settle(study.folder)
                playing.play(study, connection, folders, **shown)
            return
        logger = display(as_json=as_json)
        with evolution.start(loaded, str(path), out, connection, logger) as run:
            folders.append(run.folder)
            settle(run.folder)
            playing.finish(run, logger, with_dashboard=with_dashboard)


def _study(loaded: Experiment, path: Path, out: Path) -> "Study":
    """Return a new study, after its effort was shown."""
    from zswarm.ot.study import effort_table
    from zswarm.ot.study.study import Study

    study = Study.create(loaded, str(path), out)
    effort_table.announce(loaded, study.cells, study.experiment.study.repeat)
    return study


def _load(
    path: Path,
    overrides: tuple[str, ...],
    given: dict[str, int | None],
    cluster: dict[str, Any],
) -> Experiment:
    more = [f"{key}={value}" for key, value in given.items() if value is not None]
    return options.with_cluster(experiment.load(path, [*overrides, *more]), cluster)


def _words(
    overrides: tuple[str, ...], given: dict[str, int | None]
) -> list[tuple[str, str]]:
    """Return the keys that options set, and the options."""
    return options.given_by_set(overrides) + [
        (key, f"--{key.rpartition('.')[2]} {value}")
        for key, value in given.items()
        if value is not None
    ]


def _about_servers(overrides: tuple[str, ...], cluster: dict[str, Any]) -> bool:
    """Return whether an option is about servers."""
    given = [value for value in cluster.values() if value not in (None, ())]
    return bool(given) or any(key.strip().startswith("cluster.") for key in overrides)


@contextlib.contextmanager
def naming_unused_servers(cluster: ClusterConfig) -> Iterator[None]:
    """Name the servers that were found meanwhile, in a block that uses this machine only."""
    found: list[str] = []

    def search() -> None:
        from zswarm.ot.cluster import discovery
        from zswarm.ot.cluster.connection import Connection

        with contextlib.suppress(ConfigError):  # keys that cannot be used: it needs none
            reach = Connection(cluster).reach
            found.extend(discovery.names(cluster.realm, reach, wait_s=SEARCH_S))

    threading.Thread(target=search, name=SEARCHER, daemon=True).start()
    yield
    if found:
        servers = f"{plural(len(found), 'server')} found: {', '.join(map(clean, found))}"
        hint = "to use other machines, too: zswarm-ot run --servers auto"
        click.echo(f"{servers}; {hint}", err=True)
