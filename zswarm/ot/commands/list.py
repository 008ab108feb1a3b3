"""``zswarm-ot list``: runs, examples and parts."""

import time
from pathlib import Path

import click

from zswarm import experiment, plugins
from zswarm.errors import ConfigError
from zswarm.ot.commands.options import json_option

RUNS = Path("runs")  # before the first run it is not there


@click.command("list")
@click.argument("folder", type=click.Path(path_type=Path), default=RUNS)
@json_option
def list_(folder: Path, as_json: bool) -> None:
    """Show runs, examples and what experiments are made of.

    The runs below a folder; and the examples, simulators, representations and optimizers that are installed.
    """
    from zswarm.ot import reading, terminal
    from zswarm.protocol.codec import clean

    if folder != RUNS and not folder.is_dir():
        raise ConfigError(f"{clean(str(folder))}: no such folder")
    runs = reading.listed(folder)
    parts = {kind: plugins.names(kind) for kind in ("simulator", "representation", "optimizer")}
    examples = sorted(path.stem for path in experiment.examples_folder().glob("*.toml"))
    if as_json:
        terminal.print_json({"runs": runs, "examples": examples, **{f"{kind}s": names for kind, names in parts.items()}})
        return
    for title, names in (("examples", examples), *((f"{kind}s", names) for kind, names in parts.items())):
        terminal.entry(title, ", ".join(names), label=16)
    if not runs:
        terminal.line(f"{'runs':16}none in {folder}")
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
