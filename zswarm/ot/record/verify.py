"""Compare everything in a record with its digests."""

import contextlib
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from zswarm.errors import ConfigError
from zswarm.ot.record.database import outage
from zswarm.ot.record.digests import (
    CANDIDATE,
    EVENT,
    GENERATION,
    OUTCOMES,
    Damage,
    check_candidates,
    check_event,
    check_generation,
    check_meta,
    check_outcomes,
    of_row,
    total,
)
from zswarm.ot.record.folder import DATABASE, EXPERIMENT
from zswarm.ot.record.history_hash import START
from zswarm.ot.record.schema import ASSESSMENT, check_version, definitions
from zswarm.system.text import clean

STATE = "part, piece, generation, state, digest"


@contextlib.contextmanager
def in_words(folder: Path) -> Iterator[None]:
    """Raise ConfigError for what is damaged, with the way back to the last good generation.

    An error of the disk that may pass is raised as it is.
    """
    path = clean(str(folder / DATABASE))
    try:
        yield
    except Damage as damage:
        if damage.generation is None:
            again = (
                f"the experiment can be run again from {clean(str(folder / EXPERIMENT))}"
            )
        else:
            command = (
                f"zswarm-ot resume {clean(str(folder))} --from {damage.generation + 1}"
            )
            again = f"{command} evaluates again from there"
        raise ConfigError(f"{path}: damaged: {clean(str(damage))}; {again}") from None
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        if outage(error, folder):
            raise
        raise ConfigError(
            f"{path}: damaged: {clean(str(error))}; the experiment can be run again from "
            f"{clean(str(folder / EXPERIMENT))}"
        ) from None


def read_meta(connection: sqlite3.Connection, path: Path) -> dict[str, Any]:
    """Return the table ``meta``, checked.

    Raises:
        ConfigError: it is of another schema.
        Damage: it is damaged.
    """
    meta = dict(connection.execute("SELECT key, value FROM meta").fetchall())
    if "digests" not in meta:
        check_version(meta, path)
    check_meta(meta)
    check_version(meta, path)
    return meta


def check_record(connection: sqlite3.Connection) -> None:
    """Check all that the history depends on, except for ``meta``.

    Raises:
        Damage: something is not what was written.
        sqlite3.DatabaseError: the file is damaged, or cannot be read now.
    """
    expected, before = [], START
    for number, (*row, written) in enumerate(generations(connection)):
        check_generation(number, row, written)
        check_candidates(number, before, row[6], candidates(connection, number))
        before = row[6]
        expected.append(row[7])
    count = len(expected)
    found, damaged = [0] * (count + 1), ""
    for *row, doubtful, written in outcomes(connection):
        value = check_outcomes(row, doubtful, written)
        if value is not None and row[1] == ASSESSMENT:
            continue
        if value is None or not 0 <= row[1] <= count:
            damaged = f"outcomes {row[0]} are not what was written"
        else:
            found[row[1]] += value
    for number, written in enumerate(expected):
        if total([found[number]]) != written:
            raise Damage(damaged or "outcomes of its trials are missing", number)
    if damaged:
        raise Damage(damaged, count)
    _check_state(connection, count)
    for _ in whole_events(connection):
        pass
    state = str(connection.execute("PRAGMA quick_check").fetchone()[0])
    if state != "ok":
        first = state.removeprefix("*** in database main ***\n").partition("\n")[0]
        raise Damage(first, count)
    written = dict(connection.execute("SELECT name, sql FROM sqlite_master").fetchall())
    if any(written.get(name) != sql for name, sql in definitions().items()):
        raise Damage("the definitions of its tables are not what was written", count)


def check_end(connection: sqlite3.Connection) -> None:
    """Raise Damage unless the last generation is the one that the run or its state ended with."""
    sql = "SELECT generation, history FROM generations ORDER BY generation DESC LIMIT 1"
    last, history = connection.execute(sql).fetchone() or (-1, START)
    sql = "SELECT value FROM meta WHERE key = 'history_hash'"
    recorded = connection.execute(sql).fetchone()
    state = connection.execute("SELECT max(generation) FROM optimizer").fetchone()[0]
    if (recorded and recorded[0] != history.hex()) or state not in (None, last):
        raise Damage("its row in table generations is missing", last + 1)


def whole_generations(connection: sqlite3.Connection) -> list[tuple[Any, ...]]:
    """Return number, time, best, mean, evaluations and statistics of each generation.

    Raises:
        Damage: one is not what was written, or the last ones are missing.
    """
    connection.execute("BEGIN")  # the run may go on
    rows = []
    for number, (*row, written) in enumerate(generations(connection)):
        check_generation(number, row, written)
        rows.append(tuple(row[:6]))
    check_end(connection)
    return rows


def whole_candidates(
    connection: sqlite3.Connection, generation: int
) -> list[tuple[Any, ...]]:
    """Return the columns ``CANDIDATE`` of a generation; none if it is not finished.

    Raises:
        Damage: they are not what was written.
    """
    after = _generation(connection, generation)
    if after is None:
        return []
    before = _generation(connection, generation - 1) if generation else None
    rows = list(candidates(connection, generation))
    check_candidates(generation, before[6] if before else START, after[6], rows)
    return rows


def whole_outcomes(
    connection: sqlite3.Connection, generation: int
) -> list[tuple[Any, ...]]:
    """Return the columns ``OUTCOMES`` of a generation.

    Raises:
        Damage: they are not what was written; of an unfinished generation some may be missing.
    """
    connection.execute("BEGIN")
    ended = _generation(connection, generation)
    sql = f"SELECT {OUTCOMES}, doubtful, digest FROM outcomes WHERE generation = ? ORDER BY id"  # noqa: S608  ours
    rows, found = [], []
    for *row, doubtful, written in _read(
        connection, sql, lambda _: generation, generation, generation
    ):
        value = check_outcomes(row, doubtful, written)
        if value is None:
            raise Damage(f"outcomes {row[0]} are not what was written", generation)
        rows.append(tuple(row))
        found.append(value)
    if ended is not None and total(found) != ended[7]:
        raise Damage("outcomes of its trials are missing", generation)
    return rows


def whole_events(connection: sqlite3.Connection) -> Iterator[tuple[Any, ...]]:
    """Yield the columns ``EVENT`` of all events, in order.

    Raises:
        Damage: one is not what was written, or missing between others.
    """
    (count,) = connection.execute("SELECT count(*) FROM generations").fetchone()
    sql = f"SELECT {EVENT}, digest FROM events ORDER BY rowid"  # noqa: S608  ours
    rows = _read(connection, sql, lambda _: count, count)
    for number, (*row, written) in enumerate(rows, 1):
        check_event(number, row, written, count)
        yield tuple(row)


def _generation(connection: sqlite3.Connection, number: int) -> tuple[Any, ...] | None:
    """Return the columns ``GENERATION`` of a finished generation."""
    sql = f"SELECT {GENERATION}, digest FROM generations WHERE generation = ?"  # noqa: S608  ours
    for *row, written in _read(connection, sql, lambda _: number, number, number):
        check_generation(number, row, written)
        return tuple(row)
    return None


def candidates(connection: sqlite3.Connection, generation: int) -> Iterator[Any]:
    """Yield the columns ``CANDIDATE`` of a generation."""
    sql = f"SELECT {CANDIDATE} FROM candidates WHERE generation = ? ORDER BY candidate"  # noqa: S608  ours
    return _read(connection, sql, lambda _: generation, generation, generation)


def outcomes(connection: sqlite3.Connection) -> Iterator[Any]:
    """Yield the columns ``OUTCOMES``, doubtful and digest of all rows."""
    sql = f"SELECT {OUTCOMES}, doubtful, digest FROM outcomes ORDER BY id"  # noqa: S608  ours
    return _read(connection, sql, lambda row: row[1] if isinstance(row[1], int) else 0)


def generations(connection: sqlite3.Connection) -> Iterator[Any]:
    """Yield the columns ``GENERATION`` and the digest of all rows."""
    sql = f"SELECT {GENERATION}, digest FROM generations ORDER BY generation"  # noqa: S608  ours
    return _read(connection, sql, lambda row: row[0] + 1)


def _check_state(connection: sqlite3.Connection, count: int) -> None:
    """Raise Damage unless the optimizer's state is that after the last generation.

    Without any it is made again from the candidates.
    """
    sql = f"SELECT {STATE} FROM optimizer ORDER BY part, piece"  # noqa: S608  ours
    rows = list(_read(connection, sql, lambda _: count, count))
    for part, piece, generation, state, written in rows:
        whole = of_row(part, piece, len(rows), generation, state) == written
        if not whole or generation != count - 1:
            what = "the optimizer's state before it is not what was written"
            raise Damage(what, count)


def _read(
    connection: sqlite3.Connection,
    sql: str,
    at: Callable[[Any], int],
    first: int = 0,
    *parameters: Any,
) -> Iterator[Any]:
    """Yield rows.

    Args:
        at: returns for a row the generation of the next.

    Raises:
        Damage: a row cannot be read.
    """
    number = first
    try:
        for row in connection.execute(sql, parameters):
            yield row
            number = at(row)
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        if outage(error, Path()):
            raise
        raise Damage(str(error), number) from None
