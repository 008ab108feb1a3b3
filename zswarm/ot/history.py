"""The history hash: what two runs proposed and were told, bit by bit, in 32 hex digits."""

import hashlib
from collections.abc import Sequence

import numpy as np


class History:
    """BLAKE2b over each generation's genomes and the numbers told (little-endian float64)."""

    def __init__(self) -> None:
        self._total = hashlib.blake2b(digest_size=16)

    def add(self, genomes: Sequence[bytes], fitness: np.ndarray, measures: np.ndarray | None = None) -> None:
        """The next generation.

        Args:
            fitness: (genomes,) float64.
            measures: (genomes, n) float64, where the optimizer was told some.
        """
        self._total.update(b"".join(genomes))
        self._total.update(fitness.astype("<f8").tobytes())
        if measures is not None:
            self._total.update(measures.astype("<f8").tobytes())

    def hex(self) -> str:
        """32 hex digits."""
        return self._total.hexdigest()
