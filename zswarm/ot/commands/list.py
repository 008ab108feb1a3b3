"""``zswarm-ot list``: runs, examples and parts."""

import os
import time
from pathlib import Path

import click

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.commands.options import json_option

RUNS = Path("runs")  # before the first run it is not there


@click.command("list")
@click.argument("folder", type=click.Path(path_type=Path), default=RUNS)
@json_option
def list_(folder: Path, as_json: bool) -> None:
    """Show runs, examples and what experiments are made of.

    The runs below a folder; the examples; and the simulators, representations, optimizers and rankings that are installed, each
    with what it is and its settings with their defaults. "zswarm-ot describe NAME" explains one of them.
    """
    os.environ["ZSWARM_PLAIN"] = "1"  # nothing is evaluated
    from zswarm.ot import parts, reading, terminal
    from zswarm.protocol.codec import clean

    if folder != RUNS and not folder.is_dir():
        raise ConfigError(f"{clean(str(folder))}: no such folder")
    runs = reading.listed(folder)
    examples = sorted(path.stem for path in experiment.examples_folder().glob("*.toml"))
    found = parts.installed()
    if as_json:
        names = {f"{kind}s": [part.name for part in found if part.kind == kind] for kind in parts.KINDS}
        about = [parts.as_object(part) for part in found]
        terminal.print_json({"runs": runs, "examples": examples, **names, "parts": about})
        return
    for kind in parts.KINDS:
        terminal.line(f"{kind}s")
        for part in found:
            if part.kind == kind:
                known = "its program says them" if part.unasked else parts.settings_line(part.settings) or "none"
                settings = f"settings: {known}"
                terminal.item(part.name, *((part.error,) if part.error else (part.about, settings)))
    terminal.paragraph("More of one of them: zswarm-ot describe NAME")
    terminal.entry("examples", ", ".join(examples))
    if not runs:
        terminal.entry("runs", f"none in {folder}")
        return
    table = terminal.table("run", "generations", "best", "last at (local time)", "history")
    for row in runs:
        if "error" in row:
            terminal.row(table, row["run"], "", "", "", row["error"])
            continue
        at = time.strftime("%Y-%m-%d %H:%M", time.localtime(row["finished_at"])) if row["finished_at"] else ""
        best = "" if row["best"] is None else f"{row['best']:.6g}"
        history = row["history_hash"][:12] if row["history_hash"] else "not finished"
        terminal.row(table, row["run"], row["generations"], best, at, history)
    terminal.show(table)
