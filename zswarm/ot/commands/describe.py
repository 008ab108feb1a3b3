"""``zswarm-ot describe``: what a simulator, representation, optimizer or ranking is."""

import os
from typing import TYPE_CHECKING

import click

from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import json_option

if TYPE_CHECKING:
    from zswarm.ot.parts import Part

MEANINGS = {
    "portable": "gives the same on every machine, bit for bit",
    "competes": "takes the scores of tournaments, too",
    "relative": "scores compare within a generation only",
}


@click.command()
@click.argument("name", metavar="PART", shell_complete=suggestions.parts)
@json_option
def describe(name: str, as_json: bool) -> None:
    """Explain a part of experiments: its data sheet and its settings.

    A part is a simulator, representation, optimizer or ranking; "zswarm-ot list" names them. Where several have the name,
    each is explained.

    \b
      zswarm-ot describe nnga
      zswarm-ot describe emergency-exit
    """  # noqa: D301  click's mark for text that is not to be wrapped
    os.environ["ZSWARM_PLAIN"] = "1"  # nothing is evaluated
    from zswarm.ot import parts, terminal

    found = parts.find(name)
    if as_json:
        terminal.print_json({"parts": [parts.as_object(part) for part in found]})
        return
    for number, part in enumerate(found):
        if number:
            terminal.line("")
        _show(part)


def _show(part: "Part") -> None:
    from zswarm.ot import parts, terminal

    terminal.paragraph(f"{part.name}, {part.kind}: {part.error or part.about}")
    for paragraph in part.sheet:
        terminal.paragraph(paragraph)
    for what, value in part.facts:
        if isinstance(value, bool):
            terminal.entry(what, f"{'yes' if value else 'no'}: {MEANINGS[what]}" if value else "no", label=14)
        elif isinstance(value, list):
            terminal.entry(what, ", ".join(value) or "no names", label=14)
        else:
            terminal.entry(what, str(value), label=14)
    if part.settings:
        table = terminal.table("setting", "type", "default", "meaning")
        for key in part.settings:
            terminal.row(table, key.name, key.type_text, parts.default(key), key.meaning)
        terminal.show(table)
        if part.kind == "simulator":
            terminal.paragraph(
                "A setting may be a range, from which each trial draws: { from = 5, to = 15 } or { choice = [5, 10] }"
            )
    elif not part.error:
        terminal.entry("settings", "none", label=14)
