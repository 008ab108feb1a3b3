"""The tables and views of a record, and how an older one is brought to them: docs/record.md."""

SCHEMA_VERSION = 4
TABLES = ("meta", "generations", "candidates", "outcomes", "events", "optimizer")
_TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value) WITHOUT ROWID;
CREATE TABLE generations (
    generation INTEGER PRIMARY KEY, finished_at REAL NOT NULL, best REAL, mean REAL, evaluations INTEGER NOT NULL,
    statistics TEXT NOT NULL);
CREATE TABLE candidates (
    generation INTEGER NOT NULL, candidate INTEGER NOT NULL, genome BLOB NOT NULL, fitness REAL,
    measures BLOB, PRIMARY KEY (generation, candidate)) WITHOUT ROWID;
CREATE TABLE outcomes (
    id INTEGER PRIMARY KEY, generation INTEGER NOT NULL, asked BLOB NOT NULL, count INTEGER NOT NULL, trials BLOB NOT NULL,
    fitness BLOB NOT NULL, metrics BLOB NOT NULL, faulted INTEGER NOT NULL, server TEXT NOT NULL, seconds REAL NOT NULL,
    at REAL NOT NULL, doubtful INTEGER NOT NULL DEFAULT 0, round INTEGER NOT NULL DEFAULT 0,
    participants BLOB);
CREATE TABLE events (at REAL NOT NULL, generation INTEGER, event TEXT NOT NULL, server TEXT, text TEXT, count INTEGER);
CREATE TABLE optimizer (id INTEGER PRIMARY KEY CHECK (id = 0), generation INTEGER NOT NULL, state BLOB NOT NULL);
"""
# For whoever knows SQL and none of the blobs. Plain SQLite since 3.31; a CAST gives a column its type.
VIEWS = {
    "servers": """
        SELECT server, CAST(sum(count) AS INTEGER) AS trials, CAST(sum(seconds) AS REAL) AS seconds,
            CAST(min(at) AS REAL) AS first_at, CAST(max(at) AS REAL) AS last_at
        FROM outcomes WHERE server <> '' GROUP BY server""",
    "history": """
        SELECT generation, finished_at, CAST(strftime('%Y-%m-%d %H:%M:%f', finished_at, 'unixepoch') AS TEXT) AS utc,
            CAST(finished_at - lag(finished_at, 1, (SELECT value FROM meta WHERE key = 'created_at'))
                OVER (ORDER BY generation) AS REAL) AS seconds,
            best, mean, CAST(sum(evaluations) OVER (ORDER BY generation) AS INTEGER) AS evaluations
        FROM generations ORDER BY generation""",
    "champions": """
        SELECT generation, finished_at, CAST(strftime('%Y-%m-%d %H:%M:%f', finished_at, 'unixepoch') AS TEXT) AS utc, best,
            CAST((SELECT min(c.candidate) FROM candidates c WHERE c.generation = risen.generation AND c.fitness = best)
                AS INTEGER) AS candidate
        FROM (SELECT *, lag(best) OVER (ORDER BY generation) AS before FROM generations) risen
        WHERE best > coalesce(before, -9e999) OR (best > -9e999 AND EXISTS (SELECT 1 FROM meta WHERE key = 'relative'))
        ORDER BY generation""",
    "timeline": """
        SELECT at, CAST(strftime('%Y-%m-%d %H:%M:%f', at, 'unixepoch') AS TEXT) AS utc,
            CAST(at - (SELECT value FROM meta WHERE key = 'created_at') AS REAL) AS seconds,
            generation, event, server, text, count
        FROM events ORDER BY rowid""",
    "batches": """
        SELECT generation, server, count AS trials, seconds, at,
            CAST(strftime('%Y-%m-%d %H:%M:%f', at, 'unixepoch') AS TEXT) AS utc, faulted, doubtful
        FROM outcomes ORDER BY id""",
    "statistics": """
        SELECT g.generation, CAST(s.key AS TEXT) AS name, CAST(s.value AS REAL) AS value
        FROM generations g, json_each(g.statistics) s ORDER BY g.generation, s.id""",
    "settings": """
        SELECT CAST(replace(replace(replace(substr(s.fullkey, 3), '"', ''), 'optimizer.settings.', 'optimizer.'),
                'representation.settings.', 'representation.') AS TEXT) AS key,
            CAST(s.value AS TEXT) AS value
        FROM meta m, json_tree(m.value) s WHERE m.key = 'experiment' AND s.atom IS NOT NULL ORDER BY s.id""",
}
_VIEWS = tuple(f"CREATE VIEW {name} AS {sql};" for name, sql in VIEWS.items())
CREATE = _TABLES + "".join(_VIEWS)
# From a version to the next, in the transaction that raises the epoch. What a migration may do: docs/record.md.
MIGRATIONS: dict[int, tuple[str, ...]] = {
    1: ("ALTER TABLE outcomes ADD COLUMN doubtful INTEGER NOT NULL DEFAULT 0",),
    2: (*(f"DROP VIEW IF EXISTS {name}" for name in VIEWS), *_VIEWS),
    3: (
        "ALTER TABLE candidates ADD COLUMN measures BLOB",
        "ALTER TABLE outcomes ADD COLUMN round INTEGER NOT NULL DEFAULT 0",
        "ALTER TABLE outcomes ADD COLUMN participants BLOB",
        *(f"DROP VIEW IF EXISTS {name}" for name in VIEWS),
        *_VIEWS,
    ),
}
