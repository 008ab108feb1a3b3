"""``zswarm-ot list``: list runs, examples and parts."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import catalog, options, suggestions
from zswarm.ot.commands.shared.catalog import CatalogEntry
from zswarm.ot.display import tables
from zswarm.system.text import clean

MENU = ("Results", 1)


@click.command("list")
@click.argument("folder", type=options.PATH, default=suggestions.RUNS)
@click.option(
    "--tag", "tags", multiple=True, help="Only runs with this tag; may be repeated."
)
@options.json_option
def command(folder: Path, tags: tuple[str, ...], as_json: bool) -> None:
    """Show runs, examples and the parts of experiments.

    Lists the runs below a folder, the examples, and the installed simulators, representations,
    optimizers and rankings with their settings and defaults. "zswarm-ot describe NAME" explains
    one of them.
    """
    from zswarm.ot.record.run_index import list_runs

    # The default does not exist before the first run.
    if folder != suggestions.RUNS and not folder.is_dir():
        raise ConfigError(f"{clean(str(folder))}: no such folder")
    runs = [row for row in list_runs(folder) if {*tags} <= {*row.get("tags", ())}]
    examples = sorted(path.stem for path in experiment.examples_folder().glob("*.toml"))
    found = catalog.installed()
    if as_json:
        names = {
            f"{kind}s": [part.name for part in found if part.kind == kind]
            for kind in catalog.KINDS
        }
        about = [catalog.as_object(part) for part in found]
        tables.print_json({"runs": runs, "examples": examples, **names, "parts": about})
        return
    _show_parts(found)
    tables.entry("examples", ", ".join(examples))
    if runs:
        _show_runs(runs)
    else:
        tables.entry("runs", f"none in {folder}{' with this tag' if tags else ''}")


def _show_parts(found: Sequence[CatalogEntry]) -> None:
    for number, part in enumerate(found):
        if not number or part.kind != found[number - 1].kind:
            tables.line(f"{part.kind}s")
        if part.error:
            tables.item(part.name, part.error)
            continue
        settings = "its program lists them"
        if not part.unstarted:
            settings = catalog.settings_line(part.settings) or "none"
        tables.item(part.name, part.about, f"settings: {settings}")
    tables.paragraph("More about one of them: zswarm-ot describe NAME")


def _show_runs(runs: list[dict[str, Any]]) -> None:
    annotated = any(row.get("tags") or row.get("note") for row in runs)
    table = tables.table(
        "run",
        ">generations",
        ">in search",
        ">held-out",
        "last at (local time)",
        "history",
        *(["tags and note"] if annotated else []),
    )
    for row in runs:
        if "error" in row:
            blank = [""] if annotated else []
            tables.row(table, row["run"], "", "", "", "", row["error"], *blank)
            continue
        at = row["finished_at"]
        at = time.strftime("%Y-%m-%d %H:%M", time.localtime(at)) if at else ""
        champion = row["champion"] or {"mean": None}
        best, held_out = (
            "" if value is None else f"{value:.6g}"
            for value in (row["best"], champion["mean"])
        )
        history = row["history_hash"][:12] if row["history_hash"] else "not finished"
        cells = [row["run"], row["generations"], best, held_out, at, history]
        if annotated:
            words = filter(None, [", ".join(row["tags"]), row["note"].partition("\n")[0]])
            cells.append(": ".join(words))
        tables.row(table, *cells)
    tables.show(table)
    for row in runs:
        if row.get("versions"):
            tables.paragraph(f"{row['run']} was {row['versions']}.")
