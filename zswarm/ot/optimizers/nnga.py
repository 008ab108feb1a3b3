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

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator
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
PARENTS = 2 + SUITORS  # random words by which the parents of a child are chosen
AGAIN = 16  # children prepared at once after rejections
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
            _rank(island)
            elite += [
                individual.operator for individual in island[: self.counts["elite"]]
            ]
        counts, best = Counter(created), Counter(elite)
        numbers = {f"count_{name}": float(counts[name]) for name in OPERATORS}
        for name in OPERATORS:
            numbers[f"effectivity_{name}"] = best[name] / max(1, counts[name])
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
        """Return children that do not exist yet; too many that do end it."""
        children: list[bytes] = []
        repeats = REPEATS
        wanted = self.counts["crossover"]
        proposed = self._children(mothers, islands, stream)
        while len(children) < wanted:
            child = next(proposed)
            if child not in existing:
                existing.add(child)
                children.append(child)
            elif repeats:
                repeats -= 1
            else:
                break
        return children

    def _children(
        self, mothers: list[bytes], islands: list[list[bytes]], stream: Stream
    ) -> Iterator[bytes]:
        """Yield children of random mothers with the most different of eleven random fathers.

        The words of the stream are those of one child after the other: mother, island, fathers, and
        what the crossover draws. Parents are chosen for many children at once, as long as each
        crossover draws the expected words.
        """
        pool = [*mothers, *itertools.chain.from_iterable(islands)]
        draws, count = self.representation.crossover_draws, self.counts["crossover"]
        words = PARENTS + (draws or 0)
        while True:
            begin = stream.position
            ahead = Stream(stream.seed, begin).words(count * words).reshape(-1, words)
            bounds = np.full(
                PARENTS, len(mothers), np.uint64
            )  # islands have equally many
            bounds[1] = len(islands)
            drawn = _integers(ahead[: None if draws else 1, :PARENTS], bounds)
            suitors = drawn[:, 2:] + (1 + drawn[:, 1:2]) * len(mothers)
            # Only of these: among all survivors there are too many in a large population.
            distances = self.representation.distances_between(pool, drawn[:, 0], suitors)
            # The first of equals.
            farthest = distances.argmax(axis=1)[:, None]
            fathers = np.take_along_axis(suitors, farthest, axis=1)[:, 0]
            for mother, father in zip(
                drawn[:, 0].tolist(), fathers.tolist(), strict=True
            ):
                stream.position = begin + PARENTS
                begin += words
                yield self.representation.crossover(pool[mother], pool[father], stream)
                if stream.position != begin:
                    break
            count = AGAIN

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


def _integers(words: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Return integers below the bounds of the columns, as ``Stream.integers`` makes them."""
    shift = np.uint64(32)
    below: np.ndarray = ((words >> shift) * bounds) >> shift
    return below.astype(np.int64)


def _rank(individuals: list[Individual]) -> None:
    """Sort, the best first, NaN last; ties stay in order."""
    fitness = np.array([individual.fitness for individual in individuals])
    order = np.argsort(-fitness, kind="stable")
    individuals[:] = [individuals[index] for index in order.tolist()]


def _triangular_offset(rest: int, stream: Stream) -> int:
    """Return |a + b - (rest - 1)| for random a < rest and b < rest - 1.

    Small offsets are likely, 0 has half the weight, ``rest`` never occurs.
    """
    if rest < 2:
        return 0
    return abs(stream.integer(rest) + stream.integer(rest - 1) - (rest - 1))
