"""The runs below a folder, read without disturbing them."""

import contextlib
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from zswarm.ot.database import in_words, passing
from zswarm.ot.record import DATABASE


def runs(parent: Path) -> list[dict[str, Any]]:
    """What is known of each run; of one that cannot be read, why."""
    found: list[dict[str, Any]] = []
    for path in sorted(parent.glob(f"*/{DATABASE}")):
        try:
            with _open_to_read(path) as database:
                row = database.execute(
                    "SELECT count(*), max(best), sum(evaluations), max(finished_at) FROM generations"
                ).fetchone()
                status = database.execute("SELECT value FROM meta WHERE key = 'history_hash'").fetchone()
        except (sqlite3.DatabaseError, OSError) as error:
            what = "cannot be read" if passing(error, path.parent) else "damaged"
            found.append({"run": str(path.parent), "error": f"{what}: {in_words(error, path.parent)}"})
            continue
        found.append(
            {
                "run": str(path.parent),
                "generations": row[0],
                "best": row[1],
                "candidates": row[2] or 0,
                "finished_at": row[3],
                "history_hash": status[0] if status else None,
            }
        )
    return found


@contextlib.contextmanager
def _open_to_read(path: Path) -> Iterator[sqlite3.Connection]:
    """Also where nothing may be written, which SQLite does at the side of a database with a write-ahead log."""
    with contextlib.ExitStack() as stack:

        def opened(at: Path, how: str) -> sqlite3.Connection:
            database = sqlite3.connect(f"{at.resolve().as_uri()}?{how}", uri=True)
            stack.callback(database.close)
            database.execute("SELECT count(*) FROM sqlite_master")
            return database

        try:
            database = opened(path, "mode=ro")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY):
                raise
            log = path.with_name(f"{DATABASE}-wal")
            if log.is_file() and log.stat().st_size:
                copy = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="zswarm-")))
                for file in (path, log):
                    shutil.copyfile(file, copy / file.name)
                database = opened(copy / DATABASE, "mode=rw")
            else:
                database = opened(path, "immutable=1")
        yield database
