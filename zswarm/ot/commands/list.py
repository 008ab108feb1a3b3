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
from zswarm.plugins import registry
from zswarm.system.format import per_trial
from zswarm.system.text import clean

MENU = ("Results", 1)
LABEL = 17  # columns


@click.command("list")
@click.argument("folder", type=options.PATH, default=suggestions.RUNS)
@click.option(
    "--tag", "tags", multiple=True, help="Only runs with this tag; may be repeated."
)
@options.json_option
def command(folder: Path, tags: tuple[str, ...], as_json: bool) -> None:
    """Show runs, examples and the parts of experiments.

    Lists the runs below a folder, and the names of the examples and of all simulators,
    representations, optimizers and rankings; plug-ins with their settings and defaults.
    "zswarm-ot describe NAME" explains a part, "zswarm-ot check NAME" an example.
    """
    from zswarm.ot.record.summary import list_runs

    # The default does not exist before the first run.
    if folder != suggestions.RUNS and not folder.is_dir():
        raise ConfigError(f"{clean(str(folder))}: no such folder")
    runs = [row for row in list_runs(folder) if {*tags} <= {*row.get("tags", ())}]
    examples = sorted(path.stem for path in experiment.examples_folder().glob("*.toml"))
    if as_json:
        _print_json(runs, examples)
        return
    for kind in catalog.KINDS:
        tables.entry(f"{kind}s", ", ".join(registry.BUNDLED[kind]), label=LABEL)
    _show_plugins(catalog.plugged())
    tables.entry("examples", ", ".join(examples), label=LABEL)
    tables.paragraph(
        "More about a part: zswarm-ot describe NAME; about an example: zswarm-ot check NAME"
    )
    if runs:
        _show_runs(runs)
    else:
        text = f"none in {folder}{' with this tag' if tags else ''}"
        tables.entry("runs", text, label=LABEL)


def _print_json(runs: list[dict[str, Any]], examples: list[str]) -> None:
    found = catalog.installed()
    names = {
        f"{kind}s": [part.name for part in found if part.kind == kind]
        for kind in catalog.KINDS
    }
    about = [catalog.as_object(part) for part in found]
    tables.print_json({"runs": runs, "examples": examples, **names, "parts": about})


def _show_plugins(found: Sequence[CatalogEntry]) -> None:
    if found:
        tables.line("plug-ins")
    for part in found:
        name = f"{part.name} ({part.kind})"
        if part.error:
            tables.item(name, part.error)
            continue
        settings = "its program lists them"
        if not part.unstarted:
            settings = catalog.settings_line(part.settings) or "none"
        tables.item(name, part.about, f"settings: {settings}")


def _cells(row: dict[str, Any]) -> list[str]:
    at = row["finished_at"]
    at = time.strftime("%Y-%m-%d %H:%M", time.localtime(at)) if at else ""
    champion = row["champion"] or {"mean": None}
    best, held_out = (
        "" if value is None else per_trial(value, row["trials"])
        for value in (row["best"], champion["mean"])
    )
    history = row["history_hash"][:12] if row["history_hash"] else "not finished"
    return [row["run"], row["generations"], best, held_out, at, history]


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
        cells = _cells(row)
        if annotated:
            words = filter(None, [", ".join(row["tags"]), row["note"].partition("\n")[0]])
            cells.append(": ".join(words))
        tables.row(table, *cells)
    tables.show(table)
    tables.unit(row.get("trials", 1) for row in runs)
    for row in runs:
        if row.get("versions"):
            tables.paragraph(f"{row['run']} was {row['versions']}.")
