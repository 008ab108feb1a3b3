"""Novelty search: individuals are bred for new behaviour instead of fitness.

Source: J. Lehman, K. Stanley, "Abandoning Objectives: Evolution Through the Search for Novelty
Alone", Evolutionary Computation 19(2), 2011. Behaviour is *measures*: metrics of the simulator that
the experiment names. As in FREVO's ``NoveltySearch``, which follows the authors' program:
tournaments of two, mutants and children, an archive, and a threshold that adapts. Maths, and what
differs from FREVO: docs/optimizers.md.
"""

from typing import Annotated

import numpy as np
from msgspec import field

from zswarm.config.meta import about, within
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import mean
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.base import BaseOptimizer, Measures, check_measures
from zswarm.ot.optimizers.breeding import MutationSettings, Share, mutants

# More new entries of the archive in a generation raise the threshold.
MANY, RAISE = 4, 1.2
PATIENCE, LOWER = 10, 0.95  # this many generations without an entry lower it


class NoveltySettings(MutationSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "novelty"``."""

    measures: Measures = field(default_factory=list)
    population: Annotated[
        int, within(2, 100_000, "individuals, and children of a generation")
    ] = 100
    neighbours: Annotated[
        int, within(1, 100_000, "nearest others; novelty is their mean distance")
    ] = 15
    threshold: Annotated[
        float, within(0, 1e9, "first novelty for the archive; 0: the mean")
    ] = 0.0
    fitness: Annotated[
        Share, about("weight of fitness against novelty, each scaled to 0..1")
    ] = 0.0
    mutation: Annotated[Share, about("share of mutants; the others have two parents")] = (
        0.7
    )


class Novelty(BaseOptimizer):
    """Novelty search: breeds for behaviour that is new, as metrics describe it.

    For tasks where fitness misleads. With fresh seeds the population is evaluated again.

    Statistics: best, mean, evaluations; ``novelty``, the mean of
    the population; ``archive``, its behaviours; ``threshold``, the novelty that enters it.
    """

    settings_type = NoveltySettings
    stored = ("genomes", "fitness", "behaviours", "archive", "threshold", "idle")
    settings: NoveltySettings

    def __init__(
        self, settings: NoveltySettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        check_measures(settings.measures)
        self.candidates = settings.population
        self.measures = settings.measures
        self._genomes: list[bytes] = []  # the population, best first
        self._fitness = np.empty(0)
        self._behaviours = np.empty((0, len(settings.measures)))
        self._archive = self._behaviours
        self._threshold = settings.threshold
        self._idle = 0  # generations since an entry of the archive

    def use_fresh_seeds(self) -> None:
        """See ``Optimizer``: the population is evaluated again; the archive has no genomes."""
        super().use_fresh_seeds()
        self.candidates = 2 * self.settings.population

    def _ask(self) -> list[bytes]:
        stream = self._stream("novelty")
        count = self.settings.population
        if self.generation == 0:
            return self.representation.random(count, stream)
        mutated = int((stream.uniform(0.0, 1.0, count) < self.settings.mutation).sum())
        parents = [self._selected(stream) for _ in range(mutated)]
        children = mutants(self.representation, parents, stream, self.settings)
        for _ in range(count - mutated):
            mother, father = self._selected(stream), self._selected(stream)
            children.append(self.representation.crossover(mother, father, stream))
        return children + self._genomes if self.fresh else children

    def _selected(self, stream: Stream) -> bytes:
        """Return the better of two random individuals."""
        count = len(self._genomes)
        return self._genomes[min(stream.integer(count), stream.integer(count))]

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:
        weight = self.settings.fitness
        everything, born = fitness, self.settings.population
        if len(fitness) > born:  # and of the population again
            self._fitness, self._behaviours = fitness[born:], measures[born:]
            fitness, measures = fitness[:born], measures[:born]
        genomes = self._genomes + self._asked[:born]
        fitnesses = np.concatenate([self._fitness, fitness])
        behaviours = np.vstack([self._behaviours, measures])
        novelty = self._novelty(behaviours)
        score = novelty
        if weight:
            score = (1.0 - weight) * _scaled(novelty) + weight * _scaled(fitnesses)
        # NaN last, ties by index.
        chosen = np.argsort(-score, kind="stable")[: self.settings.population]
        self._genomes = [genomes[index] for index in chosen]
        self._fitness, self._behaviours = fitnesses[chosen], behaviours[chosen]
        self._extend_archive(measures, novelty[-len(measures) :])
        self._count(
            everything,
            novelty=mean(novelty[chosen]),
            archive=float(len(self._archive)),
            threshold=self._threshold,
        )

    def _novelty(self, behaviours: np.ndarray) -> np.ndarray:
        """Return (behaviours,): sparseness, NaN for an unknown behaviour.

        That is the mean distance to the nearest other ones of these and of the archive.
        """
        sparseness = np.full(len(behaviours), np.nan)
        known = np.flatnonzero(np.isfinite(behaviours).all(axis=1))
        others = np.vstack([behaviours[known], self._archive])
        nearest = min(self.settings.neighbours, len(others) - 1)
        if nearest < 1:
            return sparseness
        squares = np.zeros((len(known), len(others)))
        for column in range(behaviours.shape[1]):
            difference = behaviours[known, column][:, None] - others[:, column]
            squares += difference * difference
        # The individual itself is no neighbour.
        squares[np.arange(len(known)), np.arange(len(known))] = -1.0
        distances = np.sqrt(np.sort(squares, axis=1)[:, 1 : nearest + 1])
        sparseness[known] = np.cumsum(distances, axis=1)[:, -1] / nearest  # eq. 1
        return sparseness

    def _extend_archive(self, measures: np.ndarray, novelty: np.ndarray) -> None:
        """Add the children above the threshold, and adapt it to how many they are."""
        if self._threshold == 0.0 and not np.isnan(novelty).all():
            self._threshold = mean(novelty)
        entering = novelty > self._threshold  # false for NaN
        self._archive = np.vstack([self._archive, measures[entering]])
        self._idle = 0 if entering.any() else self._idle + 1
        if int(entering.sum()) > MANY:
            self._threshold *= RAISE
        if self._idle == PATIENCE:
            self._threshold *= LOWER
            self._idle = 0


def _scaled(values: np.ndarray) -> np.ndarray:
    """Scale to 0..1; NaN stays."""
    known = values[np.isfinite(values)]
    low, high = (known.min(), known.max()) if known.size else (0.0, 0.0)
    return (
        (values - low) / (high - low)
        if high > low
        else np.where(np.isnan(values), np.nan, 0.0)
    )
