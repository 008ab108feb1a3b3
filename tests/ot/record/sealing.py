"""Give a record that a test has edited the digests that its contents have."""

import contextlib
import sqlite3
from collections import defaultdict
from pathlib import Path

import numpy as np

from zswarm.ot.record import digests
from zswarm.ot.record.history_hash import START, History, digest


def reseal(folder: Path) -> None:
    """Write all digests of a record again; tables that are missing are left out."""
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as database, database:
        database.text_factory = lambda raw: raw.decode(errors="replace")
        for step in (_outcomes, _generations, _events, _state, _meta):
            with contextlib.suppress(sqlite3.Error):
                step(database)


def _outcomes(database: sqlite3.Connection) -> None:
    for *row, doubtful in database.execute(
        f"SELECT {digests.OUTCOMES}, doubtful FROM outcomes"  # noqa: S608
    ).fetchall():
        written = digests.of_row(*row)
        database.execute(
            "UPDATE outcomes SET digest = ? WHERE id = ?",
            (~written if doubtful else written, row[0]),
        )


def _events(database: sqlite3.Connection) -> None:
    for row in database.execute(f"SELECT {digests.EVENT} FROM events").fetchall():  # noqa: S608
        database.execute(
            "UPDATE events SET digest = ? WHERE rowid = ?", (digests.of_row(*row), row[0])
        )


def _generations(database: sqlite3.Connection) -> None:
    history = History(START)
    outcomes = defaultdict[int, list[int]](list)  # there is no index by generation
    for generation, doubtful, written in database.execute(
        "SELECT generation, doubtful, digest FROM outcomes"
    ):
        outcomes[generation].append(~written if doubtful else written)
    for (generation,) in database.execute(
        "SELECT generation FROM generations ORDER BY generation"
    ).fetchall():
        _candidates(database, generation, history)
        trials = digests.total(outcomes[generation])
        database.execute(
            "UPDATE generations SET history = ?, outcomes = ? WHERE generation = ?",
            (history.value, trials, generation),
        )
        (row,) = database.execute(
            f"SELECT {digests.GENERATION} FROM generations WHERE generation = ?",  # noqa: S608
            (generation,),
        )
        database.execute(
            "UPDATE generations SET digest = ? WHERE generation = ?",
            (digests.of_row(*row), generation),
        )
    if history.value != START:
        database.execute(
            "UPDATE meta SET value = ? WHERE key = 'history_hash'",
            (history.hex(),),
        )


def _candidates(database: sqlite3.Connection, generation: int, history: History) -> None:
    rows = database.execute(
        "SELECT candidate, genome, fitness, measures, digest FROM candidates "
        "WHERE generation = ? ORDER BY candidate",
        (generation,),
    ).fetchall()
    found = [
        digest(genome) if isinstance(genome, bytes) else former
        for _, genome, _, _, former in rows
    ]
    database.executemany(
        "UPDATE candidates SET digest = ? WHERE (generation, candidate) = (?, ?)",
        [(written, generation, row[0]) for row, written in zip(rows, found, strict=True)],
    )
    with contextlib.suppress(TypeError, ValueError):  # measures that are no numbers
        measures = [np.frombuffer(row[3] or b"", "<f8") for row in rows]
        fitness = np.array([row[2] for row in rows], np.float64)
        history.add_digests(found, fitness, np.array(measures, np.float64))


def _state(database: sqlite3.Connection) -> None:
    rows = database.execute(
        "SELECT part, piece, generation, state FROM optimizer"
    ).fetchall()
    for part, piece, generation, state in rows:
        written = digests.of_row(part, piece, len(rows), generation, state)
        database.execute(
            "UPDATE optimizer SET digest = ? WHERE (part, piece) = (?, ?)",
            (written, part, piece),
        )


def _meta(database: sqlite3.Connection) -> None:
    meta = dict(database.execute("SELECT key, value FROM meta").fetchall())
    if meta:
        database.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", digests.seal(meta))
