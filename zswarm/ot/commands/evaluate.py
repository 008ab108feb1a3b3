"""``zswarm-ot evaluate``: a champion on seeds it was not evolved on."""

from pathlib import Path

import click
import msgspec

from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import json_option


@click.command()
@click.argument("path", type=click.Path(path_type=Path), metavar="RUN|CHAMPION.zsc", shell_complete=suggestions.runs)
@click.option("--trials", type=click.IntRange(1, 1_000_000), default=100, show_default=True, help="Trials to play.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Seed of the trials: unseen ones by default.")
@click.option(
    "--against",
    type=click.Path(path_type=Path),
    metavar="RUN|CHAMPION.zsc",
    shell_complete=suggestions.runs,
    help="The opponent in a game of several participants: the champion itself by default.",
)
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Set something of the problem, such as problem.settings.agents=20; may be repeated.",
)
@json_option
def evaluate(path: Path, trials: int, seed: int | None, against: Path | None, overrides: tuple[str, ...], as_json: bool) -> None:
    """Play a run's champion on unseen seeds.

    How good it is on trials that it was not evolved on: that is what counts. In a game it plays another champion, from
    each side in turn.

    \b
      zswarm-ot evaluate runs/stadium
      zswarm-ot evaluate champion.zsc --trials 1000
      zswarm-ot evaluate runs/minisim --set problem.settings.robots=20
      zswarm-ot evaluate runs/minisim-duel --against runs/minisim-duel-2
    """  # noqa: D301  click's mark for text that is not to be wrapped
    from zswarm import experiment
    from zswarm.controller import load_controller
    from zswarm.ot import terminal, unseen
    from zswarm.protocol.codec import clean

    loaded = [load_controller(each) for each in (path, against) if each is not None]
    controller, *others = [
        msgspec.structs.replace(each, simulator_settings=experiment.settings_with(each.simulator_settings, overrides))
        for each in loaded
    ]
    opponent = others[0] if others else None
    played = unseen.play(controller, trials, seed or 0, opponent)
    fitness, metrics = played.fitness_summary(), played.metric_means()
    game = played.score() if played.results.shape[1] > 1 else {}
    if as_json:
        terminal.print_json({"trials": trials, **fitness, **game, "metrics": metrics})
        return
    same = played.all_the_same()
    terminal.paragraph(
        f"{clean(controller.simulator)}, champion of {clean(controller.run)} (fitness {controller.fitness:.6g}), "
        f"{terminal.plural(trials, 'trial' if same else 'unseen trial')}"
    )
    if same:
        terminal.paragraph("every trial was the same: nothing in them depends on the seed")
    if game:
        name = "itself" if opponent is None else f"the champion of {clean(opponent.run)}"
        terminal.line(f"{'against':16}{name}: {', '.join(f'{count} {what}' for what, count in game.items())}")
    quartiles = " / ".join(f"{fitness[key]:.6g}" for key in ("q25", "median", "q75"))
    terminal.line(f"{'fitness':16}mean {fitness['mean']:.6g}, quartiles {quartiles}")
    for name, mean in metrics.items():
        terminal.line(f"{name:16}mean {mean:.6g}")
