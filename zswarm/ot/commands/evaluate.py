"""``zswarm-ot evaluate``: a champion on seeds it was not evolved on."""

from pathlib import Path

import click

from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import json_option


@click.command()
@click.argument("path", type=click.Path(path_type=Path), metavar="RUN|CHAMPION.zsc", shell_complete=suggestions.runs)
@click.option("--trials", type=click.IntRange(1, 1_000_000), default=100, show_default=True, help="Trials to play.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Seed of the trials: unseen ones by default.")
@json_option
def evaluate(path: Path, trials: int, seed: int | None, as_json: bool) -> None:
    """Play a run's champion on unseen seeds.

    How good it is on trials that it was not evolved on: that is what counts.

    \b
      zswarm-ot evaluate runs/stadium
      zswarm-ot evaluate champion.zsc --trials 1000
    """  # noqa: D301  click's mark for text that is not to be wrapped
    from zswarm.ot import terminal, unseen
    from zswarm.ot.controller import load_controller
    from zswarm.protocol.codec import clean

    controller = load_controller(path)
    played = unseen.play(controller, trials, seed or 0)
    fitness, metrics = played.fitness_summary(), played.metric_means()
    if as_json:
        terminal.print_json({"trials": trials, **fitness, "metrics": metrics})
        return
    same = played.all_the_same()
    terminal.paragraph(
        f"{clean(controller.simulator)}, champion of {clean(controller.run)} (fitness {controller.fitness:.6g}), "
        f"{terminal.plural(trials, 'trial' if same else 'unseen trial')}"
    )
    if same:
        terminal.paragraph("every trial was the same: nothing in them depends on the seed")
    quartiles = " / ".join(f"{fitness[key]:.6g}" for key in ("q25", "median", "q75"))
    terminal.line(f"{'fitness':16}mean {fitness['mean']:.6g}, quartiles {quartiles}")
    for name, mean in metrics.items():
        terminal.line(f"{name:16}mean {mean:.6g}")
