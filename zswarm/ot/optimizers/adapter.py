"""Optimizers of other packages: what asks and tells vectors becomes an optimizer of a run in ten lines.

A child makes the other package's optimizer in its constructor, gives its vectors in ``_propose`` and tells it in ``_learn``
how good they were. Vectors are in units of the ranges of the genes, so new genomes of the representation are uniform in -1..1.

Nothing of the other package is kept between two programs: its state is made again, by asking and telling it anew all that
was recorded. So it must propose the same again when it is told the same, which its seed has to see to. Where it does not,
because another processor or another version computes other bits, it is told what was recorded instead of what it would
have proposed now, and ``strayed`` says so.

Linear algebra adds in another order with another number of threads, so it gets one.
"""

import contextlib
import threading
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from itertools import islice
from typing import Any

import msgspec
import numpy as np

from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.ot.optimizers.space import Space
from zswarm.ot.optimizers.tally import Tally

_limiting = threading.Lock()
FAR = 1e9  # ranges: where a search that diverges ends


class Adapter(Optimizer):
    """An optimizer of another package; a child writes ``_propose`` and ``_learn``, and sets ``candidates``."""

    portable = False

    def __init__(self, settings: msgspec.Struct, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        self._threads = need("threadpoolctl", "cmaes", "an optimizer of another package")
        self._space = Space(representation)
        self.genes = self._space.dimensions
        self._genomes: list[bytes] = []
        self._tally = Tally()

    @abstractmethod
    def _propose(self) -> np.ndarray:
        """The next vectors: (n, genes), n at most ``candidates``; finite."""

    @abstractmethod
    def _learn(self, solutions: np.ndarray, fitness: np.ndarray, measures: np.ndarray) -> None:
        """Take what became of the vectors last proposed.

        Args:
            solutions: (n, genes) float64, the vectors as they were evaluated, which is rounded to float32.
            fitness: (n,) float64, finite, higher is better; a failed candidate has the lowest of the others, 0 where all failed.
            measures: (n, len(self.measures)) float64; a row of NaN where the candidate failed.
        """

    def _numbers(self) -> dict[str, float]:
        """What ``statistics`` tells of the generation last told, beside best, mean and evaluations."""
        return {}

    def _ask(self) -> list[bytes]:
        with self._one_thread():
            vectors = np.asarray(self._propose(), np.float64)
        if vectors.shape != (len(vectors), self.genes) or not len(vectors) or not np.isfinite(vectors).all():
            raise ValueError(f"{type(self).__name__}._propose must give (n, {self.genes}) finite numbers, not {vectors!r:.80}")
        self._genomes = self._space.genomes(np.clip(vectors, -FAR, FAR))
        return self._genomes

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:
        failed = np.isnan(fitness)
        worst = 0.0 if failed.all() else np.nanmin(fitness)
        with self._one_thread():
            self._learn(
                self._space.of(self._genomes), np.where(failed, worst, fitness), np.where(failed[:, None], np.nan, measures)
            )
        self._tally.add(self._genomes, fitness, self._numbers(), relative=self.relative)

    def state(self) -> dict[str, Any]:
        """How often it was told; the rest is in what it was told."""
        return {"generation": self.generation}

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:
        """Ask and tell all of it again.

        Raises:
            ConfigError: it proposes another number of candidates than were told, or fewer generations were told.
        """
        for generation, (genomes, fitness, measures) in enumerate(islice(told, state["generation"])):
            proposed = self.ask()
            if len(proposed) != len(genomes):
                raise ConfigError(
                    f"optimizer: generation {generation} was recorded with {len(genomes)} candidates, and this program proposes "
                    f"{len(proposed)}: go on where the run began, with the same versions of its packages"
                )
            if self.strayed is None and proposed != list(genomes):
                self.strayed = generation
            self._genomes = list(genomes)
            self.tell(fitness, measures)
        if self.generation != state["generation"]:
            raise ConfigError(f"optimizer: {self.generation} generations are recorded; its state is of {state['generation']}")

    def best(self) -> tuple[bytes, float]:
        """The first of the best."""
        return self._tally.best()

    def statistics(self) -> dict[str, float]:
        """Best and mean fitness, evaluations so far, and what the child tells."""
        return self._tally.statistics

    @contextlib.contextmanager
    def _one_thread(self) -> Iterator[None]:
        """Linear algebra on one thread. The limit is the whole program's: others that want it wait until this one is done."""
        with _limiting, self._libraries.limit(limits=1, user_api="blas"):
            yield

    @cached_property
    def _libraries(self) -> Any:
        """Those of linear algebra that are loaded by the first ask."""
        return self._threads.ThreadpoolController()
