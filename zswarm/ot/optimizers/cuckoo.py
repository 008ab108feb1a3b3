"""Cuckoo search: eggs laid by Lévy flights from every nest, and discovered nests that move.

Source, with the numbers of the equations: X.-S. Yang, S. Deb, "Cuckoo search: recent advances and
applications", Neural Computing and Applications 24, 2014. Steps of Lévy flights: R. N. Mantegna,
Physical Review E 49, 1994. Maths, and what differs from FREVO: docs/optimizers.md.
"""

from typing import Annotated

import numpy as np

from zswarm.config.meta import PartSettings, about, above, within
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import mean
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.base import BaseOptimizer
from zswarm.ot.optimizers.space import Bound, Positive, Space, spread

DEVIATION = 0.6965745025576967  # Mantegna, eq. 11, for the exponent 3/2


class CuckooSettings(PartSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "cuckoo"``."""

    population: Annotated[int, within(3, 1_000_000, "nests")] = 50
    discovery: Annotated[
        float, above(0, 1, "share of nests moved each second generation")
    ] = 0.75
    step: Annotated[
        Positive, about("scale of Lévy flights, in distances to the best nest")
    ] = 0.3
    bound: Bound = 2.0


class CuckooSearch(BaseOptimizer):
    """Cuckoo search: Lévy flights, mostly short and sometimes long, and crossings of nests.

    For vectors of numbers. With fresh seeds all nests are evaluated again.

    Statistics: best, mean of the nests, evaluations; ``spread``, the mean
    distance of a nest's number from the mean of all nests, in ranges of new genomes; ``success``,
    the share of the last eggs that were better than their nest.
    """

    settings_type = CuckooSettings
    stored = ("nests", "fitness")
    settings: CuckooSettings

    def __init__(
        self, settings: CuckooSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.population
        self._space = Space(representation)
        self._nests = self._eggs = np.empty((0, self._space.dimensions))
        self._laid = np.arange(settings.population)  # nests that have the eggs
        self._fitness = np.full(settings.population, np.nan)

    def use_fresh_seeds(self) -> None:
        """See ``Optimizer``: all nests are evaluated again."""
        super().use_fresh_seeds()
        self.candidates = 2 * self.settings.population

    def _ask(self) -> list[bytes]:
        settings, count = self.settings, self.settings.population
        stream = self._stream("cuckoo")
        if self.generation == 0:
            self._nests = self._eggs = self._space.uniform(-1.0, 1.0, count, stream)
            return self._space.genomes(self._eggs)
        if self.generation % 2:
            self._laid = np.arange(count)
            moved = self._nests + self._flights(stream)
        else:
            found = stream.uniform(0.0, 1.0, count) < settings.discovery
            self._laid = (
                np.flatnonzero(found) if found.any() else stream.integers(count, 1)
            )
            moved = self._nests[self._laid] + self._crossings(stream)[self._laid]
        self._eggs = np.clip(moved, -settings.bound, settings.bound)
        eggs = self._space.genomes(self._eggs)
        return [*eggs, *self._space.genomes(self._nests)] if self.fresh else eggs

    def _flights(self, stream: Stream) -> np.ndarray:
        """Return steps of Lévy flights, scaled by the distance to the best nest."""
        space, count = self._space, len(self._nests)
        best = self._nests[np.argsort(-self._fitness, kind="stable")[0]]
        normal = space.normal(count, stream)
        # Mantegna, eq. 5.
        levy = DEVIATION * normal / _two_thirds(space.normal(count, stream))
        steps: np.ndarray = self.settings.step * levy * (self._nests - best)  # eq. 2
        steps *= space.normal(count, stream)
        return steps

    def _crossings(self, stream: Stream) -> np.ndarray:
        """Return shares of the differences of two other nests."""
        count = len(self._nests)
        one, other = (
            self._nests[np.argsort(stream.words(count), kind="stable")] for _ in range(2)
        )
        return stream.uniform(0.0, 1.0, count)[:, None] * (one - other)  # eq. 1

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  unused
        everything, fitness = fitness, fitness[: len(self._eggs)]
        if len(everything) > len(fitness):
            self._fitness = everything[len(fitness) :].copy()
        previous = self._fitness[self._laid]
        better = (fitness > previous) | (np.isnan(previous) & ~np.isnan(fitness))
        self._nests = self._nests.copy()
        self._nests[self._laid[better]] = self._eggs[better]
        self._fitness[self._laid[better]] = fitness[better]
        self._count(
            everything,
            mean=mean(self._fitness),
            spread=spread(self._nests),
            success=int(better.sum()) / len(better),
        )


def _two_thirds(numbers: np.ndarray) -> np.ndarray:
    """Return |numbers| to the power 2/3, by Newton's cube root of the square: + - * / only."""
    mantissa, power = np.frexp(numbers * numbers)  # exact, mantissa in [1/2, 1)
    thirds = -(-power // 3)
    cube = np.ldexp(mantissa, power - 3 * thirds)  # in [1/8, 1)
    root = 0.4 + 0.6 * cube
    for _ in range(5):
        root = root - (root - cube / (root * root)) / 3.0
    result: np.ndarray = np.ldexp(root, thirds)
    return result
