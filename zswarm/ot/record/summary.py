"""Summarize runs without reading their generations."""

from pathlib import Path
from typing import Any

import msgspec

from zswarm.champion.held_out import HeldOut
from zswarm.ot.record import annotations, control_file, epochs
from zswarm.ot.record.database import UNREADABLE, describe, outage, read_only
from zswarm.ot.record.folder import DATABASE, EXPERIMENT, folders_below, is_running
from zswarm.system.text import clean

STATUS = {"pause": "paused", "drain": "stopping", "stop": "stopping"}
SUMMARY = """
    SELECT count(*), sum(evaluations), max(finished_at),
        CASE WHEN EXISTS (SELECT 1 FROM meta WHERE key = 'relative'
                OR (key = 'experiment' AND value LIKE '%"seeds": "fresh"%'))
            THEN (SELECT best FROM generations ORDER BY generation DESC LIMIT 1)
            ELSE max(best) END,
        (SELECT value FROM meta WHERE key = 'history_hash'),
        (SELECT value FROM meta WHERE key = 'assessment'),
        (SELECT json_extract(value, '$.problem.trials') FROM meta
            WHERE key = 'experiment' AND json_valid(value)
            AND NOT EXISTS (SELECT 1 FROM meta WHERE key = 'relative'))
    FROM generations"""

SummaryRow = tuple[
    int, int | None, float | None, float | None, str | None, str | None, int | None
]


def list_runs(parent: Path) -> list[dict[str, Any]]:
    """Summarize each run below a folder."""
    return [summary(folder) for folder in folders_below(parent)]


def summary(folder: Path) -> dict[str, Any]:
    """Return the state of a run, or why it cannot be read."""
    shown = clean(str(folder))
    if not (folder / EXPERIMENT).is_file():
        return {"run": shown, "error": f"no {EXPERIMENT} in it"}
    try:
        with read_only(folder / DATABASE) as database:
            row = database.execute(SUMMARY).fetchone()
            texts = [text for (text,) in database.execute(epochs.TEXTS)]
        row = msgspec.convert(row, SummaryRow)
        generations, candidates, at, best, history, held_out, trials = row
        champion = msgspec.json.decode(held_out or "null", type=HeldOut | None)
    except msgspec.ValidationError as error:
        return {"run": shown, "error": f"damaged: its table generations: {error}"}
    except msgspec.DecodeError as error:
        return {"run": shown, "error": f"damaged: its assessment: {error}"}
    except UNREADABLE as error:
        what = "cannot be read" if outage(error, folder) else "damaged"
        return {"run": shown, "error": f"{what}: {clean(describe(error, folder))}"}
    return {
        "run": shown,
        "generations": generations,
        "best": best,
        "champion": None if champion is None else msgspec.structs.asdict(champion),
        "trials": max(1, trials or 1),  # whose sum fitness is; 1 for scores
        "candidates": candidates or 0,
        "finished_at": at,
        "history_hash": clean(history) if history else None,
        "versions": epochs.mark(epochs.decoded(texts), generations),
        **annotations.shown(folder),
    }


def status(folder: Path, *, finished: bool) -> str:
    """Return finished, running, paused, stopping or stopped."""
    if is_running(folder):
        return STATUS.get(control_file.asked(folder), "running")
    return "finished" if finished else "stopped"


def stamp(folder: Path) -> tuple[tuple[int, int] | None, ...]:
    """Return a value that changes when the record, the experiment or the note is written."""

    def changed(path: Path) -> tuple[int, int] | None:
        try:
            found = path.stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size

    files = (DATABASE, f"{DATABASE}-wal", EXPERIMENT, annotations.FILE)
    return tuple(changed(folder / name) for name in files)
