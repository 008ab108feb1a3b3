"""Adapt optimizers of other packages that ask for vectors and are told their fitness.

A child creates the package's optimizer in its constructor, returns its vectors in ``_propose`` and
tells it their fitness in ``_learn``. Vectors are in units of the ranges of the genes, so new
genomes of the representation are uniform in -1..1.

The other package's state is not stored. ``restore`` repeats all asks and tells instead, so the same
seed must give the same proposals. If it does not, because the processor or a version differs, the
recorded genomes are told, and ``diverged`` is set.

Linear algebra runs on one thread, for it adds in another order with another number of threads.
"""

import contextlib
import math
import threading
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from itertools import islice
from typing import Annotated, Any

import msgspec
import numpy as np

from zswarm.config.meta import about, above
from zswarm.errors import ConfigError
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.base import BaseOptimizer, setting_error
from zswarm.ot.optimizers.optimizer import Told
from zswarm.ot.optimizers.space import Space
from zswarm.system.extras import need

FAR = 1e9  # ranges: a search that diverges ends here

Sigma = Annotated[
    float, above(0, 1e3, "first standard deviation, in ranges of new weights")
]
Separable = Annotated[bool, about("without correlations: for more than about 200 genes")]

_limiting = threading.Lock()


class Adapter(BaseOptimizer):
    """An optimizer of another package.

    A child writes ``_propose`` and ``_learn``, and sets ``candidates``.
    """

    portable = False
    replays = True

    def __init__(
        self, settings: msgspec.Struct, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        self._threads = need("threadpoolctl", "cmaes", "an optimizer of another package")
        self._space = Space(representation)
        self.genes = self._space.dimensions

    @abstractmethod
    def _propose(self) -> np.ndarray:
        """Return the next vectors: (n, genes), finite, with n at most ``candidates``."""

    @abstractmethod
    def _learn(
        self, solutions: np.ndarray, fitness: np.ndarray, measures: np.ndarray
    ) -> None:
        """Take the results of the vectors last proposed.

        Args:
            solutions: (n, genes) float64, the vectors as evaluated, which is rounded to float32.
            fitness: (n,) float64, finite, higher is better. A failed candidate has the lowest of
                the others, or 0 if all failed.
            measures: (n, len(self.measures)) float64; a row of NaN for a failed candidate.
        """

    def _numbers(self) -> dict[str, float]:
        """Return the child's statistics of the last evaluated generation."""
        return {}

    def _ask(self) -> list[bytes]:
        with self._one_thread():
            vectors = np.asarray(self._propose(), np.float64)
        valid = len(vectors) and vectors.shape == (len(vectors), self.genes)
        if not valid or not np.isfinite(vectors).all():
            text = f"must return (n, {self.genes}) finite numbers, not {vectors!r:.80}"
            raise ValueError(f"{type(self).__name__}._propose {text}")
        return self._space.genomes(np.clip(vectors, -FAR, FAR))

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:
        failed = np.isnan(fitness)
        finite = np.where(failed, 0.0 if failed.all() else np.nanmin(fitness), fitness)
        measures = np.where(failed[:, None], np.nan, measures)
        with self._one_thread():
            self._learn(self._space.points(self._asked), finite, measures)
        self._count(fitness, **self._numbers())

    def state(self) -> dict[str, Any]:
        """Return the number of generations; ``restore`` repeats them."""
        return {"generation": self.generation}

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:
        """Ask and tell all generations again.

        Raises:
            ConfigError: it proposes another number of candidates than were told, or fewer
                generations were told.
        """
        recorded = islice(told, state["generation"])
        for generation, (genomes, fitness, measures) in enumerate(recorded):
            proposed = self.ask()
            if len(proposed) != len(genomes):
                raise ConfigError(
                    f"optimizer: generation {generation + 1} was recorded with {len(genomes)} "
                    f"candidates, and this program proposes {len(proposed)}: resume with the "
                    "versions of the packages with which the run began"
                )
            if self.diverged is None and proposed != list(genomes):
                self.diverged = generation
            self._asked = list(genomes)
            self.tell(fitness, measures)
        if self.generation != state["generation"]:
            raise ConfigError(
                f"optimizer: {self.generation} generations are recorded; its state is of "
                f"{state['generation']}"
            )

    @contextlib.contextmanager
    def _one_thread(self) -> Iterator[None]:
        """Limit linear algebra to one thread.

        The limit is global, so other threads of this program that need it wait.
        """
        with _limiting, self._libraries.limit(limits=1, user_api="blas"):
            yield

    @cached_property
    def _libraries(self) -> Any:
        """Return the linear algebra libraries that the first ask has loaded."""
        return self._threads.ThreadpoolController()


def default_population(given: int, genes: int) -> int:
    """Return the population of an evolution strategy, given that of its settings.

    Raises:
        ConfigError: it is too small to learn a covariance.
    """
    least = 4
    if 0 < given < least:
        raise setting_error("population", f"expected 0, or at least {least}, not {given}")
    return given or least + math.floor(3 * math.log(genes))
