"""Digests in a record, which show that what is read is what was written; SQLite has none.

The history hash guards the candidates of each finished generation, a digest of 64 bits each row of
``generations``, ``outcomes``, ``events``, ``optimizer`` and ``meta``. They find accidents: who
wants to forge a record computes them again.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from zswarm.ot.record.history_hash import History, digest

DIGESTS = "digests"  # key of ``meta``
BITS = 64

GENERATION = (
    "generation, finished_at, best, mean, evaluations, statistics, history, outcomes"
)
CANDIDATE = "candidate, genome, fitness, measures, digest"
EVENT = "rowid, at, generation, event, server, text, count, machine"
OUTCOMES = (
    "id, generation, asked, count, trials, fitness, metrics, faulted, server, seconds, at, "
    "round, participants"
)


class Damage(Exception):
    """Something recorded differs from what was written.

    Attributes:
        generation: everything before it is whole; None: what all generations need is damaged.
    """

    def __init__(self, what: str, generation: int | None = None) -> None:
        where = "" if generation is None else f"generation {generation + 1}: "
        super().__init__(f"{where}{what}")
        self.generation = generation


def of_row(*values: Any) -> int:
    """Return the digest of a row's values, as SQLite returns them: a signed number of 64 bits."""
    body = msgspec.msgpack.encode(values)
    return _signed(hashlib.blake2b(body, digest_size=BITS // 8).digest())


def total(digests: Iterable[int]) -> int:
    """Return one digest of rows in any order: their sum."""
    return _signed((sum(digests) % 2**BITS).to_bytes(BITS // 8, "little"))


def real(number: float | None) -> float | None:
    """Return a number as SQLite returns it: NaN as None, no -0.0."""
    return None if number is None or number != number else float(number) + 0.0


# ---- meta


def seal(meta: Mapping[str, Any]) -> tuple[str, str]:
    """Return the row of ``meta`` that guards the others."""
    rows = {key: of_row(key, value) for key, value in meta.items() if key != DIGESTS}
    return DIGESTS, json.dumps(rows, sort_keys=True)


def check_meta(meta: Mapping[str, Any]) -> None:
    """Raise Damage unless the rows of ``meta`` are those that were written."""
    try:
        expected = msgspec.json.decode(meta.get(DIGESTS, ""), type=dict[str, int])
    except (msgspec.DecodeError, UnicodeDecodeError, TypeError, RecursionError):
        raise Damage("table meta: its digests cannot be read") from None
    found = {key: of_row(key, value) for key, value in meta.items() if key != DIGESTS}
    wrong = [key for key in expected | found if found.get(key) != expected.get(key)]
    if wrong:  # a damaged key may be of any type
        raise Damage(
            f"table meta: not what was written: {', '.join(sorted(map(str, wrong)))}"
        )


# ---- generations


def check_generation(number: int, row: Sequence[Any], written: Any) -> None:
    """Raise Damage unless a row of ``generations`` is what was written.

    Args:
        row: the columns ``GENERATION``.
        written: its digest.
    """
    if row[0] != number:
        raise Damage("its row in table generations is missing", number)
    if of_row(*row) != written:
        raise Damage("its row in table generations is not what was written", number)


def check_candidates(
    generation: int, before: bytes, after: bytes, rows: Iterable[Sequence[Any]]
) -> None:
    """Raise Damage unless a generation's candidates are those that were written.

    Args:
        before, after: the history hash before and after the generation.
        rows: the columns ``CANDIDATE``, in order.
    """
    digests, fitness, measures = [], [], []
    for number, (candidate, genome, value, measured, expected) in enumerate(rows):
        if candidate != number:
            raise Damage(f"candidate {number} is missing", generation)
        if genome is not None and (
            not isinstance(genome, bytes) or digest(genome) != expected
        ):
            what = f"the genome of candidate {candidate} is not what was written"
            raise Damage(what, generation)
        digests.append(expected)
        fitness.append(value)
        measures.append(measured or b"")
    history = History(before)
    try:
        told = np.array([np.frombuffer(row, "<f8") for row in measures], np.float64)
        history.add_digests(digests, np.array(fitness, np.float64), told)
    except (TypeError, ValueError):
        history.value = b""
    if history.value != after:
        what = "its candidates, their fitness or measures are not what was written"
        raise Damage(what, generation)


# ---- outcomes


def check_outcomes(row: Sequence[Any], doubtful: Any, written: Any) -> int | None:
    """Return the digest of a row of ``outcomes``; None if it is not what was written.

    A doubtful row has the complement of its digest.

    Args:
        row: the columns ``OUTCOMES``.
    """
    if doubtful not in (0, 1) or not isinstance(written, int):
        return None
    expected = ~written if doubtful else written
    return expected if of_row(*row) == expected else None


# ---- events


def check_event(number: int, row: Sequence[Any], written: Any, generations: int) -> None:
    """Raise Damage unless a row of ``events`` is what was written.

    Args:
        number: of the row, counted from 1.
        row: the columns ``EVENT``.
        written: its digest.
        generations: how many are finished, and do not depend on events.
    """
    if row[0] != number:
        raise Damage(f"event {number} is missing", generations)
    if of_row(*row) != written:
        raise Damage(f"event {number} is not what was written", generations)


def _signed(body: bytes) -> int:
    return int.from_bytes(body, "little", signed=True)
