"""``zswarm-ot check``: what an experiment amounts to, without running it."""

from typing import TYPE_CHECKING

import click

from zswarm import experiment
from zswarm.experiment import Experiment
from zswarm.ot.commands.options import json_option, set_option

if TYPE_CHECKING:
    from zswarm.ot.run import Parts


@click.command()
@click.argument("name", metavar="EXPERIMENT.toml|EXAMPLE")
@set_option
@json_option
def check(name: str, overrides: tuple[str, ...], as_json: bool) -> None:
    """Check an experiment and say what it amounts to, without running it."""
    from zswarm.ot import run as runs

    path = experiment.find(name)
    complete = experiment.complete(experiment.load(path, overrides), str(path))
    show(complete, runs.build(complete), as_json=as_json)


def show(complete: Experiment, parts: "Parts", *, as_json: bool) -> None:
    """What an experiment amounts to."""
    from zswarm.ot import terminal

    simulator, network = parts.problem.simulator, parts.problem.representation
    values = {
        "experiment": complete.name,
        "simulator": complete.problem.simulator,
        "agents": len(simulator.owners),
        "inputs": simulator.inputs,
        "outputs": simulator.outputs,
        "metrics": list(simulator.metrics),
        "trials": complete.problem.trials,
        "representation": complete.representation.kind,
        "genome_bytes": network.genome_bytes,
        "optimizer": complete.optimizer.kind,
        "portable": parts.optimizer.portable,
        "generations": complete.generations,
        "candidates_first_generation": len(parts.optimizer.ask()),
    }
    if as_json:
        terminal.print_json(values)
        return
    for key, value in values.items():
        terminal.line(f"{key.replace('_', ' '):28}{', '.join(value) if isinstance(value, list) else value}")
    terminal.line("the experiment is fine")
