"""``zswarm-ot resume``: continue a run or a study."""

import contextlib
from pathlib import Path
from typing import Any

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options, suggestions
from zswarm.system.format import plural
from zswarm.system.text import clean

MENU = ("Evolve", 2)


@click.command("resume")
@click.argument(
    "folder", type=options.PATH, metavar="RUN|STUDY", shell_complete=suggestions.runs
)
@click.option(
    "--from",
    "generation",
    type=click.IntRange(min=1),
    metavar="N",
    help="Go back first: drop generation N, counted from 1, and all after it, and evaluate them "
    "again. The record as it was is kept next to the new one.",
)
@click.option(
    "--trust",
    "trusted",
    multiple=True,
    metavar="MACHINE",
    help="Use a machine again that was banned, because it computed wrong: what the line names that "
    "says so. May be given several times.",
)
@options.cluster_options
@options.dashboard_option
@options.detach_option
@options.json_lines_option
def command(
    folder: Path,
    generation: int | None,
    trusted: tuple[str, ...],
    with_dashboard: bool,
    detach: bool,
    as_json: bool,
    **cluster: Any,
) -> None:
    """Resume a run or a study that was stopped.

    It continues from the last thing that was recorded, and ends with the same history as if it had
    not been stopped.

    \b
      zswarm-ot resume runs/stadium
      zswarm-ot resume runs/stadium --from 13
      zswarm-ot resume runs/stadium --trust lab-02
    """
    from zswarm.ot.commands.shared import detaching

    # Before it starts threads or other processes.
    settle = detaching.detach(wanted=detach, as_json=as_json)
    from zswarm.ot import evolution
    from zswarm.ot.cluster.connection import Connection
    from zswarm.ot.commands.shared import playing
    from zswarm.ot.display.progress import display
    from zswarm.ot.record.folder import DATABASE, load_experiment
    from zswarm.ot.record.results import finished_result
    from zswarm.ot.study.study import Study, is_study

    if generation is not None:
        _go_back(folder, generation)
    if not (folder / DATABASE).exists() and is_study(folder):
        _refuse_study(folder, "--trust" if trusted else "")
        shown_as = {"as_json": as_json, "with_dashboard": with_dashboard}
        with playing.figures() as folders, Study.open(folder) as study:
            settings = options.with_cluster(study.experiment, cluster).cluster
            opened: Any = Connection(settings) if study.left else contextlib.nullcontext()
            with opened as connection:
                settle(folder)
                playing.play(study, connection, folders, **shown_as)
        return
    complete = options.with_cluster(load_experiment(folder), cluster)
    shown = display(as_json=as_json)
    if (result := finished_result(folder, complete)) is not None:
        _show_finished(folder, result, shown, as_json=as_json)
        return
    with (
        playing.figures() as folders,
        Connection(complete.cluster) as connection,
        evolution.resume(folder, connection, shown, trusted) as run,
    ):
        folders.append(run.folder)
        settle(folder)
        playing.finish(run, shown, with_dashboard=with_dashboard)


def _show_finished(folder: Path, result: Any, shown: Any, *, as_json: bool) -> None:
    from zswarm.ot.display.progress import summary

    more = "to evolve further, raise generations in its experiment.toml"
    click.echo(f"{clean(str(folder))} is finished; {more}", err=True)
    if as_json:
        shown.on_end(result)
    else:
        click.echo(summary(result))


def _refuse_study(folder: Path, option: str) -> None:
    if option:
        raise ConfigError(
            f"{clean(str(folder))}: {option} takes the folder of a run, not a study's"
        )


def _go_back(folder: Path, generation: int) -> None:
    """Drop a generation and all after it, and say so."""
    from zswarm.ot.record.folder import DATABASE
    from zswarm.ot.record.rollback import go_back
    from zswarm.ot.study.study import is_study

    if not (folder / DATABASE).exists() and is_study(folder):
        _refuse_study(folder, "--from")
    former = go_back(folder, generation - 1)
    click.echo(
        f"{clean(str(folder))}: generations from {generation} on are evaluated again; the record "
        f"as it was is {clean(former.path.name)}",
        err=True,
    )
    if former.damaged:
        click.echo(
            f"{plural(former.damaged, 'damaged event')} dropped: a machine that one of them banned "
            "is used again",
            err=True,
        )
