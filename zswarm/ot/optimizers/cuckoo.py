"""Cuckoo search: eggs laid by Levy flights from every nest, and nests that are discovered and built anew.

Equations: X.-S. Yang, S. Deb, "Cuckoo search: recent advances and applications", Neural Computing and Applications 24, 2014,
numbered as there; steps of Levy flights by R. N. Mantegna, "Fast, accurate algorithm for numerical simulation of Levy stable
stochastic processes", Physical Review E 49, 1994, with the exponent 3/2 of X.-S. Yang, S. Deb, "Cuckoo Search via Levy flights",
NaBIC 2009. A generation is one of the two by turns, and an egg takes the place of its nest where it is better.

As in FREVO's ``CuckooSearch`` (github.com/smartgrids-aau/Frevo, version 1.5) a nest is discovered as a whole, and all its numbers
move by the same factor. Mended:
- an egg is compared with its nest (there the flight changes the nest itself, so that worse eggs stay);
- a flight is scaled by the difference to the best nest (there by the sum), and by a constant (there it grows to 100 with time);
- ``discovery`` is the share that is built anew (there it is ignored, and half of the nests are; there and in the authors' own
  program a rate of 0.25 means that the others, three quarters, are built anew);
- fitness may be negative (there the best starts above 0).
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.ot.optimizers.space import Space, spread
from zswarm.ot.optimizers.tally import Tally, mean

# Of Mantegna's (11), for the exponent b = 3/2: the power 1/b of G(1 + b) sin(pi b / 2) / (G((1 + b) / 2) b 2^((b - 1) / 2)).
DEVIATION = 0.6965745025576967


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "cuckoo"``."""

    population: Annotated[int, Meta(ge=3, le=1_000_000, description="nests")] = 50
    discovery: Annotated[
        float, Meta(gt=0, le=1, description="share of the nests that are discovered and built anew, by turns with flights")
    ] = 0.75
    step: Annotated[float, Meta(gt=0, le=1e6, description="scale of Levy flights, in distances to the best nest")] = 0.3
    bound: Annotated[float, Meta(gt=0, le=1e6, description="limit of a genome's numbers, in ranges of new genomes")] = 2.0


class CuckooSearch(Optimizer):
    """Cuckoo search: Levy flights, mostly short and now and then long, and crossings of nests. For vectors of numbers.

    Statistics: best, mean of the nests, evaluations; ``spread``, how far a nest's number is from the mean of all nests, on
    average and in ranges of new genomes; ``success``, the share of the last eggs that were better than their nest.
    """

    settings_type = Settings
    portable = True
    settings: Settings

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.population
        self._space = Space(representation)
        self._tally = Tally()
        self._nests = self._eggs = np.empty((0, self._space.dimensions))
        self._laid = np.arange(settings.population)  # in these nests, the eggs
        self._fitness = np.full(settings.population, np.nan)

    def _ask(self) -> list[bytes]:
        stream, count = Stream(derive_seed(self.seed, "cuckoo", self.generation)), self.settings.population
        if self.generation == 0:
            self._nests = self._eggs = self._space.uniform(-1.0, 1.0, count, stream)
        else:
            if self.generation % 2:
                self._laid, moved = np.arange(count), self._nests + self._flights(stream)
            else:
                found = stream.uniform(0.0, 1.0, count) < self.settings.discovery
                self._laid = np.flatnonzero(found) if found.any() else stream.integers(count, 1)
                moved = self._nests[self._laid] + self._crossings(stream)[self._laid]
            self._eggs = np.clip(moved, -self.settings.bound, self.settings.bound)
        return self._space.genomes(self._eggs)

    def _flights(self, stream: Stream) -> np.ndarray:
        """Equation (2): a Levy flight in every number, scaled by how far the best nest is."""
        count = len(self._nests)
        best = self._nests[np.argsort(-self._fitness, kind="stable")[0]]
        levy = DEVIATION * self._space.normal(count, stream) / _two_thirds(self._space.normal(count, stream))  # Mantegna: (5)
        steps: np.ndarray = self.settings.step * levy * (self._nests - best) * self._space.normal(count, stream)
        return steps

    def _crossings(self, stream: Stream) -> np.ndarray:
        """Equation (1): a share of the difference of two other nests."""
        count = len(self._nests)
        one, other = (self._nests[np.argsort(stream.words(count), kind="stable")] for _ in range(2))
        return stream.uniform(0.0, 1.0, count)[:, None] * (one - other)

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  it wants none
        before = self._fitness[self._laid]
        better = (fitness > before) | (np.isnan(before) & ~np.isnan(fitness))
        self._nests = self._nests.copy()
        self._nests[self._laid[better]] = self._eggs[better]
        self._fitness[self._laid[better]] = fitness[better]
        known = self._fitness[~np.isnan(self._fitness)]
        numbers = {"mean": mean(known), "spread": spread(self._nests), "success": int(better.sum()) / len(better)}
        self._tally.add(self._space.genomes(self._eggs), fitness, numbers)

    def state(self) -> dict[str, Any]:
        """See ``Optimizer.state``."""
        return {
            "generation": self.generation,
            "tally": self._tally.state(),
            "nests": self._nests.tobytes(),
            "fitness": self._fitness.tolist(),
        }

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:  # noqa: ARG002  the state is all
        """See ``Optimizer.restore``."""
        self.generation = state["generation"]
        self._tally = Tally(**state["tally"])
        self._nests = self._space.points(state["nests"])
        self._fitness = np.array(state["fitness"])

    def best(self) -> tuple[bytes, float]:
        """See ``Optimizer.best``."""
        return self._tally.best()

    def statistics(self) -> dict[str, float]:
        """See the class."""
        return dict(self._tally.statistics)


def _two_thirds(numbers: np.ndarray) -> np.ndarray:
    """The size of numbers to the power 2/3: Newton's cube root of the square, of + - * / alone."""
    mantissa, power = np.frexp(numbers * numbers)  # exact, mantissa in [1/2, 1)
    thirds = -(-power // 3)
    cube = np.ldexp(mantissa, power - 3 * thirds)  # in [1/8, 1)
    root = 0.4 + 0.6 * cube
    for _ in range(5):
        root = root - (root - cube / (root * root)) / 3.0
    result: np.ndarray = np.ldexp(root, thirds)
    return result
