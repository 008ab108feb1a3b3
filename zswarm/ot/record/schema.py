"""The tables and views of a record; docs/record.md describes them."""

import contextlib
import functools
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zswarm.errors import ConfigError
from zswarm.system.text import clean
from zswarm.system.version import VERSION

SCHEMA_VERSION = 6
ASSESSMENT = 1_000_000_000  # in place of a generation, after the last that a run can have
OF_THE_END = (
    "history_hash",
    "stopped",
    "assessing",
    "assessment",
    "assessment_hash",
    "track",
)  # keys of meta that come with it
TABLES = ("meta", "generations", "candidates", "outcomes", "events", "optimizer")
_TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value) WITHOUT ROWID;
CREATE TABLE generations (
    generation INTEGER PRIMARY KEY, finished_at REAL NOT NULL, best REAL, mean REAL,
    evaluations INTEGER NOT NULL, statistics TEXT NOT NULL, history BLOB NOT NULL,
    outcomes INTEGER NOT NULL, digest INTEGER NOT NULL);
CREATE TABLE candidates (
    generation INTEGER NOT NULL, candidate INTEGER NOT NULL, genome BLOB, fitness REAL,
    measures BLOB, digest BLOB NOT NULL, PRIMARY KEY (generation, candidate)) WITHOUT ROWID;
CREATE TABLE outcomes (
    id INTEGER PRIMARY KEY, generation INTEGER NOT NULL, asked BLOB NOT NULL,
    count INTEGER NOT NULL, trials BLOB NOT NULL, fitness BLOB NOT NULL, metrics BLOB NOT NULL,
    faulted INTEGER NOT NULL, server TEXT NOT NULL, seconds REAL NOT NULL, at REAL NOT NULL,
    doubtful INTEGER NOT NULL DEFAULT 0, round INTEGER NOT NULL DEFAULT 0, participants BLOB,
    digest INTEGER NOT NULL);
CREATE TABLE events (
    at REAL NOT NULL, generation INTEGER, event TEXT NOT NULL, server TEXT, text TEXT,
    count INTEGER, machine TEXT, digest INTEGER NOT NULL);
CREATE TABLE optimizer (
    part INTEGER NOT NULL, piece INTEGER NOT NULL, generation INTEGER NOT NULL, state BLOB NOT NULL,
    digest INTEGER NOT NULL, PRIMARY KEY (generation, part, piece));
"""
# Views show the record in plain SQL, without blobs; SQLite 3.31 suffices. A CAST types a column.
_UTC = "CAST(strftime('%Y-%m-%d %H:%M:%f', {}, 'unixepoch') AS TEXT) AS utc"
_CREATED = "(SELECT value FROM meta WHERE key = 'created_at')"
VIEWS = {
    "servers": """
        SELECT server, CAST(sum(count) AS INTEGER) AS trials, CAST(sum(seconds) AS REAL) AS seconds,
            CAST(min(at) AS REAL) AS first_at, CAST(max(at) AS REAL) AS last_at
        FROM outcomes WHERE server <> '' GROUP BY server""",
    "history": f"""
        SELECT generation, finished_at, {_UTC.format("finished_at")},
            CAST(finished_at - lag(finished_at, 1, {_CREATED})
                OVER (ORDER BY generation) AS REAL) AS seconds,
            best, mean,
            CAST(sum(evaluations) OVER (ORDER BY generation) AS INTEGER) AS evaluations
        FROM generations ORDER BY generation""",  # noqa: S608
    "champions": f"""
        SELECT generation, finished_at, {_UTC.format("finished_at")}, best,
            CAST((SELECT min(c.candidate) FROM candidates c
                WHERE c.generation = risen.generation AND c.fitness = best) AS INTEGER) AS candidate
        FROM (SELECT *, lag(best) OVER (ORDER BY generation) AS before FROM generations) risen
        WHERE best > coalesce(before, -9e999)
            OR (best > -9e999 AND EXISTS (SELECT 1 FROM meta WHERE key = 'relative'))
        ORDER BY generation""",  # noqa: S608
    "timeline": f"""
        SELECT at, {_UTC.format("at")}, CAST(at - {_CREATED} AS REAL) AS seconds,
            generation, event, server, text, count
        FROM events ORDER BY rowid""",  # noqa: S608
    "batches": f"""
        SELECT generation, server, count AS trials, seconds, at, {_UTC.format("at")},
            faulted, doubtful
        FROM outcomes ORDER BY id""",  # noqa: S608
    "statistics": """
        SELECT g.generation, CAST(s.key AS TEXT) AS name, CAST(s.value AS REAL) AS value
        FROM generations g, json_each(g.statistics) s ORDER BY g.generation, s.id""",
    "settings": """
        SELECT CAST(replace(replace(replace(substr(s.fullkey, 3), '"', ''),
                'optimizer.settings.', 'optimizer.'),
                'representation.settings.', 'representation.') AS TEXT) AS key,
            CAST(s.value AS TEXT) AS value
        FROM meta m, json_tree(m.value) s
        WHERE m.key = 'experiment' AND s.atom IS NOT NULL ORDER BY s.id""",
}
CREATE = _TABLES + "".join(f"CREATE VIEW {name} AS {sql};" for name, sql in VIEWS.items())


@functools.cache
def definitions() -> dict[str, str]:
    """Return the SQL of each table and view, as a database has it."""
    with contextlib.closing(sqlite3.connect(":memory:")) as database:
        database.executescript(CREATE)
        sql = "SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"
        return dict(database.execute(sql).fetchall())


def check_version(meta: Mapping[str, Any], path: Path) -> None:
    """Raise ConfigError unless the record has the schema of this zswarm."""
    found = meta.get("schema_version")
    if found == SCHEMA_VERSION:
        return
    where = clean(str(path))
    if not isinstance(found, int) or found < 1:
        raise ConfigError(
            f"{where}: damaged: expected a schema version in its table meta"
        )
    raise ConfigError(
        f"{where}: has schema {found}, of zswarm {clean(str(meta.get('zswarm')))}; this zswarm "
        f"{VERSION} reads schema {SCHEMA_VERSION}: use the zswarm that made the record"
    )
