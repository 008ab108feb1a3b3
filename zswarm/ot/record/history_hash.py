"""The history hash: 32 hex digits over all that an optimizer proposed and learned, bit by bit.

It is a chain: the hash after a generation is BLAKE2b over the hash before it and the generation.
Genomes enter by digests of their own, so that it can be checked after they were dropped; counts
enter, too, so that no two histories have the same bytes.
"""

import hashlib
from collections.abc import Iterable, Sequence

import numpy as np

VERSION = 2
START = b"zswarm history 2"  # the hash before the first generation
SIZE = 16  # bytes


class History:
    """The hash after the generations that were added.

    Attributes:
        value: 16 bytes.
    """

    def __init__(self, value: bytes = START) -> None:
        self.value = value

    def add(
        self,
        genomes: Iterable[bytes],
        fitness: np.ndarray,
        measures: np.ndarray | None = None,
    ) -> None:
        """Add a generation.

        Args:
            fitness: (genomes,) float64.
            measures: (genomes, n) float64, if the optimizer uses measures.
        """
        self.add_digests([digest(genome) for genome in genomes], fitness, measures)

    def add_digests(
        self,
        digests: Sequence[bytes],
        fitness: np.ndarray,
        measures: np.ndarray | None = None,
    ) -> None:
        """Add a generation by the digests of its genomes."""
        count = 0 if measures is None or not measures.size else measures.shape[1]
        counts = np.array([len(digests), count], "<u8")
        parts = [self.value, counts.tobytes(), *digests, _bits(fitness)]
        if measures is not None and count:
            parts.append(_bits(measures))
        self.value = hashlib.blake2b(b"".join(parts), digest_size=SIZE).digest()

    def hex(self) -> str:
        """Return 32 hex digits."""
        return self.value.hex()


def assessed(history: bytes, genomes: Iterable[bytes], fitness: np.ndarray) -> str:
    """Return the hash of an assessment: 32 hex digits over the history and its outcomes.

    Args:
        history: the history hash of search.
        genomes: those that were assessed.
        fitness: (trials,) float64.
    """
    found = History(history)
    found.add_digests([digest(genome) for genome in genomes], fitness)
    return found.hex()


def digest(genome: bytes) -> bytes:
    """Return a genome's digest: 16 bytes of BLAKE2b."""
    return hashlib.blake2b(genome, digest_size=SIZE).digest()


def _bits(numbers: np.ndarray) -> bytes:
    """Return float64 numbers as SQLite returns them: one NaN, no -0.0."""
    return np.where(np.isnan(numbers), np.nan, numbers + 0.0).astype("<f8").tobytes()
