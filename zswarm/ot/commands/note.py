"""``zswarm-ot note``: give runs tags and a note, or show them."""

from pathlib import Path

import click
import msgspec

from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables

MENU = ("Results", 2)


@click.command("note")
@options.paths_argument
@click.option("--tag", "tags", multiple=True, help="Add a tag; may be repeated.")
@click.option("--untag", "untags", multiple=True, help="Remove a tag; may be repeated.")
@click.option("--text", help='Replace the note; "" removes it.')
@options.json_option
def command(
    paths: tuple[Path, ...],
    tags: tuple[str, ...],
    untags: tuple[str, ...],
    text: str | None,
    as_json: bool,
) -> None:
    """Give runs tags and a note, or show them.

    They are kept in the run's folder, in notes.toml, and shown by list and the dashboard. Of a
    study, all runs get them.

    \b
      zswarm-ot note runs/stadium --tag baseline --text "before the new sensor"
      zswarm-ot note runs/study --tag paper --untag draft
      zswarm-ot note runs/stadium
    """
    from zswarm.ot.record import annotations
    from zswarm.ot.record.runs import runs_below

    found = [(run, annotations.load(run.folder)) for run in runs_below(paths)]
    if tags or untags or text is not None:
        missing = set(untags).difference(*(old.tags for _, old in found))
        if missing:
            raise ConfigError(f"--untag {min(missing)}: no run here has this tag")
        changed = [
            annotations.Annotations(
                tags=sorted({*old.tags, *tags}.difference(untags)),
                note=old.note if text is None else text,
            )
            for _, old in found
        ]
        for (run, _), new in zip(found, changed, strict=True):
            annotations.save(run.folder, new)
        found = [(run, annotations.load(run.folder)) for run, _ in found]
    if as_json:
        rows = [{"run": run.shown, **msgspec.to_builtins(new)} for run, new in found]
        tables.print_json({"runs": rows})
        return
    table = tables.table("run", "tags", "note")
    for run, new in found:
        tables.row(table, run.shown, ", ".join(new.tags), new.note.replace("\n", " "))
    tables.show(table)
