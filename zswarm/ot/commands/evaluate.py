"""``zswarm-ot evaluate``: play a champion on seeds that it was not evolved on."""

from pathlib import Path

import click
import msgspec

from zswarm import experiment
from zswarm.ot.commands.shared import options, suggestions
from zswarm.ot.display import tables
from zswarm.system.format import plural
from zswarm.system.text import clean

MENU = ("Results", 3)
LABEL = 16  # columns


@click.command("evaluate")
@options.champion_argument
@click.option(
    "--trials",
    type=options.TRIALS,
    default=100,
    show_default=True,
    help="Trials to play.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**63 - 1),
    help="Seed of the trials.  [default: one that evolution did not use]",
)
@click.option(
    "--against",
    type=options.PATH,
    metavar="RUN|CHAMPION.zsc",
    shell_complete=suggestions.runs,
    help="The opponent in a game of several participants.  [default: the champion itself]",
)
@options.set_option_of("problem", "problem.settings.agents=20")
@options.json_option
def command(
    path: Path,
    trials: int,
    seed: int | None,
    against: Path | None,
    overrides: tuple[str, ...],
    as_json: bool,
) -> None:
    """Play a run's champion on held-out seeds.

    Shows how good it is on trials that it was not evolved on: that is what counts. In a game it
    plays another champion, from each side in turn.

    \b
      zswarm-ot evaluate runs/stadium
      zswarm-ot evaluate champion.zsc --trials 1000
      zswarm-ot evaluate runs/minisim --set problem.settings.robots=20
      zswarm-ot evaluate runs/minisim-duel --against runs/minisim-duel-2
    """
    from zswarm.controller import load_controller
    from zswarm.ot.replay import held_out

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
    fitness, metrics = played.fitness_summary(), played.metric_means()
    game = played.score() if played.results.shape[1] > 1 else {}
    if as_json:
        tables.print_json({"trials": trials, **fitness, **game, "metrics": metrics})
        return
    same = played.all_the_same()
    tables.paragraph(
        f"{clean(controller.simulator)}, champion of {clean(controller.run)} (fitness "
        f"{controller.fitness:.6g}), {plural(trials, 'trial' if same else 'held-out trial')}"
    )
    if same:
        tables.paragraph("every trial was the same: nothing in them depends on the seed")
    if game:
        name = "itself" if opponent is None else f"the champion of {clean(opponent.run)}"
        counts = ", ".join(f"{count} {result}" for result, count in game.items())
        tables.line(f"{'against':{LABEL}}{name}: {counts}")
    quartiles = " / ".join(f"{fitness[key]:.6g}" for key in ("q25", "median", "q75"))
    tables.line(f"{'fitness':{LABEL}}mean {fitness['mean']:.6g}, quartiles {quartiles}")
    for name, mean in metrics.items():
        tables.line(f"{name:{LABEL}}mean {mean:.6g}")
