"""Genomes as vectors, in units of the ranges of new genomes."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.config.meta import about
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import mean, total
from zswarm.nets.representation import Representation

LARGEST = float(np.finfo(np.float32).max)

Positive = Annotated[float, Meta(gt=0, le=1e6)]
Bound = Annotated[Positive, about("limit of a genome's numbers, in ranges")]


class Space:
    """Points are rows of float64; a new genome is uniform in plus or minus 1.

    Attributes:
        dimensions: numbers of a point.

    Raises:
        ConfigError: genomes of the representation are not vectors.
    """

    def __init__(self, representation: Representation) -> None:
        if representation.genes is None or representation.ranges is None:
            name = type(representation).__name__
            raise ConfigError(
                "optimizer: it searches vectors of numbers; "
                f"genomes of this representation ({name}) are not vectors"
            )
        self.dimensions = representation.genes
        self._ranges = representation.ranges

    def uniform(self, low: float, high: float, count: int, stream: Stream) -> np.ndarray:
        """Return (count, dimensions)."""
        return stream.uniform(low, high, count * self.dimensions).reshape(
            count, self.dimensions
        )

    def normal(self, count: int, stream: Stream) -> np.ndarray:
        """Return (count, dimensions), standard normal."""
        return stream.normal(0.0, 1.0, count * self.dimensions).reshape(
            count, self.dimensions
        )

    def genomes(self, points: np.ndarray) -> list[bytes]:
        """Return points as genomes, rounded and clipped to float32."""
        numbers = np.clip(points * self._ranges, -LARGEST, LARGEST).astype("<f4")
        return [row.tobytes() for row in numbers]

    def points(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return genomes as points, (genomes, dimensions)."""
        numbers = np.frombuffer(b"".join(genomes), "<f4").reshape(-1, self.dimensions)
        points: np.ndarray = numbers / self._ranges
        return points


def spread(points: np.ndarray) -> float:
    """Return the mean distance of a number from the mean of all points."""
    return mean(np.abs(points - total(points) / len(points)))
