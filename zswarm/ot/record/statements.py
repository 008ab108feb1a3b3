"""The statements that add to a record's tables; each may be executed twice (``database``)."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from operator import itemgetter

import numpy as np

from zswarm.config.decode import to_json
from zswarm.ot.cluster.events import Counted
from zswarm.ot.notes import Note
from zswarm.ot.record.database import Statement
from zswarm.ot.record.digests import of_row, real
from zswarm.ot.record.packing import PackedState
from zswarm.ot.workload import Workload

SET_META = "INSERT OR REPLACE INTO meta VALUES (?, ?)"
ADD_OUTCOMES = f"INSERT OR REPLACE INTO outcomes VALUES ({', '.join('?' * 15)})"  # noqa: S608  ours
ADD_EVENT = (
    "INSERT OR REPLACE INTO events (rowid, at, generation, event, server, text, count, machine, "
    "digest) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)"
)
ADD_CANDIDATES = "INSERT OR REPLACE INTO candidates VALUES "
# Of six values; every SQLite takes 999 parameters in a statement.
CANDIDATES_AT_ONCE = 166
BYTES_AT_ONCE = 4 << 20  # of genomes: SQLite copies a statement's values
ADD_GENERATION = f"INSERT OR REPLACE INTO generations VALUES ({', '.join('?' * 9)})"  # noqa: S608  ours
# The best of the generation is looked for once in a statement.
DROP_GENOMES = (
    "UPDATE candidates SET genome = NULL WHERE generation = ? AND candidate IN ({}) AND candidate "
    "<> (SELECT candidate FROM candidates WHERE generation = ? ORDER BY fitness DESC, candidate)"
)
DROPPED_AT_ONCE = 997
DROP_STATE = "DELETE FROM optimizer WHERE generation <> ?"
ADD_STATE = "INSERT OR REPLACE INTO optimizer VALUES (?, ?, ?, ?, ?)"


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
    players = games(workload, trials)
    values = (
        row,
        generation,
        asked,
        len(trials),
        workload.numbers[trials].astype("<u4").tobytes(),
        workload.fitness[trials].astype("<f8").tobytes(),
        workload.metrics[trials].astype("<f8").tobytes(),
        int(workload.faulted[trials].sum()),
        counted.server,
        float(counted.seconds),
        at,
    )
    written = of_row(*values, workload.round, players)
    return ADD_OUTCOMES, (*values, 0, workload.round, players, written)


def games(workload: Workload, trials: np.ndarray) -> bytes | None:
    """Return who played in trials; None if candidates are judged by themselves."""
    players = workload.participants[trials]
    return players.astype("<u4").tobytes() if players.shape[1] > 1 else None


def event(note: Note, row: int, generation: int | None, at: float) -> Statement:
    """Return what adds an event."""
    of = (str(note.event), note.server, note.text, note.count, note.machine)
    values = (row, at, generation, *of)
    return ADD_EVENT, (*values, of_row(*values))


def candidates(
    generation: int,
    genomes: Sequence[bytes | None],
    digests: Sequence[bytes],
    fitness: np.ndarray,
    measures: np.ndarray | None,
) -> list[Statement]:
    """Return what adds a generation's candidates; a genome may be dropped."""
    packed: Iterator[bytes | None] = itertools.repeat(None)
    if measures is not None and measures.size:
        packed = map(bytes, measures.astype("<f8"))
    rows = zip(
        itertools.repeat(generation),
        range(len(genomes)),
        genomes,
        fitness.tolist(),
        packed,
        digests,
        strict=False,
    )
    statements: list[Statement] = []
    size = max(map(len, filter(None, genomes)), default=0) or 1
    at_once = max(1, min(CANDIDATES_AT_ONCE, BYTES_AT_ONCE // size))
    while part := list(itertools.islice(rows, at_once)):
        sql = ADD_CANDIDATES + ", ".join(["(?, ?, ?, ?, ?, ?)"] * len(part))
        statements.append((sql, tuple(itertools.chain.from_iterable(part))))
    return statements


def dropped_genomes(places: Iterable[tuple[int, int]]) -> Iterator[Statement]:
    """Yield what drops genomes, but for the best of each generation.

    Args:
        places: generation and number of candidates, sorted.
    """
    for generation, group in itertools.groupby(places, key=itemgetter(0)):
        numbers = (candidate for _, candidate in group)
        while part := tuple(itertools.islice(numbers, DROPPED_AT_ONCE)):
            sql = DROP_GENOMES.format(", ".join("?" * len(part)))
            yield sql, (generation, *part, generation)


def generation_end(
    generation: int,
    count: int,
    statistics: dict[str, float],
    history: bytes,
    trials: int,
    at: float,
) -> Statement:
    """Return what adds a generation of candidates.

    Args:
        history: the history hash after it.
        trials: digest of its outcomes.
    """
    best, mean = real(statistics["best"]), real(statistics["mean"])
    row = (generation, at, best, mean, count, to_json(statistics), history, trials)
    return ADD_GENERATION, (*row, of_row(*row))


def state(generation: int, packed: PackedState) -> list[Statement]:
    """Return what replaces the optimizer's state."""
    pieces = packed.pieces()
    statements: list[Statement] = []
    for part, piece, body in pieces:
        written = of_row(part, piece, len(pieces), generation, body)
        statements.append((ADD_STATE, (part, piece, generation, body, written)))
    # Last: pages that this transaction frees would be written to the journal before they are used
    # again. Those that the last one freed are not.
    return [*statements, (DROP_STATE, (generation,))]
