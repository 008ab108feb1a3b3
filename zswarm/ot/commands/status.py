"""``zswarm-ot status``: show how far runs are."""

import contextlib
from pathlib import Path
from typing import Any

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options, suggestions
from zswarm.ot.display import tables
from zswarm.system.format import duration, per_trial, plural
from zswarm.system.text import clean

MENU = ("Evolve", 4)
FIELDS = {
    "status": "status",
    "generation": "generation",
    "generations": "generations",
    "best": "best_sum",
    "trials": "fitness_trials",
    "eta_s": "eta_s",
    "quiet_s": "quiet_s",
}
FIRST = ("running", "paused", "stopping")


@click.command("status")
@click.argument(
    "folder",
    type=options.PATH,
    default=suggestions.RUNS,
    metavar="[RUN|STUDY|FOLDER]",
    shell_complete=suggestions.runs,
)
@options.json_option
def command(folder: Path, as_json: bool) -> None:
    """Show the progress of runs, the active ones first.

    Shows the runs below a folder ("runs" by default), also those that run detached, in other
    terminals, or on other machines that share the folder: generation, best fitness, and remaining
    time; and how many runs of each study have begun and finished.

    \b
      zswarm-ot status
      zswarm-ot status runs/stadium
    """
    from zswarm.ot.record.folder import folders_below

    # The default does not exist before the first run.
    if folder != suggestions.RUNS and not folder.is_dir():
        raise ConfigError(f"{clean(str(folder))}: no such folder")
    rows = [_row(run) for run in folders_below(folder)]
    rows.sort(key=lambda row: row["status"] not in FIRST)
    studies = _studies(folder, rows)
    if as_json:
        tables.print_json({"runs": rows, "studies": studies})
        return
    if rows:
        _show(rows)
    else:
        tables.line(f"no run in {clean(str(folder))}")
    for study in studies:
        found = f"{study['finished']} finished, {study['begun']} begun"
        tables.paragraph(f"{study['study']} has {plural(study['runs'], 'run')}: {found}.")


def _studies(folder: Path, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Count the runs of the study in a folder, or of the studies below it that can be read."""
    from zswarm.ot.study.study import is_study, load_study

    found = []
    for path in [folder, *sorted(folder.glob("*/"))]:
        with contextlib.suppress(ConfigError, OSError):
            if not is_study(path):
                continue
            name, planned = clean(str(path)), load_study(path).study.runs()
            status = [
                row["status"] for row in rows if Path(row["run"]).parent == Path(name)
            ]
            begun = {"begun": len(status), "finished": status.count("finished")}
            found.append({"study": name, "runs": planned, **begun})
    return found


def _row(folder: Path) -> dict[str, Any]:
    from zswarm.ot.dashboard.tail import RecordTail

    tail = RecordTail(folder)
    tail.look()
    name = clean(str(folder))
    if "error" in tail.state:
        return {"run": name, "status": "unreadable", "error": tail.state["error"]}
    return {"run": name, **{key: tail.state[name] for key, name in FIELDS.items()}}


def _generation(row: dict[str, Any]) -> str:
    """Return how many generations a run has, and of how many unless a limit ended it before."""
    done, most = row["generation"], row["generations"]
    return str(done) if row["status"] == "finished" else f"{done}/{most}"


def _show(rows: list[dict[str, Any]]) -> None:
    table = tables.table("run", "status", ">generation", ">best", ">time left")
    for row in rows:
        if "error" in row:
            tables.row(table, row["run"], row["error"], "", "", "")
            continue
        best, left = row["best"], row["eta_s"]
        quiet = f"no outcome for {duration(row['quiet_s'])}" if row["quiet_s"] else ""
        tables.row(
            table,
            row["run"],
            row["status"],
            _generation(row),
            "" if best is None else per_trial(best, row["trials"]),
            quiet if left is None else duration(left),
        )
    tables.show(table)
    tables.unit(row.get("trials", 1) for row in rows)
