"""``zswarm-ot import``: make a run's folder from a result of FREVO."""

from pathlib import Path

import click

from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.system.format import plural

MENU = ("Results", 9)


@click.command("import")
@click.argument("path", type=options.PATH, metavar="RESULT.zre")
@options.out_option
@options.json_option
def command(path: Path, out: Path, as_json: bool) -> None:
    """Make a run's folder from a result of FREVO: fully-meshed nets for Emergency Exit."""
    from zswarm.ot.commands.shared import frevo

    result = frevo.load(path)
    made = frevo.record(result, out)
    fitness = made.champion.fitness
    if as_json:
        tables.print_json(
            {
                "run": str(made.folder),
                "imported_from": result.source,
                "generation": result.generation,
                "candidates": len(result.genomes),
                "best": fitness,
                "played": made.played,
            }
        )
        return
    for line in (result.source, *result.notes):
        tables.line(line)
    count = plural(len(result.genomes), "candidate")
    tables.line(f"{count}, best fitness {fitness:.6g} according to FREVO")
    if made.played == fitness:
        tables.line("the best was played here: the same fitness")
    elif made.played is not None:
        tables.line(
            f"the best was played here: fitness {made.played:.6g}; FREVO used other rooms, or "
            "another version"
        )
    tables.line(f"run     {made.folder}")
