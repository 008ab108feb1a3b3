"""Settings and individuals of optimizers that breed genomes with operators."""

from collections.abc import Iterable, Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, above
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import mean
from zswarm.nets.representation import Representation

Share = Annotated[float, Meta(ge=0, le=1)]
Population = Annotated[int, Meta(ge=2, le=1_000_000)]
Probability = Annotated[float, above(0, 1, "chance that a gene of a mutant changes")]

MOST = 250  # individuals compared: comparing 1,000 long genomes took longer than evaluating them
STRIP = 24  # individuals compared at once with those after them; more would compute more in vain


class MutationSettings(PartSettings, frozen=True, kw_only=True):
    """The last settings of an optimizer that mutates."""

    mutation_method: Annotated[
        Literal[1, 2],
        about("1: absolute, ± `severity` times the range; 2: relative, as in FREVO"),
    ] = 1
    severity: Annotated[float, above(0, 1e6, "strength of mutation method 1")] = 0.3
    probability: Probability = 1.0


class Individual(msgspec.Struct):
    """A genome, the operator that made it, and its fitness once evaluated."""

    genome: bytes
    operator: str = "renew"
    fitness: float = float("nan")
    evaluated: bool = False

    @property
    def rank(self) -> tuple[bool, float]:
        """Return a key that sorts the best first and NaN last."""
        failed = self.fitness != self.fitness
        return failed, 0.0 if failed else -self.fitness


def genomes(individuals: Iterable[Individual]) -> list[bytes]:
    """Return the genomes of individuals, in their order."""
    return [individual.genome for individual in individuals]


def unevaluated(individuals: Iterable[Individual]) -> list[bytes]:
    """Return the genomes of individuals without a fitness, in their order."""
    return genomes(individual for individual in individuals if not individual.evaluated)


def set_fitness(individuals: Iterable[Individual], fitness: np.ndarray) -> None:
    """Give the individuals without a fitness theirs, in their order."""
    waiting = [individual for individual in individuals if not individual.evaluated]
    for individual, value in zip(waiting, fitness.tolist(), strict=True):
        individual.fitness, individual.evaluated = value, True


def mean_fitness(individuals: Iterable[Individual]) -> float:
    """Return the mean fitness of the individuals that did not fail; NaN if there are none."""
    return mean(np.array([individual.fitness for individual in individuals]))


def mutants(
    representation: Representation,
    parents: Sequence[bytes],
    stream: Stream,
    settings: MutationSettings,
) -> list[bytes]:
    """Return a mutant of each parent."""
    return representation.mutate(
        parents,
        stream,
        method=settings.mutation_method,
        severity=settings.severity,
        probability=settings.probability,
    )


def distances_of_pairs(
    representation: Representation, compared: Sequence[bytes]
) -> np.ndarray:
    """Return (pairs,) float64: distances of each individual to those after it, in their order.

    Of more than 250 individuals, 250 are compared, evenly spaced.
    """
    if len(compared) > MOST:
        compared = [compared[index * len(compared) // MOST] for index in range(MOST)]
    pairs = []
    for begin in range(0, len(compared), STRIP):
        strip, others = compared[begin : begin + STRIP], compared[begin:]
        after = ~np.tri(len(strip), len(others), dtype=bool)
        pairs.append(representation.distances(strip, others)[after])
    return np.concatenate(pairs)
