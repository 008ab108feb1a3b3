"""``zswarm-ot evaluate``: evaluate a champion on seeds that evolution did not use."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options, suggestions
from zswarm.ot.display import tables
from zswarm.system.format import plural
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.champion.controller import Controller
    from zswarm.ot.replay.held_out import HeldOutResult

MENU = ("Results", 3)
LABEL = 16  # columns


@click.command("evaluate")
@click.argument(
    "path",
    type=options.PATH,
    metavar="RUN|STUDY|CHAMPION.zsc",
    shell_complete=suggestions.runs,
)
@click.option(
    "--trials",
    type=options.TRIALS,
    default=100,
    show_default=True,
    help="Number of trials.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**63 - 1),
    help="Number from which the held-out seeds are derived.  [default: 0]",
)
@click.option(
    "--against",
    type=options.PATH,
    metavar="RUN|CHAMPION.zsc",
    shell_complete=suggestions.runs,
    help="The opponent in a game of several participants.  [default: the champion itself]",
)
@options.set_option_of(
    "problem", "problem.settings.robots=20", ", for one run, not for a study"
)
@options.csv_option
@options.cluster_options
@options.json_option
def command(
    path: Path,
    trials: int,
    seed: int | None,
    against: Path | None,
    overrides: tuple[str, ...],
    csv: str | None,
    as_json: bool,
    **cluster: Any,
) -> None:
    """Evaluate a run's champion, or those of all runs of a study, on held-out seeds.

    Evolution did not use these seeds, so the result is not biased by selection. In a game the
    champion plays another champion, from each side in turn.

    The champions of a study have the same seeds. The results are kept in the runs' folders;
    compare and plot use them: --measure fitness, or a metric. --servers to --max-slots are only
    for a study: a single run is evaluated on this machine.

    \b
      zswarm-ot evaluate runs/minisim
      zswarm-ot evaluate champion.zsc --trials 1000
      zswarm-ot evaluate runs/minisim --set problem.settings.robots=20
      zswarm-ot evaluate runs/minisim-duel --against runs/minisim-duel-2
      zswarm-ot evaluate runs/study --trials 200
    """
    from zswarm.champion.controller import load_controller
    from zswarm.ot.study.study import is_study

    options.check_stdout(csv, as_json=as_json)
    if path.is_dir() and is_study(path):
        if against or overrides:
            raise ConfigError("--against and --set are for the champion of one run")
        _study(path, trials, seed or 0, cluster, csv, as_json=as_json)
        return
    from zswarm.ot.replay import held_out

    _refuse(cluster)
    loaded = [load_controller(each) for each in (path, against) if each is not None]
    controllers = [
        msgspec.structs.replace(
            each,
            simulator_settings=experiment.settings_with(
                each.simulator_settings, overrides
            ),
        )
        for each in loaded
    ]
    controller, opponent = controllers[0], controllers[1] if against is not None else None
    played = held_out.play(controller, trials, seed or 0, opponent)
    _warn(path, against)
    fitness, metrics = played.fitness_summary(), played.metric_means()
    if csv:
        _save(csv, played)
    game = played.score() if played.results.shape[1] > 1 else {}
    if as_json:
        tables.print_json({"trials": trials, **fitness, **game, "metrics": metrics})
        return
    if csv != "-":
        _show(played, controller, opponent)


def _refuse(cluster: dict[str, Any]) -> None:
    """Refuse options of a study for one run."""
    if given := [name for name, value in cluster.items() if value not in (None, ())]:
        option = f"--{given[0].replace('_', '-')}"
        raise ConfigError(f"{option}: the champion of one run plays on this machine only")


def _warn(*paths: Path | None) -> None:
    """Name the runs that other code evolved."""
    from zswarm.ot.record.reader import Run
    from zswarm.ot.replay.held_out import other_code

    for path in paths:
        if path is not None and path.is_dir() and (note := other_code(Run(path))):
            tables.paragraph(note, stderr=True)


def _save(csv: str, played: "HeldOutResult") -> None:
    """Write a row for each trial."""
    from zswarm.ot.analysis import csv as spreadsheet

    columns = zip(played.fitness.tolist(), *played.metrics.T.tolist(), strict=True)
    rows = [[trial, *row] for trial, row in enumerate(columns)]
    spreadsheet.save(csv, ["trial", "fitness", *played.metric_names], rows)


def _show(
    played: "HeldOutResult", controller: "Controller", opponent: "Controller | None"
) -> None:
    """Print what a champion did."""
    fitness, trials = played.fitness_summary(), len(played.fitness)
    game = played.score() if played.results.shape[1] > 1 else {}
    same = played.all_the_same()
    played_trials = plural(trials, "trial" if same else "held-out trial")
    tables.paragraph(
        f"{clean(controller.simulator)}, champion of {clean(controller.run)}, fitness "
        f"{controller.in_search()} in search; {played_trials}"
    )
    if same:
        tables.paragraph("every trial was the same: nothing in them depends on the seed")
    if game:
        name = "itself" if opponent is None else f"the champion of {clean(opponent.run)}"
        counts = ", ".join(f"{count} {result}" for result, count in game.items())
        tables.line(f"{'against':{LABEL}}{name}: {counts}")
    quartiles = " / ".join(f"{fitness[key]:.6g}" for key in ("q25", "median", "q75"))
    tables.line(f"{'fitness':{LABEL}}mean {fitness['mean']:.6g}, quartiles {quartiles}")
    for name, mean in played.metric_means().items():
        tables.line(f"{name:{LABEL}}mean {mean:.6g}")


def _study(
    folder: Path,
    trials: int,
    seed: int,
    cluster: dict[str, Any],
    csv: str | None,
    *,
    as_json: bool,
) -> None:
    """Evaluate the champions of a study, and print a row for each of its settings."""
    from zswarm.ot.analysis import csv as spreadsheet
    from zswarm.ot.analysis import grouping, measure
    from zswarm.ot.cluster.connection import Connection
    from zswarm.ot.record.runs import runs_below
    from zswarm.ot.study import evaluating
    from zswarm.ot.study.study import load_study

    complete = options.with_cluster(load_study(folder), cluster)
    groups = grouping.groups(runs_below([folder]))
    with Connection(complete.cluster) as connection:
        done = evaluating.evaluate(
            groups, connection, trials, seed, lambda line: tables.line(line, stderr=True)
        )
    loaded = {
        group: [(run, measure.load(run)) for run in runs] for group, runs in done.items()
    }
    summaries = [evaluating.summary(group, found) for group, found in loaded.items()]
    if csv:
        spreadsheet.save(csv, *evaluating.rows(loaded))
    if as_json:
        tables.print_json({"trials": trials, "seed": seed, "settings": summaries})
    elif csv != "-":
        names = list(summaries[0]["metrics"])
        columns = [">runs", ">median", ">quartiles", *(f">{name}" for name in names)]
        table = tables.table("setting", *columns)
        for one in summaries:
            quartiles = f"{one['q25']:.4g} / {one['q75']:.4g}"
            metrics = [f"{one['metrics'].get(name, float('nan')):.4g}" for name in names]
            cells = (
                one["setting"],
                one["runs"],
                f"{one['median']:.4g}",
                quartiles,
                *metrics,
            )
            tables.row(table, *cells)
        tables.show(table)
        tables.paragraph(
            f"All champions played the same {plural(trials, 'held-out trial')}. The numbers are "
            "medians and quartiles of the runs' means of a trial."
        )
        tables.line(f"next    zswarm-ot compare {folder} --measure {measure.FITNESS}")
