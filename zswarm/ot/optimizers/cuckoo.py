"""Cuckoo search: eggs laid by Levy flights from every nest, and nests that are discovered and built anew.

Equations: X.-S. Yang, S. Deb, "Cuckoo search: recent advances and applications", Neural Computing and Applications 24, 2014,
numbered as there; steps of Levy flights by R. N. Mantegna, "Fast, accurate algorithm for numerical simulation of Levy stable
stochastic processes", Physical Review E 49, 1994, with the exponent 3/2 of X.-S. Yang, S. Deb, "Cuckoo Search via Levy flights",
NaBIC 2009. A generation is one of the two by turns, and an egg takes the place of its nest where it is better.

FREVO's ``CuckooSearch`` (github.com/smartgrids-aau/Frevo, version 1.5) has the same two. Mended:
- an egg is compared with its nest (there the flight changes the nest itself, so that worse eggs stay);
- a flight is scaled by the difference to the best nest (there by the sum), and by a constant (there it grows to 100 with time);
- ``discovery`` is the share that is built anew (there it is ignored and half of the nests are);
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
    discovery: Annotated[float, Meta(gt=0, le=1, description="share of the nests' numbers that discovery changes")] = 0.25
    step: Annotated[float, Meta(gt=0, le=1e6, description="scale of Levy flights, in distances to the best nest")] = 0.01
    bound: Annotated[float, Meta(gt=0, le=1e6, description="limit of a genome's numbers, in ranges of new genomes")] = 1.0


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
        self._space = Space(representation, "cuckoo")
        self._tally = Tally()
        self._nests = self._eggs = np.empty((0, self._space.dimensions))
        self._fitness = np.full(settings.population, np.nan)

    def _ask(self) -> list[bytes]:
        stream = Stream(derive_seed(self.seed, "cuckoo", self.generation))
        if self.generation == 0:
            self._nests = self._eggs = self._space.uniform(-1.0, 1.0, self.settings.population, stream)
        else:
            moved = self._nests + (self._flights(stream) if self.generation % 2 else self._crossings(stream))
            self._eggs = np.clip(moved, -self.settings.bound, self.settings.bound)
        return self._space.genomes(self._eggs)

    def _flights(self, stream: Stream) -> np.ndarray:
        """Equation (2): a Levy flight in every number, scaled by how far the best nest is."""
        count = len(self._nests)
        best = self._nests[np.argsort(-self._fitness, kind="stable")[0]]
        levy: np.ndarray = (
            DEVIATION * self._space.normal(count, stream) / _two_thirds(self._space.normal(count, stream))
        )  # Mantegna: (5)
        steps: np.ndarray = self.settings.step * levy * (self._nests - best) * self._space.normal(count, stream)
        return steps

    def _crossings(self, stream: Stream) -> np.ndarray:
        """Equation (1): some numbers move by the difference of two other nests."""
        count = len(self._nests)
        one, other = (self._nests[np.argsort(stream.words(count), kind="stable")] for _ in range(2))
        found = self._space.uniform(0.0, 1.0, count, stream) < self.settings.discovery
        return stream.uniform(0.0, 1.0, count)[:, None] * found * (one - other)

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  it wants none
        better = (fitness > self._fitness) | (np.isnan(self._fitness) & ~np.isnan(fitness))
        self._nests = np.where(better[:, None], self._eggs, self._nests)
        self._fitness = np.where(better, fitness, self._fitness)
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
