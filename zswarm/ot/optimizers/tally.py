"""What an optimizer was told so far, in short."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

NONE: Mapping[str, float] = {}


class Tally(msgspec.Struct):
    """The best so far, and numbers about the last generation."""

    genome: bytes = b""
    fitness: float = float("-inf")
    evaluations: int = 0
    statistics: dict[str, float] = {}

    def add(
        self, genomes: Sequence[bytes], fitness: np.ndarray, statistics: Mapping[str, float] = NONE, *, relative: bool = False
    ) -> None:
        """Count a generation.

        Args:
            fitness: (len(genomes),) float64, NaN where evaluation failed.
            statistics: beside ``best``, ``mean`` and ``evaluations``, or in place of these.
            relative: what was the best before does not count.
        """
        if relative:
            self.genome, self.fitness = b"", float("-inf")
        for genome, value in zip(genomes, fitness.tolist(), strict=True):
            if value > self.fitness:
                self.genome, self.fitness = genome, value
        self.evaluations += len(fitness)
        told = {"best": self.fitness, "mean": mean(fitness[~np.isnan(fitness)]), "evaluations": float(self.evaluations)}
        self.statistics = {**told, **statistics}

    def best(self) -> tuple[bytes, float]:
        """The best genome and its fitness."""
        return self.genome, self.fitness

    def state(self) -> dict[str, Any]:
        """All of it as plain values; ``Tally(**state)`` is the same again."""
        return msgspec.structs.asdict(self)


def total(numbers: np.ndarray) -> np.ndarray:
    """The sum along the first axis, one after the other: numpy's own sums are in an order of their choice."""
    added: np.ndarray = np.cumsum(numbers, axis=0)[-1]
    return added


def mean(numbers: np.ndarray) -> float:
    """Of all, added in their order; NaN of none."""
    return float(total(numbers.ravel())) / numbers.size if numbers.size else float("nan")
