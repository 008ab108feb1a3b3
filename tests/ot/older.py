"""Records as older zswarms left them."""

import sqlite3
from pathlib import Path

SCHEMA_1 = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value) WITHOUT ROWID;
CREATE TABLE generations (
    generation INTEGER PRIMARY KEY, finished_at REAL NOT NULL, best REAL, mean REAL, evaluations INTEGER NOT NULL,
    statistics TEXT NOT NULL);
CREATE TABLE candidates (
    generation INTEGER NOT NULL, candidate INTEGER NOT NULL, genome BLOB NOT NULL, fitness REAL,
    PRIMARY KEY (generation, candidate)) WITHOUT ROWID;
CREATE TABLE outcomes (
    id INTEGER PRIMARY KEY, generation INTEGER NOT NULL, asked BLOB NOT NULL, count INTEGER NOT NULL, trials BLOB NOT NULL,
    fitness BLOB NOT NULL, metrics BLOB NOT NULL, faulted INTEGER NOT NULL, server TEXT NOT NULL, seconds REAL NOT NULL,
    at REAL NOT NULL);
CREATE TABLE events (at REAL NOT NULL, generation INTEGER, event TEXT NOT NULL, server TEXT, text TEXT, count INTEGER);
CREATE TABLE optimizer (id INTEGER PRIMARY KEY CHECK (id = 0), generation INTEGER NOT NULL, state BLOB NOT NULL);
CREATE VIEW servers AS
    SELECT server, sum(count) AS trials, sum(seconds) AS seconds, min(at) AS first_at, max(at) AS last_at
    FROM outcomes WHERE server <> '' GROUP BY server;
"""
SCHEMA_2 = SCHEMA_1.replace("    at REAL NOT NULL);", "    at REAL NOT NULL, doubtful INTEGER NOT NULL DEFAULT 0);")
SCHEMAS = {1: SCHEMA_1, 2: SCHEMA_2, 3: SCHEMA_2}  # 3: no new columns


def as_schema(version: int, folder: Path) -> None:
    """Make of a run's record what a zswarm of an older schema would have recorded."""
    new, old = folder / "run.sqlite", folder / "old.sqlite"
    database = sqlite3.connect(old)
    database.executescript(SCHEMAS[version])
    database.execute("ATTACH ? AS new", (str(new),))
    for table in ("meta", "generations", "candidates", "outcomes", "events", "optimizer"):
        columns = ", ".join(row[1] for row in database.execute(f"PRAGMA main.table_info({table})"))
        database.execute(f"INSERT INTO main.{table} SELECT {columns} FROM new.{table}")  # noqa: S608  our own names
    database.execute("UPDATE main.meta SET value = ? WHERE key = 'schema_version'", (version,))
    database.execute("DELETE FROM main.meta WHERE key = 'metrics'")
    database.commit()
    database.execute("DETACH new")
    database.execute("PRAGMA journal_mode = WAL")
    database.close()
    new.unlink()
    for side in ("-wal", "-shm"):
        (folder / f"run.sqlite{side}").unlink(missing_ok=True)
    old.rename(new)
