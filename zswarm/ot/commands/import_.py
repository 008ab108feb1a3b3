"""``zswarm-ot import``: make a run's folder from a file of FREVO or ARGoS."""

from pathlib import Path

import click

from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.system.format import per_trial, plural

MENU = ("Results", 9)


@click.command("import")
@click.argument("path", type=options.PATH, metavar="FILE")
@options.out_option
@options.set_option_of(
    "experiment around a controller of ARGoS", "problem.settings.mission=foraging"
)
@options.json_option
def command(path: Path, out: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Import a FREVO result or an ARGoS controller as a run.

    FREVO: a file .zre with fully-meshed nets for Emergency Exit. ARGoS: an e-puck's controller as
    ARGoS3-NEAT's genome, also EvoStick's, or AutoMoDe-Chocolate's machine.

    \b
      zswarm-ot import "Emergency Exit_g199 (0.46).zre"
      zswarm-ot import gen_last_1_champ --set problem.settings.mission=foraging
    """
    from zswarm.ot.importing import by_content, imported

    result = by_content.load(path, overrides)
    made = imported.record(result, out)
    fitness, shown = made.champion.fitness, made.champion.in_search()
    if as_json:
        tables.print_json(
            {
                "run": str(made.folder),
                "imported_from": result.source,
                "generation": result.generation,
                "candidates": len(result.genomes),
                "best": fitness,
                "played": made.played,
                "trials": made.champion.trials,
            }
        )
        return
    for line in (result.source, *result.notes):
        tables.line(line)
    if result.experiment.problem.simulator == "epuck":
        settings = result.experiment.problem.settings
        tables.line(
            f"{result.experiment.representation.kind}; {settings['mission']}: fitness {shown} here"
        )
    else:
        count = plural(len(result.genomes), "candidate")
        tables.line(f"{count}, best fitness {shown} according to FREVO")
    if made.played == fitness:
        tables.line("the best was played here: the same fitness")
    elif made.played is not None:
        played = per_trial(made.played, made.champion.trials)
        tables.line(
            f"the best was played here: fitness {played}; FREVO used other rooms, or "
            "another version"
        )
    tables.line(f"run     {made.folder}")
