"""Find runs below a folder, and summarize each without reading its generations."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from zswarm.controller import HeldOut
from zswarm.errors import ConfigError
from zswarm.ot.record import annotations, control_file, epochs
from zswarm.ot.record.database import UNREADABLE, describe, outage, read_only
from zswarm.ot.record.folder import DATABASE, EXPERIMENT, is_running, no_run
from zswarm.ot.record.reader import Run
from zswarm.system.text import clean

DEPTH = 2  # of folders below one: runs/STUDY/RUN
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


def runs_below(paths: Sequence[Path], left_out: list[str] | None = None) -> list[Run]:
    """Return the runs of folders; each is that of a run, or of several runs such as a study's.

    Args:
        left_out: receives a line for each unreadable run; without it, such a run is an error.

    Returns:
        Runs in the order of the paths, and below each by name, with numbers in natural order; each
        run once.

    Raises:
        ConfigError: a path has no runs, or one of them cannot be read.
    """
    runs: dict[Path, Run] = {}
    for path in paths:
        folders = folders_below(path)
        if not folders:
            files = f"with {EXPERIMENT} and {DATABASE}, or one that holds such folders"
            raise ConfigError(f"{no_run(path)} {files}")
        for folder in folders:
            try:
                runs.setdefault(folder.resolve(), Run(folder))
            except ConfigError as error:
                if left_out is None or folder == path:
                    raise
                left_out.append(f"left out: {error}")
        if left_out and not runs:
            first = left_out[0].removeprefix("left out: ")
            raise ConfigError(f"{clean(str(path))}: no run that can be read; {first}")
    return list(runs.values())


def folders_below(path: Path) -> list[Path]:
    """Return the folders with a record, maybe damaged: the path, or those two levels below it."""

    def natural_order(folder: Path) -> list[list[tuple[bool, int, str]]]:
        return [_natural(part) for part in folder.relative_to(path).parts]

    try:
        if (path / DATABASE).is_file():
            return [path]
        patterns = ["*/" * depth + DATABASE for depth in range(1, DEPTH + 1)]
        files = [
            file for pattern in patterns for file in path.glob(pattern) if file.is_file()
        ]
    except OSError:  # not readable, or the name is too long
        return []
    return sorted({file.parent for file in files}, key=natural_order)


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


def _natural(name: str) -> list[tuple[bool, int, str]]:
    """Return a key that sorts ``seed-2`` before ``seed-10``."""
    return [
        (part.isdecimal(), int(part) if part.isdecimal() else 0, part)
        for part in re.split(r"(\d+)", name)
        if part
    ]
