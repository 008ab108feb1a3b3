"""The runs that the dashboard shows, by ids that are no paths: whoever asks names one of those that were found, or nothing."""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from zswarm.errors import ConfigError
from zswarm.ot import control
from zswarm.ot.reading import Run, folders_below, goes_on, in_short
from zswarm.ot.record import DATABASE, EXPERIMENT
from zswarm.protocol.codec import clean

UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
LONGEST = 80  # characters of an id
BETWEEN = "~"  # the names of folders in an id


class _Kept(NamedTuple):
    """What a run's row was made of, so that it is made again only when that has changed."""

    stamp: tuple[Any, ...]
    row: dict[str, Any]


class Shelf:
    """Runs in folders, and below them as deep as ``zswarm-ot list`` looks.

    Args:
        roots: they may not be there yet.
    """

    def __init__(self, roots: Sequence[Path]) -> None:
        self._roots = list(roots)
        self._folders: dict[str, Path] = {}
        self._rows: dict[str, _Kept] = {}

    def folder(self, id_: str) -> Path | None:
        """Of a run; None where there is none of that id."""
        if id_ not in self._folders:
            self.look()
        return self._folders.get(id_)

    def look(self) -> None:
        """Look which runs there are."""
        found: dict[str, Path] = {}
        for root in self._roots:
            inside = root.resolve()
            for folder in folders_below(root):
                if folder.resolve().is_relative_to(inside):  # a link may lead elsewhere
                    found.setdefault(_id(inside, folder), folder)
        self._folders = found
        self._rows = {id_: row for id_, row in self._rows.items() if id_ in found}

    def rows(self) -> list[dict[str, Any]]:
        """What is known of each run; of one that cannot be read, why."""
        self.look()
        return [self._row(id_, folder) for id_, folder in self._folders.items()]

    def _row(self, id_: str, folder: Path) -> dict[str, Any]:
        now, kept = stamp(folder), self._rows.get(id_)
        if kept is None or kept.stamp != now:
            kept = self._rows[id_] = _Kept(now, _known(folder))
        row = kept.row
        return {"id": id_, "name": clean(folder.resolve().name), "study": id_.rpartition(BETWEEN)[0], **row} | (
            {} if "error" in row else {"status": status(folder, finished=bool(row["history_hash"]))}
        )


def status(folder: Path, *, finished: bool) -> str:
    """Of a run, in a word: finished, running, paused or stopped; stopping where that was asked of it."""
    if not goes_on(folder):
        return "finished" if finished else "stopped"
    return {"pause": "paused", "drain": "stopping", "stop": "stopping"}.get(control.asked(folder), "running")


def _known(folder: Path) -> dict[str, Any]:
    row = in_short(folder)
    if "error" in row:
        return {"error": row["error"]}
    try:
        complete = Run(folder).experiment
    except ConfigError as error:
        return {"error": str(error)}
    return {
        "generation": row["generations"],
        "generations": complete.generations,
        "best": row["best"],
        "evaluations": row["candidates"],
        "at": row["finished_at"],
        "history_hash": row["history_hash"],
        "simulator": complete.problem.simulator,
        "representation": complete.representation.kind,
        "optimizer": complete.optimizer.kind,
        "seed": complete.seed,
    }


def _id(root: Path, folder: Path) -> str:
    """The names of the folders on the way, of plain letters; what was lost of others is made up for by a digest."""
    parts = folder.resolve().relative_to(root).parts or (root.name,)
    plain = BETWEEN.join(UNSAFE.sub("_", part) for part in parts)
    if plain == BETWEEN.join(parts) and len(plain) <= LONGEST:
        return plain
    return f"{plain[:LONGEST]}-{hashlib.blake2b(str(folder).encode(errors='replace'), digest_size=4).hexdigest()}"


def stamp(folder: Path) -> tuple[tuple[int, int] | None, ...]:
    """It is another one when the record or the experiment was written to."""
    return tuple(_changed(folder / name) for name in (DATABASE, f"{DATABASE}-wal", EXPERIMENT))


def _changed(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
