"""The history hash: 32 hex digits over all that an optimizer proposed and learned, bit by bit."""

import hashlib
from collections.abc import Sequence

import numpy as np


class History:
    """BLAKE2b over each generation's genomes, fitness and measures (little-endian float64)."""

    def __init__(self) -> None:
        self._total = hashlib.blake2b(digest_size=16)

    def add(
        self,
        genomes: Sequence[bytes],
        fitness: np.ndarray,
        measures: np.ndarray | None = None,
    ) -> None:
        """Add a generation.

        Args:
            fitness: (genomes,) float64.
            measures: (genomes, n) float64, if the optimizer uses measures.
        """
        self._total.update(b"".join(genomes))
        self._total.update(fitness.astype("<f8").tobytes())
        if measures is not None:
            self._total.update(measures.astype("<f8").tobytes())

    def hex(self) -> str:
        """Return 32 hex digits."""
        return self._total.hexdigest()
