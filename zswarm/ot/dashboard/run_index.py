"""The runs that the dashboard shows. Pages name them by ids, which never are paths."""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from zswarm.errors import ConfigError
from zswarm.ot.record.reader import Run
from zswarm.ot.record.run_index import folders_below, stamp, status, summary
from zswarm.system.text import clean

UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
LONGEST = 80  # characters of an id
BETWEEN = "~"  # separates names of folders in an id


class RunIndex:
    """Runs in folders, and below them as deep as ``zswarm-ot list`` looks.

    Args:
        roots: the folders, which need not exist yet.
    """

    def __init__(self, roots: Sequence[Path]) -> None:
        self._roots = list(roots)
        self._folders: dict[str, Path] = {}
        # With their stamps.
        self._rows: dict[str, tuple[tuple[Any, ...], dict[str, Any]]] = {}

    def folder(self, id_: str) -> Path | None:
        """Return the folder of a run, or None."""
        if id_ not in self._folders:
            self.update()
        return self._folders.get(id_)

    def update(self) -> None:
        """Find the runs that exist now."""
        found: dict[str, Path] = {}
        for root in self._roots:
            inside = root.resolve()
            for folder in folders_below(root):
                if folder.resolve().is_relative_to(inside):  # a link may lead out of it
                    found.setdefault(_id(inside, folder), folder)
        self._folders = found
        self._rows = {id_: row for id_, row in self._rows.items() if id_ in found}

    def rows(self) -> list[dict[str, Any]]:
        """Return the state of each run, or why it cannot be read."""
        self.update()
        return [self._row(id_, folder) for id_, folder in self._folders.items()]

    def _row(self, id_: str, folder: Path) -> dict[str, Any]:
        now = stamp(folder)
        if id_ not in self._rows or self._rows[id_][0] != now:
            self._rows[id_] = now, _details(folder)
        row = {
            "id": id_,
            "name": clean(folder.resolve().name),
            "study": id_.rpartition(BETWEEN)[0],
            **self._rows[id_][1],
        }
        if "error" in row:
            return row
        return {**row, "status": status(folder, finished=bool(row["history_hash"]))}


def _details(folder: Path) -> dict[str, Any]:
    row = summary(folder)
    try:
        if "error" in row:
            raise ConfigError(row["error"])
        complete = Run(folder).experiment
    except ConfigError as error:
        return {"error": str(error)}
    return {
        "generation": row["generations"],
        "generations": complete.generations,
        "best": row["best"],
        "held_out": (row["champion"] or {"mean": None})["mean"],
        "evaluations": row["candidates"],
        "at": row["finished_at"],
        "history_hash": row["history_hash"],
        "simulator": complete.problem.simulator,
        "representation": complete.representation.kind,
        "optimizer": complete.optimizer.kind,
        "seed": complete.seed,
    }


def _id(root: Path, folder: Path) -> str:
    """Return the names of the folders below the root; a digest distinguishes shortened names."""
    parts = folder.resolve().relative_to(root).parts or (root.name,)
    plain = BETWEEN.join(UNSAFE.sub("_", part) for part in parts)
    if plain == BETWEEN.join(parts) and len(plain) <= LONGEST:
        return plain
    digest = hashlib.blake2b(str(folder).encode(errors="replace"), digest_size=4)
    return f"{plain[:LONGEST]}-{digest.hexdigest()}"
