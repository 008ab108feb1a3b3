"""``zswarm-ot import``: what FREVO evolved becomes a run's folder."""

from pathlib import Path

import click

from zswarm.ot.commands.options import json_option, out_option


@click.command("import")
@click.argument("path", type=click.Path(path_type=Path), metavar="RESULT.zre")
@out_option
@json_option
def import_(path: Path, out: Path, as_json: bool) -> None:
    """Make a run's folder of a result of FREVO: a population of fully-meshed nets for Emergency Exit."""
    from zswarm.ot import frevo, terminal

    result = frevo.load(path)
    made = frevo.record(result, out)
    fitness = made.champion.fitness
    if as_json:
        terminal.print_json(
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
    terminal.line(result.source)
    for note in result.notes:
        terminal.line(note)
    terminal.line(f"{terminal.plural(len(result.genomes), 'candidate')}, best fitness {fitness:.6g} as FREVO says")
    if made.played == fitness:
        terminal.line("the best was played here: the same fitness")
    elif made.played is not None:
        terminal.line(f"the best was played here: fitness {made.played:.6g}; FREVO had other rooms, or another version")
    terminal.line(f"run     {made.folder}")
