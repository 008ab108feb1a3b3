"""The runs that the dashboard shows. Pages name them by ids, which never are paths."""

import hashlib
import re
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.record.folder import folders_below
from zswarm.ot.record.reader import Run
from zswarm.ot.record.stopping import expected_generations
from zswarm.ot.record.summary import stamp, status, summary
from zswarm.system.format import mean
from zswarm.system.text import clean

UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
LONGEST = 80  # characters of an id
BETWEEN = "~"  # separates names of folders in an id


class _Known(NamedTuple):
    stamp: tuple[Any, ...]
    row: dict[str, Any]
    experiment: Experiment | None  # None: it cannot be read


class RunIndex:
    """Runs in folders, and below them as deep as ``zswarm-ot list`` looks.

    Args:
        roots: the folders, which need not exist yet.
    """

    def __init__(self, roots: Sequence[Path]) -> None:
        self._roots = list(roots)
        self._folders: dict[str, Path] = {}
        self._known: dict[str, _Known] = {}
        self._lock = threading.Lock()  # each tab asks in a thread

    def folder(self, id_: str) -> Path | None:
        """Return the folder of a run, or None."""
        with self._lock:
            if id_ not in self._folders:
                self._update()
            return self._folders.get(id_)

    def experiment(self, id_: str) -> Experiment | None:
        """Return the experiment of a run, or None if there is none that can be read."""
        with self._lock:
            if id_ not in self._folders:
                self._update()
            if id_ not in self._folders:
                return None
            self._row(id_, self._folders[id_])
            return self._known[id_].experiment

    def _update(self) -> None:
        """Find the runs that exist now."""
        found: dict[str, Path] = {}
        for root in self._roots:
            inside = root.resolve()
            for folder in folders_below(root):
                if folder.resolve().is_relative_to(inside):  # a link may lead out of it
                    found.setdefault(_id(inside, folder), folder)
        self._folders = found
        self._known = {id_: known for id_, known in self._known.items() if id_ in found}

    def rows(self) -> list[dict[str, Any]]:
        """Return the state of each run, or why it cannot be read."""
        with self._lock:
            self._update()
            return [self._row(id_, folder) for id_, folder in self._folders.items()]

    def _row(self, id_: str, folder: Path) -> dict[str, Any]:
        now = stamp(folder)
        if id_ not in self._known or self._known[id_].stamp != now:
            self._known[id_] = _Known(now, *_details(folder))
        row = {
            "id": id_,
            "name": clean(folder.resolve().name),
            "study": id_.rpartition(BETWEEN)[0],
            **self._known[id_].row,
        }
        if "error" in row:
            return row
        return {**row, "status": status(folder, finished=bool(row["history_hash"]))}


def _details(folder: Path) -> tuple[dict[str, Any], Experiment | None]:
    """Return what a row shows of the record, and the experiment."""
    row = summary(folder)
    try:
        if "error" in row:
            raise ConfigError(row["error"])
        complete = Run(folder).experiment
    except ConfigError as error:
        return {"error": str(error)}, None
    done, trials = row["generations"], row["trials"]
    details = {
        "generation": done,
        "generations": done
        if row["history_hash"]
        else expected_generations(
            complete, done, row["candidates"], row["candidates"] // max(1, done)
        ),
        "fitness_trials": trials,
        "best": mean(row["best"], trials),
        "held_out": mean((row["champion"] or {"mean": None})["mean"], trials),
        "evaluations": row["candidates"],
        "at": row["finished_at"],
        "history_hash": row["history_hash"],
        "simulator": complete.problem.simulator,
        "representation": complete.representation.kind,
        "optimizer": complete.optimizer.kind,
        "seed": complete.seed,
        "tags": row["tags"],
        "note": row["note"],
    }
    return details, complete


def _id(root: Path, folder: Path) -> str:
    """Return the names of the folders below the root; a digest distinguishes shortened names."""
    parts = folder.resolve().relative_to(root).parts or (root.name,)
    plain = BETWEEN.join(UNSAFE.sub("_", part) for part in parts)
    if plain == BETWEEN.join(parts) and len(plain) <= LONGEST:
        return plain
    digest = hashlib.blake2b(str(folder).encode(errors="replace"), digest_size=4)
    return f"{plain[:LONGEST]}-{digest.hexdigest()}"
