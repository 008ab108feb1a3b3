"""``zswarm-ot run``: evolve a controller."""

import contextlib
from pathlib import Path
from typing import Any

import click

from zswarm import experiment
from zswarm.config.sections import MAX_RUNS
from zswarm.errors import ConfigError
from zswarm.experiment import LAST_SEED, Experiment
from zswarm.ot.commands.shared import options, suggestions
from zswarm.system.text import clean

MENU = ("Evolve", 1)
EXAMPLE = "stadium"  # that is run if none is named
SEARCH_S = 1.0  # for servers that such a run does not use


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
    help="Runs of each setting, with the seeds SEED, SEED + 1, ...; they share the servers.",
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
    RUN" continues it. Afterwards "zswarm-ot evaluate RUN" plays the champion on held-out seeds.
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
    loaded = _load(path, overrides, given, cluster)
    if name is None and not _about_servers(overrides, cluster):
        loaded = on_this_machine(loaded)
    errors = options.blamed(overrides, path)
    shown = {"as_json": as_json, "with_dashboard": with_dashboard}
    with playing.figures() as folders, Connection(loaded.cluster) as connection, errors:
        if loaded.study.runs() > 1 or loaded.study.varies():
            from zswarm.ot.study import effort_table
            from zswarm.ot.study.study import Study

            with Study.create(loaded, str(path), out) as study:
                effort_table.announce(loaded, study.cells, study.experiment.study.repeat)
                settle(study.folder)
                playing.play(study, connection, folders, **shown)
            return
        logger = display(as_json=as_json)
        with evolution.start(loaded, str(path), out, connection, logger) as run:
            folders.append(run.folder)
            settle(run.folder)
            playing.finish(run, logger, with_dashboard=with_dashboard)


def _load(
    path: Path,
    overrides: tuple[str, ...],
    given: dict[str, int | None],
    cluster: dict[str, Any],
) -> Experiment:
    more = [f"{key}={value}" for key, value in given.items() if value is not None]
    with options.blamed(overrides, path):
        return options.with_cluster(experiment.load(path, [*overrides, *more]), cluster)


def _about_servers(overrides: tuple[str, ...], cluster: dict[str, Any]) -> bool:
    """Return whether an option is about servers."""
    given = [value for value in cluster.values() if value not in (None, ())]
    return bool(given) or any(key.strip().startswith("cluster.") for key in overrides)


def on_this_machine(loaded: Experiment) -> Experiment:
    """Return an experiment that uses this machine only; name the servers that it would find."""
    from zswarm.ot.cluster import discovery
    from zswarm.ot.cluster.connection import Connection
    from zswarm.system.format import plural

    found = []
    with contextlib.suppress(ConfigError):  # keys that cannot be used: it needs none
        reach = Connection(loaded.cluster).reach
        found = discovery.names(loaded.cluster.realm, reach, wait_s=SEARCH_S)
    if found:
        servers = f"{plural(len(found), 'server')} found: {', '.join(map(clean, found))}"
        hint = "to use other machines, too: zswarm-ot run --servers auto"
        click.echo(f"{servers}; {hint}", err=True)
    return options.with_cluster(loaded, {"servers": "local"})
