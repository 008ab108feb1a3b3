"""The vectors that genomes are, for optimizers that search such: in units of the ranges in which new genomes lie."""

from collections.abc import Sequence

import numpy as np

from zswarm.draws import Stream
from zswarm.errors import ConfigError
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.tally import mean, total

LARGEST = float(np.finfo(np.float32).max)


class Space:
    """Points are rows of float64; a new genome is uniform in plus or minus 1.

    Attributes:
        dimensions: numbers of a point.
    """

    def __init__(self, representation: Representation) -> None:
        """The space of a representation's genomes.

        Raises:
            ConfigError: they are no vectors.
        """
        if representation.genes is None or representation.ranges is None:
            raise ConfigError(
                f"optimizer: it searches vectors of numbers; "
                f"genomes of this representation ({type(representation).__name__}) are none"
            )
        self.dimensions = representation.genes
        self._ranges = representation.ranges

    def uniform(self, low: float, high: float, count: int, stream: Stream) -> np.ndarray:
        """(count, dimensions)."""
        return stream.uniform(low, high, count * self.dimensions).reshape(count, self.dimensions)

    def normal(self, count: int, stream: Stream) -> np.ndarray:
        """(count, dimensions), standard normal."""
        return stream.normal(0.0, 1.0, count * self.dimensions).reshape(count, self.dimensions)

    def genomes(self, points: np.ndarray) -> list[bytes]:
        """What the points stand for, rounded to float32; too large numbers are the largest there are."""
        return [row.tobytes() for row in np.clip(points * self._ranges, -LARGEST, LARGEST).astype("<f4")]

    def of(self, genomes: Sequence[bytes]) -> np.ndarray:
        """(genomes, dimensions): the points that genomes stand for."""
        points: np.ndarray = np.frombuffer(b"".join(genomes), "<f4").reshape(-1, self.dimensions) / self._ranges
        return points

    def points(self, packed: bytes) -> np.ndarray:
        """Points that were packed by ``tobytes``."""
        return np.frombuffer(packed, np.float64).reshape(-1, self.dimensions)


def spread(points: np.ndarray) -> float:
    """How far a number is from the mean of all points, on average."""
    return mean(np.abs(points - total(points) / len(points)))
