"""Damage a record at random: its bytes, its ends, or single values through SQL."""

import contextlib
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from random import Random

FILES = ("run.sqlite", "run.sqlite-wal")
COLUMNS = {
    "meta": ["value", "key"],
    "generations": ["best", "mean", "evaluations", "statistics", "history", "outcomes"],
    "candidates": ["genome", "fitness", "measures", "digest"],
    "outcomes": ["fitness", "metrics", "trials", "asked", "server", "doubtful", "digest"],
    "events": ["event", "server", "text", "count", "machine", "generation", "digest"],
    "optimizer": ["state", "generation", "digest"],
}
KEYS = {
    "meta": "key",
    "generations": "generation",
    "candidates": "generation, candidate",
    "outcomes": "id",
    "events": "rowid",
    "optimizer": "part, piece",
}


def damage(folder: Path, random: Random) -> str:
    """Damage a record, and return how."""
    return random.choice((flip, flip, overwrite, cut, alter, alter, alter, delete, swap))(
        folder, random
    )


def copied(run: Path, to: Path) -> Path:
    """Return a copy of a run's folder."""
    shutil.rmtree(to, ignore_errors=True)
    return Path(shutil.copytree(run, to))


def flip(folder: Path, random: Random) -> str:
    """Flip some bits."""
    path, at = _place(folder, random)
    body = bytearray(path.read_bytes())
    for place in [
        at,
        *(random.randrange(len(body)) for _ in range(random.choice((0, 3)))),
    ]:
        body[place] ^= 1 << random.randrange(8)
    path.write_bytes(body)
    return f"bits of {path.name} from {at}"


def overwrite(folder: Path, random: Random) -> str:
    """Overwrite some bytes, or a page."""
    path, at = _place(folder, random)
    body = bytearray(path.read_bytes())
    size = random.choice((1, 8, 100, 4096))
    body[at : at + size] = random.choice((bytes(size), random.randbytes(size)))
    path.write_bytes(body)
    return f"{size} bytes of {path.name} from {at}"


def cut(folder: Path, random: Random) -> str:
    """Drop the end of a file."""
    path, at = _place(folder, random)
    path.write_bytes(path.read_bytes()[:at])
    return f"the end of {path.name} from {at}"


def alter(folder: Path, random: Random) -> str:
    """Change a value: a number, a bit of a blob or a character."""
    table = random.choice(list(COLUMNS))
    column = random.choice(COLUMNS[table])

    def edit(database: sqlite3.Connection) -> str:
        sql = f"SELECT {KEYS[table]}, {column} FROM {table}"  # noqa: S608
        rows = database.execute(sql).fetchall()
        if not rows:
            return "nothing"
        *key, value = random.choice(rows)
        names = KEYS[table].split(", ")
        where = " AND ".join(f"{name} = ?" for name in names)
        database.execute(
            f"UPDATE OR IGNORE {table} SET {column} = ? WHERE {where}",  # noqa: S608
            (_altered(value, random), *key),
        )
        return f"{column} of {table} {key}"

    return _edited(folder, edit)


def delete(folder: Path, random: Random) -> str:
    """Delete a row."""
    table = random.choice(list(COLUMNS))

    def edit(database: sqlite3.Connection) -> str:
        sql = f"SELECT {KEYS[table]} FROM {table}"  # noqa: S608
        rows = database.execute(sql).fetchall()
        if not rows:
            return "nothing"
        key, names = random.choice(rows), KEYS[table].split(", ")
        where = " AND ".join(f"{name} = ?" for name in names)
        database.execute(f"DELETE FROM {table} WHERE {where}", key)  # noqa: S608
        return f"{table} {key} is gone"

    return _edited(folder, edit)


def swap(folder: Path, random: Random) -> str:
    """Swap what two rows hold."""
    table = random.choice(["candidates", "outcomes", "generations"])
    column = random.choice(COLUMNS[table])

    def edit(database: sqlite3.Connection) -> str:
        sql = f"SELECT {KEYS[table]}, {column} FROM {table}"  # noqa: S608
        rows = database.execute(sql).fetchall()
        if len(rows) < 2:
            return "nothing"
        (*one, first), (*other, second) = random.sample(rows, 2)
        where = " AND ".join(f"{name} = ?" for name in KEYS[table].split(", "))
        for key, value in ((one, second), (other, first)):
            database.execute(
                f"UPDATE {table} SET {column} = ? WHERE {where}",  # noqa: S608
                (value, *key),
            )
        return f"{column} of {table} {one} and {other}"

    return _edited(folder, edit)


def _place(folder: Path, random: Random) -> tuple[Path, int]:
    """Return a file, mostly the database, and a place in it."""
    files = [folder / name for name in FILES if (folder / name).is_file()]
    files = [file for file in files if file.stat().st_size]
    path = random.choice(files)
    return path, random.randrange(path.stat().st_size)


def _edited(folder: Path, edit: Callable[[sqlite3.Connection], str]) -> str:
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as database, database:
        return edit(database)


def _altered(value: object, random: Random) -> object:
    if isinstance(value, bytes) and value:
        body = bytearray(value)
        body[random.randrange(len(body))] ^= 1 << random.randrange(8)
        return bytes(body)
    if isinstance(value, str) and value:
        at = random.randrange(len(value))
        return value[:at] + chr(ord(value[at]) ^ 1) + value[at + 1 :]
    if isinstance(value, float):
        return random.choice((value + 1.0, -value - 0.5, value * 1.0000001 + 1e-12))
    if isinstance(value, int):
        return random.choice((value + 1, value - 1, -value - 2))
    return random.choice((0, 1.5, b"x", "x"))
