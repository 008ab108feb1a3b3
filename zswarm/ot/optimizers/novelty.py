"""Novelty search: breeds for what none did before.

After J. Lehman, K. Stanley, "Abandoning Objectives: Evolution Through the Search for Novelty Alone", Evolutionary Computation
19(2), 2011. Individuals are bred for doing something new, not for fitness. What one does are *measures*: metrics of the simulator
that the experiment names. This finds a way where better fitness leads into a dead end.

As in FREVO's ``NoveltySearch`` (github.com/smartgrids-aau/Frevo, version 1.5), which follows the authors' program: tournaments of
two, mutants and children, an archive of what was novel, and a threshold for it that rises by a fifth when more than four enter in
a generation and falls by a twentieth when none did in ten.
Mended:
- children join the population (there they never do): of these and their parents the most novel stay, as it is done today;
- most children are mutants, and all genes of a mutant change (there three tenths, and a tenth): else, with children in the
  population, it draws together;
- an individual is no neighbour of itself;
- the first threshold, unless it is set, is the mean novelty of the first generation in which not all failed or did the same
  (there 6.0, whatever the unit), and it has no lowest value (there 0.25).
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.errors import ConfigError
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.ot.optimizers.tally import Tally, mean

MANY, RAISE = 4, 1.2  # more than so many in a generation raise the threshold to this times what it was
PATIENCE, LOWER = 10, 0.95  # so many generations without one lower it

Share = Annotated[float, Meta(ge=0, le=1)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "novelty"``."""

    measures: Annotated[
        list[str], Meta(description="metrics of the simulator that say what an individual does; at least one")
    ] = []
    population: Annotated[int, Meta(ge=2, le=100_000, description="individuals, and children of a generation")] = 100
    neighbours: Annotated[int, Meta(ge=1, le=100_000, description="nearest others whose mean distance is novelty")] = 15
    threshold: Annotated[
        float, Meta(ge=0, le=1e9, description="novelty at which an individual enters the archive, at first; 0: the mean")
    ] = 0.0
    fitness: Annotated[Share, Meta(description="weight of fitness beside novelty, each scaled to 0..1; 0: novelty alone")] = 0.0
    mutation: Annotated[Share, Meta(description="share of mutants; the others are children of two")] = 0.7
    mutation_method: Annotated[
        Literal[1, 2],
        Meta(description="1: absolute, plus or minus `severity` times the range; 2: relative to the gene"),
    ] = 1
    severity: Annotated[float, Meta(gt=0, le=1e6, description="of method 1")] = 0.3
    probability: Annotated[float, Meta(gt=0, le=1, description="that a gene of a mutant changes")] = 1.0


class Novelty(Optimizer):
    """Novelty search: breeds for what none did before, as metrics of the simulator tell it; where fitness misleads.

    Statistics: best, mean, evaluations; ``novelty``, the mean of the population; ``archive``, behaviours kept; ``threshold``,
    the novelty that the next ones must exceed.
    """

    settings_type = Settings
    portable = True
    settings: Settings

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        if not settings.measures:
            raise ConfigError("optimizer: measures: expected the names of metrics that say what an individual does")
        self.candidates = settings.population
        self.measures = settings.measures
        self._tally = Tally()
        self._children: list[bytes] = []
        self._genomes: list[bytes] = []  # the population, best first
        self._fitness = np.empty(0)
        self._behaviours = np.empty((0, len(settings.measures)))
        self._archive = self._behaviours
        self._threshold = settings.threshold
        self._idle = 0  # generations since one entered the archive

    def _ask(self) -> list[bytes]:
        stream = Stream(derive_seed(self.seed, "novelty", self.generation))
        count = self.settings.population
        if self.generation == 0:
            self._children = self.representation.random(count, stream)
        else:
            mutants = int((stream.uniform(0.0, 1.0, count) < self.settings.mutation).sum())
            self._children = self.representation.mutate(
                [self._genomes[self._selected(stream)] for _ in range(mutants)],
                stream,
                method=self.settings.mutation_method,
                severity=self.settings.severity,
                probability=self.settings.probability,
            )
            for _ in range(count - mutants):
                mother, father = self._genomes[self._selected(stream)], self._genomes[self._selected(stream)]
                self._children.append(self.representation.crossover(mother, father, stream))
        return self._children

    def _selected(self, stream: Stream) -> int:
        """The better of two; the population is in order."""
        return min(stream.integer(len(self._genomes)), stream.integer(len(self._genomes)))

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:
        settings = self.settings
        genomes, told = self._genomes + self._children, np.concatenate([self._fitness, fitness])
        behaviours = np.vstack([self._behaviours, measures])
        novelty = self._novelty(behaviours)
        score = (1.0 - settings.fitness) * _scaled(novelty) + settings.fitness * _scaled(told) if settings.fitness else novelty
        kept = np.argsort(-score, kind="stable")[: settings.population]  # NaN last, ties by index
        self._genomes, self._fitness, self._behaviours = [genomes[index] for index in kept], told[kept], behaviours[kept]
        self._extend_archive(measures, novelty[-len(measures) :])
        known = novelty[kept]
        numbers = {
            "novelty": mean(known[~np.isnan(known)]),
            "archive": float(len(self._archive)),
            "threshold": self._threshold,
        }
        self._tally.add(self._children, fitness, numbers)

    def _novelty(self, behaviours: np.ndarray) -> np.ndarray:
        """(behaviours,): sparseness, NaN of one that is not known.

        The paper's equation (1): the mean distance to the nearest others of these and of the archive.
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
        squares[np.arange(len(known)), np.arange(len(known))] = -1.0  # itself comes first
        distances = np.sqrt(np.sort(squares, axis=1)[:, 1 : nearest + 1])
        sparseness[known] = np.cumsum(distances, axis=1)[:, -1] / nearest
        return sparseness

    def _extend_archive(self, measures: np.ndarray, novelty: np.ndarray) -> None:
        """With the new ones above the threshold, which follows how many these are."""
        known = novelty[~np.isnan(novelty)]
        if self._threshold == 0.0 and known.size:
            self._threshold = mean(known)
        entering = novelty > self._threshold  # NaN is not
        self._archive = np.vstack([self._archive, measures[entering]])
        self._idle = 0 if entering.any() else self._idle + 1
        if int(entering.sum()) > MANY:
            self._threshold *= RAISE
        if self._idle == PATIENCE:
            self._threshold *= LOWER
            self._idle = 0

    def state(self) -> dict[str, Any]:
        """See ``Optimizer.state``."""
        return {
            "generation": self.generation,
            "tally": self._tally.state(),
            "genomes": self._genomes,
            "fitness": self._fitness.tolist(),
            "behaviours": self._behaviours.tobytes(),
            "archive": self._archive.tobytes(),
            "threshold": self._threshold,
            "idle": self._idle,
        }

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:  # noqa: ARG002  the state is all
        """See ``Optimizer.restore``."""
        self.generation = state["generation"]
        self._tally = Tally(**state["tally"])
        self._genomes, self._fitness = list(state["genomes"]), np.array(state["fitness"])
        self._behaviours, self._archive = (
            np.frombuffer(state[name], np.float64).reshape(-1, len(self.measures)) for name in ("behaviours", "archive")
        )
        self._threshold, self._idle = state["threshold"], state["idle"]

    def best(self) -> tuple[bytes, float]:
        """See ``Optimizer.best``."""
        return self._tally.best()

    def statistics(self) -> dict[str, float]:
        """See the class."""
        return dict(self._tally.statistics)


def _scaled(values: np.ndarray) -> np.ndarray:
    """To 0..1, NaN stays."""
    known = values[np.isfinite(values)]
    low, high = (known.min(), known.max()) if known.size else (0.0, 0.0)
    return (values - low) / (high - low) if high > low else np.where(np.isnan(values), np.nan, 0.0)
