"""``zswarm-ot predict``: predict how long an experiment takes, here and in other designs."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click
import msgspec

from zswarm.config.sections import StopConfig
from zswarm.experiment import Experiment
from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.ot.estimate import cost_model
from zswarm.system.format import duration, plural
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.ot.estimate.calibration import Calibration

MENU = ("Begin", 3)
PAPER = "Table I of the paper"


@click.command("predict")
@options.experiment_argument
@options.set_option
@options.cluster_options
@click.option(
    "--slots",
    type=click.IntRange(1, 1_000_000),
    metavar="N",
    help="Predict for this number of slots.  [default: the available ones]",
)
@click.option(
    "--table1",
    is_flag=True,
    help="Use the times of Table I of the CPSwarm paper instead of measuring.",
)
@options.json_option
def command(
    name: str,
    overrides: tuple[str, ...],
    slots: int | None,
    table1: bool,
    as_json: bool,
    **cluster: Any,
) -> None:
    """Predict how long an experiment takes.

    A few seconds of trials and messages on the available servers show how long each of them
    takes. From that a model calculates the time of the whole run, its messages, and the number of
    slots beyond which nothing is gained. Also predicts the two designs measured in the CPSwarm
    paper (docs/paper.md).

    \b
      zswarm-ot predict minisim
      zswarm-ot predict my.toml --servers local
      zswarm-ot predict my.toml --slots 64
    """
    from zswarm.ot import build
    from zswarm.ot.cluster.connection import Connection
    from zswarm.ot.estimate import calibration

    complete = options.complete(name, overrides, cluster)
    parts = build.build(complete)
    if table1:
        measured = calibration.of_table_1(parts)
    else:
        with Connection(complete.cluster) as connection:
            measured = calibration.calibrate(parts, connection)
    slots = slots or measured.slots
    ways = cost_model.predict(measured.plan, measured.constants, slots)
    if as_json:
        builtins = {"plan": measured.plan, "constants": measured.constants, "ways": ways}
        tables.print_json(
            {
                "experiment": complete.name,
                "constants_from": "table1" if table1 else "measured",
                "servers": measured.servers,
                "slots": slots,
                **{key: msgspec.to_builtins(value) for key, value in builtins.items()},
            }
        )
        return
    for about, text in _lines(complete, measured, slots, table1=table1):
        tables.entry(about, clean(text))
    _show_ways(ways, slots)


def _lines(
    complete: Experiment, measured: "Calibration", slots: int, *, table1: bool
) -> Iterator[tuple[str, str]]:
    """Yield what a line is about, and its text: what is known, and from where."""
    plan, constants = measured.plan, measured.constants
    source = PAPER if table1 else "measured"
    turns = "" if plan.turns == 1 else f", {plan.turns} turns each"
    about = "about " if complete.assessment.racing else ""
    after = f"; {plan.after:,} of them after the last generation" if plan.after else ""
    yield (
        "experiment",
        f"{complete.name}: {plural(plan.generations, 'generation')}, "
        f"{about}{plural(plan.simulations, 'simulation')} of {plural(plan.steps, 'step')} with "
        f"{plural(plan.agents, 'agent')}{turns}{after}",
    )
    if limits := _unpredicted(complete.stop):
        yield "stop", f"the run may end earlier, which is not predicted: {limits}"
    found = plural(measured.slots, "slot")
    if not table1:
        found = f"{plural(measured.servers, 'server')} with {found} can run it"
    yield (
        "servers",
        found + ("" if slots == measured.slots else f"; predicted for {slots:,}"),
    )
    yield "step", f"{duration(constants.step_s)} for all agents; {source}"
    message = duration(constants.message_s)
    yield "message", f"{message}, one way: half of a question and its answer; {source}"
    if not table1:
        dispatch = duration(constants.dispatch_s)
        yield (
            "dispatch",
            f"{dispatch} of this program's computing time for a trial; {source}",
        )
        yield (
            "batch",
            f"{plural(constants.batch, 'trial')} in a message, by the time of a trial",
        )
    gap = duration(constants.evolve_s)
    yield "generation", f"{gap} between two, in which slots wait; {source}"
    files = duration(constants.export_s + constants.compile_s + constants.fitness_s)
    unmeasured = "" if table1 else ": not measured here"
    yield "files", f"{files} to export, compile and read logs; {PAPER}{unmeasured}"


def _unpredicted(stop: StopConfig) -> str:
    """Return the limits of a run that depend on what it finds, or how fast it is, in words."""
    limits = []
    if stop.fitness != "none":
        limits.append(f"a candidate has the fitness {stop.fitness:g}")
    if stop.stagnation:
        found = plural(stop.stagnation, "generation")
        limits.append(f"{found} in a row find nothing better")
    if stop.seconds:
        limits.append(f"{duration(stop.seconds)} of computing are over")
    return ", or ".join(limits)


def _show_ways(ways: list[cost_model.Predicted], slots: int) -> None:
    tables.line("")
    columns = ("controller", ">messages", ">time", ">useful slots")
    table = tables.table(*columns, box=None, padding=(0, 2, 0, 0))
    for way in ways:
        numbers = (f"{way.messages:,.0f}", duration(way.seconds), f"{way.useful_slots:,}")
        tables.row(table, way.way, *numbers)
    tables.show(table)
    tables.line("")
    for name, (_, meaning) in cost_model.WAYS.items():
        tables.entry(name, meaning, label=21)
    tables.line("")
    tables.paragraph(
        f"Predicted with {plural(slots, 'slot')}: about {duration(ways[0].seconds)}. More than "
        f"{plural(ways[0].useful_slots, 'slot')} gain nothing: a generation has no more trials to "
        "share, or the optimizer no more time."
    )
