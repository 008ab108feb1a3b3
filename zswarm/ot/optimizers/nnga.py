"""NNGA: the genetic algorithm of FREVO 1.5 (github.com/smartgrids-aau/Frevo), step by step.

A generation is ranked, best first. The next one consists of the elite; "random" survivors, drawn
with a bias to the good; mutants of survivors; crossovers of a survivor with the most different of
eleven good ones; and new random individuals. Elites and survivors keep their fitness. What differs
from FREVO: docs/optimizers.md. As there:

- survivors are drawn triangularly, each by a swap, so that a displaced individual can come back;
- fathers are the first of the ranking before those swaps;
- generation 0 counts for the exchange between islands;
- crossovers equal to an existing individual are repeated 100 times in all; the rest is random.
"""

from collections.abc import Iterable
from typing import Annotated, ClassVar

import numpy as np

from zswarm.config.meta import about, within
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import mean
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.base import BaseOptimizer
from zswarm.ot.optimizers.breeding import (
    Individual,
    MutationSettings,
    Population,
    Share,
    distances_of_pairs,
    genomes,
    mean_fitness,
    mutants,
    set_fitness,
    unevaluated,
)

REPEATS = 100  # of rejected crossovers, in a generation of one island
SUITORS = 11  # fathers to choose from
OPERATORS = ("elite", "random", "mutation", "crossover", "renew")


class NNGASettings(MutationSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "nnga"``; the rest of the shares is the elite."""

    population: Annotated[Population, about("individuals of an island")] = 50
    islands: Annotated[int, within(1, 1_000, "populations that evolve in parallel")] = 1
    exchange_interval: Annotated[
        int, within(0, 10**9, "generations between exchanges; 0: never")
    ] = 10
    random: Annotated[Share, about("share of survivors, drawn with a bias")] = 0.10
    mutation: Annotated[Share, about("share of mutated survivors")] = 0.40
    crossover: Annotated[Share, about("share of children of two survivors")] = 0.30
    renew: Annotated[Share, about("share of new random individuals")] = 0.05


class NNGA(BaseOptimizer):
    """FREVO's genetic algorithm: elite, survivors, mutants, crossovers, and new individuals.

    With fresh seeds elite and survivors are evaluated again.
    """

    settings_type = NNGASettings
    competes = True
    stored = ("islands",)
    types: ClassVar = {"islands": list[list[Individual]]}
    settings: NNGASettings

    def __init__(
        self, settings: NNGASettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        size = settings.population
        counts = {name: int(size * getattr(settings, name)) for name in OPERATORS[1:]}
        elite = size - int(sum(counts.values()))
        if elite < 1:
            raise ConfigError(
                "optimizer: random, mutation, crossover and renew leave "
                f"{elite} of {size} individuals to the elite; it needs at least 1"
            )
        if elite + counts["random"] == size:
            raise ConfigError(
                "optimizer: mutation, crossover and renew make no new individual of "
                f"{size}; expected at least one in all"
            )
        self.counts = {"elite": elite, **counts}
        self.candidates = size * settings.islands
        if settings.islands == 1:  # several are ranked one by one
            self.survivors = elite + counts["random"]
        # The last generation told, each ranked, best first.
        self._islands: list[list[Individual]] = []
        self._population: list[list[Individual]] = []  # generation asked for

    def _ask(self) -> list[bytes]:
        settings = self.settings
        stream = self._stream("nnga")
        if not self._islands:
            self._population = [
                _made("renew", self.representation.random(settings.population, stream))
                for _ in range(settings.islands)
            ]
        else:
            survivors = self.counts["elite"] + self.counts["random"]
            fathers = [genomes(island[:survivors]) for island in self._islands]
            self._population = []
            for index in range(settings.islands):
                self._population.append(self._evolve(index, fathers, stream))
                fathers[index] = genomes(self._population[index][:survivors])
        individuals = _joined(self._population)
        if self.relative or self.fresh:
            for individual in individuals:
                individual.evaluated = False
        return unevaluated(individuals)

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  unused
        individuals = _joined(self._population)
        set_fitness(individuals, fitness)
        created = [individual.operator for individual in individuals]
        elite: list[str] = []
        self._islands = self._population
        for island in self._islands:
            island.sort(key=lambda individual: individual.rank)  # ties stay in order
            elite += [
                individual.operator for individual in island[: self.counts["elite"]]
            ]
        counts = {name: created.count(name) for name in OPERATORS}
        numbers = {f"count_{name}": float(count) for name, count in counts.items()}
        for name, count in counts.items():
            numbers[f"effectivity_{name}"] = elite.count(name) / max(1, count)
        self._count(fitness, **numbers)

    def _evolve(
        self, index: int, fathers: list[list[bytes]], stream: Stream
    ) -> list[Individual]:
        """Return the next population of an island."""
        ranked = list(self._islands[index])
        size, elite = len(ranked), self.counts["elite"]
        count = elite + self.counts["random"]
        for place in range(elite, count):
            other = place + _triangular_offset(size - 1 - place, stream)
            ranked[place], ranked[other] = ranked[other], ranked[place]
        survivors = ranked[:count]
        for place, individual in enumerate(survivors):
            individual.operator = "elite" if place < elite else "random"
        mothers = genomes(survivors)
        parents = [
            mothers[parent] for parent in stream.integers(count, self.counts["mutation"])
        ]
        mutated = mutants(self.representation, parents, stream, self.settings)
        interval = self.settings.exchange_interval
        exchange = interval > 0 and (self.generation - 1) % interval == 0
        islands = fathers if exchange else [fathers[index]]
        children = self._crossovers(mothers, islands, {*mothers, *mutated}, stream)
        made = survivors + _made("mutation", mutated) + _made("crossover", children)
        return made + _made("renew", self.representation.random(size - len(made), stream))

    def _crossovers(
        self,
        mothers: list[bytes],
        islands: list[list[bytes]],
        existing: set[bytes],
        stream: Stream,
    ) -> list[bytes]:
        """Return children of random mothers with the most different of eleven random fathers."""
        children: list[bytes] = []
        repeats = REPEATS
        while len(children) < self.counts["crossover"]:
            mother, island = stream.integer(len(mothers)), stream.integer(len(islands))
            fathers = islands[island]
            suitors = [fathers[stream.integer(len(fathers))] for _ in range(SUITORS)]
            # Only of these: among all survivors there are too many in a large population.
            (distances,) = self.representation.distances([mothers[mother]], suitors)
            # The first of equals.
            father = suitors[int(distances.argmax())]
            child = self.representation.crossover(mothers[mother], father, stream)
            if child not in existing:
                existing.add(child)
                children.append(child)
            elif repeats:
                repeats -= 1
            else:
                break
        return children

    def statistics(self) -> dict[str, float]:
        """Return best and mean fitness, evaluations, diversity, and operators' results.

        Diversity is the distance of two individuals of an island, over all pairs of at most 250.
        Effectivity is the share of an operator's individuals that reached the elite.
        """
        pairs = np.concatenate(
            [
                distances_of_pairs(self.representation, genomes(island))
                for island in self._islands
            ]
        )
        centre = mean(pairs)
        return {
            "best": self._best[1],
            "mean": mean_fitness(_joined(self._islands)),
            "evaluations": float(self._evaluations),
            "diversity_mean": centre,
            "diversity_max": float(pairs.max()),
            "diversity_min": float(pairs.min()),
            "diversity_deviation": float(np.sqrt(mean((pairs - centre) ** 2))),
            **{name: self._statistics[name] for name in self._statistics if "_" in name},
        }


def _joined(islands: Iterable[list[Individual]]) -> list[Individual]:
    return [individual for island in islands for individual in island]


def _made(operator: str, made: Iterable[bytes]) -> list[Individual]:
    return [Individual(genome, operator) for genome in made]


def _triangular_offset(rest: int, stream: Stream) -> int:
    """Return |a + b - (rest - 1)| for random a < rest and b < rest - 1.

    Small offsets are likely, 0 has half the weight, ``rest`` never occurs.
    """
    if rest < 2:
        return 0
    return abs(stream.integer(rest) + stream.integer(rest - 1) - (rest - 1))
