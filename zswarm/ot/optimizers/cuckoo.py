"""Cuckoo search: eggs laid by Lévy flights from every nest, and discovered nests that move.

Source, with the numbers of the equations: X.-S. Yang, S. Deb, "Cuckoo search: recent advances and
applications", Neural Computing and Applications 24, 2014. Steps of Lévy flights: R. N. Mantegna,
Physical Review E 49, 1994. Maths, and what differs from FREVO: docs/optimizers.md.
"""

from collections.abc import Iterator
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

    For vectors of numbers. Statistics: best, mean of the nests, evaluations; ``spread``, the mean
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
        # A nest is where its genome is, so the record has all nests; genomes may be large.
        self._nests: list[bytes] = []
        self._eggs: list[bytes] = []
        self._laid = np.arange(settings.population)  # nests that have the eggs
        self._fitness = np.full(settings.population, np.nan)

    def _ask(self) -> list[bytes]:
        settings, count, space = self.settings, self.settings.population, self._space
        stream = self._stream("cuckoo")
        self._laid = np.arange(count)
        if self.generation == 0:
            moves = self._first(stream)
        elif self.generation % 2:
            moves = self._flights(stream)
        else:
            found = stream.uniform(0.0, 1.0, count) < settings.discovery
            self._laid = (
                np.flatnonzero(found) if found.any() else stream.integers(count, 1)
            )
            moves = self._crossings(stream)
        self._eggs = []
        for moved in moves:
            self._eggs += space.genomes(np.clip(moved, -settings.bound, settings.bound))
        if self.generation == 0:
            self._nests = self._eggs
        return self._eggs

    def _first(self, stream: Stream) -> Iterator[np.ndarray]:
        """Yield blocks of new nests."""
        for some in self._space.blocks(self.settings.population):
            yield self._space.uniform(-1.0, 1.0, some.stop - some.start, stream)

    def _flights(self, stream: Stream) -> Iterator[np.ndarray]:
        """Yield blocks of nests moved by Lévy flights, scaled by the distance to the best nest."""
        space, count = self._space, len(self._nests)
        order = np.argsort(-self._fitness, kind="stable")
        best = space.points([self._nests[order[0]]])
        for some in space.blocks(count):
            one, two, three = (
                space.normal(
                    some.stop - some.start,
                    space.skip(stream, table * count + some.start),
                )
                for table in range(3)
            )
            levy = DEVIATION * one / _two_thirds(two)  # Mantegna, eq. 5
            nests = space.points(self._nests[some])
            steps: np.ndarray = self.settings.step * levy * (nests - best)  # eq. 2
            yield nests + steps * three

    def _crossings(self, stream: Stream) -> Iterator[np.ndarray]:
        """Yield blocks of found nests, moved by shares of the differences of two others."""
        space, count = self._space, len(self._nests)
        one, other = (np.argsort(stream.words(count), kind="stable") for _ in range(2))
        shares = stream.uniform(0.0, 1.0, count)[:, None]

        def nests(which: np.ndarray) -> np.ndarray:
            return space.points([self._nests[nest] for nest in which])

        for some in space.blocks(len(self._laid)):
            laid = self._laid[some]
            difference = nests(one[laid]) - nests(other[laid])
            yield nests(laid) + shares[laid] * difference  # eq. 1

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  unused
        previous, space = self._fitness[self._laid], self._space
        better = (fitness > previous) | (np.isnan(previous) & ~np.isnan(fitness))
        self._nests = self._nests.copy()
        for egg in np.flatnonzero(better):
            self._nests[self._laid[egg]] = self._eggs[egg]
        self._fitness[self._laid[better]] = fitness[better]
        nests, some = self._nests, space.blocks(len(self._nests))
        self._count(
            fitness,
            mean=mean(self._fitness),
            spread=spread(lambda: (space.points(nests[block]) for block in some)),
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
