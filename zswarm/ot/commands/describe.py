"""``zswarm-ot describe``: explain a simulator, representation, optimizer or ranking."""

from typing import Any

import click

from zswarm.ot.commands.shared import catalog, options, suggestions
from zswarm.ot.commands.shared.catalog import CatalogEntry
from zswarm.ot.display import tables

MENU = ("Begin", 4)
LABEL = 14  # columns
MEANINGS = {
    "portable": "gives the same on every machine, bit for bit",
    "competes": "also takes the scores of tournaments",
    "relative": "scores compare within a generation only",
    "repeatable": "the same genomes and seed give the same outcome, bit for bit",
}
NOT = {"repeatable": "trials do not repeat, and servers are not compared"}


@click.command("describe")
@click.argument("name", metavar="PART", shell_complete=suggestions.parts)
@options.json_option
def command(name: str, as_json: bool) -> None:
    """Describe a simulator, representation, optimizer or ranking.

    Shows its settings. "zswarm-ot list" names these parts. If several parts have the name, all of
    them are described.

    \b
      zswarm-ot describe nnga
      zswarm-ot describe emergency-exit
    """
    found = catalog.find(name)
    if as_json:
        tables.print_json({"parts": [catalog.as_object(part) for part in found]})
        return
    for number, part in enumerate(found):
        if number:
            tables.line("")
        _show(part)


def _show(part: CatalogEntry) -> None:
    tables.paragraph(f"{part.name}, {part.kind}: {part.error or part.about}")
    for paragraph in part.reference:
        tables.paragraph(paragraph)
    for name, value in part.facts:
        tables.entry(name, _fact(name, value), label=LABEL)
    if part.settings:
        table = tables.table("setting", "type", "default", "meaning")
        for key in part.settings:
            tables.row(table, key.name, key.type_text, catalog.default(key), key.meaning)
        tables.show(table)
        if part.kind == "simulator":
            tables.paragraph(
                "A setting may be a range, from which each trial draws: { from = 5, to = 15 } or "
                "{ choice = [5, 10] }"
            )
    elif not part.error:
        tables.entry("settings", "none", label=LABEL)


def _fact(name: str, value: Any) -> str:
    match value:
        case bool():
            meaning = (MEANINGS if value else NOT).get(name)
            return ("yes" if value else "no") + (f": {meaning}" if meaning else "")
        case list():
            return ", ".join(value) or "no names"
    return str(value)
