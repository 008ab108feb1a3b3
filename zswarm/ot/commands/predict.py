"""``zswarm-ot predict``: how long an experiment takes on the servers that are there, and in other designs."""

from typing import TYPE_CHECKING, Any

import click

from zswarm import experiment
from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import cluster_options, json_option, named, set_option, with_cluster

if TYPE_CHECKING:
    from zswarm.experiment import Experiment
    from zswarm.ot.constants import Measured
    from zswarm.ot.prediction import Predicted


@click.command()
@click.argument("name", metavar="EXPERIMENT.toml|EXAMPLE", shell_complete=suggestions.experiments)
@set_option
@cluster_options
@click.option(
    "--slots",
    type=click.IntRange(1, 1_000_000),
    metavar="N",
    help="Predict for so many slots, not for those that are there.",
)
@click.option(
    "--table1", is_flag=True, help="Calculate with the times that the paper measured (its Table I), not with measured ones."
)
@json_option
def predict(name: str, overrides: tuple[str, ...], slots: int | None, table1: bool, as_json: bool, **cluster: Any) -> None:
    """Say how long an experiment takes, before it is run.

    Some seconds of trials and messages on the servers that are there show what each of them takes; a model calculates
    from that the time of the whole run, its messages, and the number of slots beyond which nothing is gained. Other
    designs stand beside it: those of the paper that zswarm follows.

    \b
      zswarm-ot predict minisim
      zswarm-ot predict my.toml --servers local
      zswarm-ot predict my.toml --slots 64
    """  # noqa: D301  click's mark for text that is not to be wrapped
    from zswarm.ot import prediction, terminal

    path = experiment.find(name)
    with named(overrides, path):
        complete = experiment.complete(with_cluster(experiment.load(path, overrides), cluster), str(path))
        measured = _table_1(complete) if table1 else _measured(complete)
    used = slots or measured.slots
    ways = prediction.predict(measured.plan, measured.constants, used)
    if as_json:
        terminal.print_json(_mapping(complete, measured, ways, used, table1=table1))
        return
    _show(complete, measured, used, table1=table1)
    _show_ways(ways, used)


def _measured(complete: "Experiment") -> "Measured":
    from zswarm.ot import constants
    from zswarm.ot import run as runs
    from zswarm.ot.connection import Connection

    parts = runs.build(complete)
    with Connection(complete.cluster) as connection:
        return constants.measure(complete, parts, connection)


def _table_1(complete: "Experiment") -> "Measured":
    """With the paper's times, on one slot."""
    import numpy as np

    from zswarm.ot import constants, cost_model
    from zswarm.ot import run as runs

    problem, optimizer = runs.build(complete)
    genomes = optimizer.ask()
    optimizer.tell(np.arange(len(genomes), dtype=np.float64), np.zeros((len(genomes), len(optimizer.measures))))
    plan = constants.plan_of(problem, genomes, len(genomes), len(optimizer.ask()))
    return constants.Measured(plan, cost_model.TABLE_I, servers=1, slots=1)


def _show(complete: "Experiment", measured: "Measured", slots: int, *, table1: bool) -> None:
    """What was measured, and where each number is from."""
    from zswarm.ot import terminal
    from zswarm.ot.explanation import in_time
    from zswarm.protocol.codec import clean

    plan, constants, plural = measured.plan, measured.constants, terminal.plural
    files_s = constants.export_s + constants.compile_s + constants.fitness_s
    turns = "" if plan.turns == 1 else f", in each {plan.turns} turns"
    found = f"{plural(measured.servers, 'server')} with {plural(measured.slots, 'slot')}"
    where = "Table I of the paper" if table1 else "measured"
    paper = where if table1 else "Table I of the paper: not measured here"
    known = {"message": f"{in_time(constants.message_s)}, one way: half of a question and its answer; {where}"}
    if not table1:
        known["dispatch"] = f"{in_time(constants.dispatch_s)} of this program's computing for a trial; {where}"
        known["batch"] = f"{plural(constants.batch, 'trial')} in a message, by the time of a trial"
    for about, text in {
        "experiment": f"{complete.name}: {plural(plan.generations, 'generation')}, {plan.simulations:,} simulations of "
        f"{plural(plan.steps, 'step')} with {plural(plan.agents, 'agent')}{turns}",
        "servers": ("" if table1 else f"{found} can run it") + (f"; predicted for {slots:,}" if slots != measured.slots else "")
        or plural(slots, "slot"),
        "step": f"{in_time(constants.step_s)} for all agents; {where}",
        **known,
        "generation": f"{in_time(constants.evolve_s)} between two, in which slots wait; {where}",
        "files": f"{in_time(files_s)} to export, compile and read logs; {paper}",
    }.items():
        terminal.entry(about, clean(text))


def _show_ways(ways: "list[Predicted]", slots: int) -> None:
    from zswarm.ot import terminal
    from zswarm.ot.explanation import in_time
    from zswarm.ot.prediction import MEANINGS

    terminal.line("")
    table = terminal.table("controller", "messages", "time", "slots of use", box=None, padding=(0, 2, 0, 0))
    for way in ways:
        terminal.row(table, way.way, f"{way.messages:,.0f}", in_time(way.seconds), f"{way.useful_slots:,}")
    terminal.show(table)
    terminal.line("")
    for name, meaning in MEANINGS.items():
        terminal.entry(name, meaning, label=21)
    best = ways[0]
    terminal.line("")
    terminal.paragraph(
        f"Predicted with {terminal.plural(slots, 'slot')}: about {in_time(best.seconds)}. More than {best.useful_slots:,} slots "
        "gain nothing: a generation has no more trials to share, or the optimizer no more time."
    )


def _mapping(
    complete: "Experiment", measured: "Measured", ways: "list[Predicted]", slots: int, *, table1: bool
) -> dict[str, Any]:
    import msgspec

    return {
        "experiment": complete.name,
        "constants_from": "table1" if table1 else "measured",
        "servers": measured.servers,
        "slots": slots,
        "plan": msgspec.to_builtins(measured.plan),
        "constants": msgspec.to_builtins(measured.constants),
        "ways": msgspec.to_builtins(ways),
    }
