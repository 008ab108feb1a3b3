"""The statements that add to a record's tables; each may be executed twice (``database``)."""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import numpy as np

from zswarm.config.decode import to_json
from zswarm.ot.cluster.events import Counted
from zswarm.ot.notes import Note
from zswarm.ot.record.database import Statement
from zswarm.ot.workload import Workload

SET_META = "INSERT OR REPLACE INTO meta VALUES (?, ?)"
ADD_OUTCOMES = f"INSERT OR REPLACE INTO outcomes VALUES ({', '.join('?' * 14)})"  # noqa: S608  ours
ADD_EVENT = (
    "INSERT OR REPLACE INTO events (rowid, at, generation, event, server, text, count) "
    "VALUES (?, ?, ?, ?, ?, ?, ?)"
)
ADD_CANDIDATES = "INSERT OR REPLACE INTO candidates VALUES "
# Of five values; every SQLite takes 999 parameters in a statement.
CANDIDATES_AT_ONCE = 199
ADD_GENERATION = "INSERT OR REPLACE INTO generations VALUES (?, ?, ?, ?, ?, ?)"
SET_OPTIMIZER = "INSERT OR REPLACE INTO optimizer VALUES (0, ?, ?)"


def outcomes(
    counted: Counted,
    workload: Workload,
    row: int,
    generation: int | None,
    asked: bytes,
    at: float,
) -> Statement:
    """Return what adds outcomes.

    Args:
        asked: digest of the genomes that were asked for.
        at: s since 1970.
    """
    trials = counted.trials
    values = (
        row,
        generation,
        asked,
        len(trials),
        (workload.first + trials).astype("<u4").tobytes(),
        workload.fitness[trials].astype("<f8").tobytes(),
        workload.metrics[trials].astype("<f8").tobytes(),
        int(workload.faulted[trials].sum()),
        counted.server,
        counted.seconds,
        at,
        0,
        workload.round,
        games(workload, trials),
    )
    return ADD_OUTCOMES, values


def games(workload: Workload, trials: np.ndarray) -> bytes | None:
    """Return who played in trials; None if candidates are judged by themselves."""
    players = workload.participants[trials]
    return players.astype("<u4").tobytes() if players.shape[1] > 1 else None


def event(note: Note, row: int, generation: int | None, at: float) -> Statement:
    """Return what adds an event."""
    values = (row, at, generation, note.event, note.server, note.text, note.count)
    return ADD_EVENT, values


def candidates(
    generation: int,
    genomes: Sequence[bytes],
    fitness: np.ndarray,
    measures: np.ndarray | None,
) -> list[Statement]:
    """Return what adds a generation's candidates."""
    packed: Iterator[bytes | None] = itertools.repeat(None)
    if measures is not None and measures.size:
        packed = map(bytes, measures.astype("<f8"))
    numbers, count = itertools.repeat(generation), len(genomes)
    rows = list(
        zip(numbers, range(count), genomes, fitness.tolist(), packed, strict=False)
    )
    statements: list[Statement] = []
    for begin in range(0, count, CANDIDATES_AT_ONCE):
        part = rows[begin : begin + CANDIDATES_AT_ONCE]
        sql = ADD_CANDIDATES + ", ".join(["(?, ?, ?, ?, ?)"] * len(part))
        statements.append((sql, tuple(itertools.chain.from_iterable(part))))
    return statements


def generation_end(
    generation: int, count: int, statistics: dict[str, float], state: Any, at: float
) -> list[Statement]:
    """Return statements that add a generation of candidates, and the optimizer's state if any."""
    best, mean = statistics["best"], statistics["mean"]
    row = (generation, at, best, mean, count, to_json(statistics))
    if state is None:
        return [(ADD_GENERATION, row)]
    packed = msgspec.msgpack.encode(state)
    return [(ADD_GENERATION, row), (SET_OPTIMIZER, (generation, packed))]
