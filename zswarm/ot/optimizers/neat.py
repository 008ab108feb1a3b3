"""NEAT: networks grow, and species protect what is new.

Source: K. O. Stanley, R. Miikkulainen, "Evolving Neural Networks through Augmenting Topologies",
Evolutionary Computation 10(2), 2002. Genomes, mutations, crossover and distance are those of the
representation ``neat``. A generation:

1. Species (section 3.3): each individual joins the first species to whose representative it is
   nearer than the threshold, or founds one. The representative is a random individual of the
   species in the previous generation.
2. Fitness sharing (section 3.3): a species gets offspring in proportion to its mean fitness.
3. Only the best of each species have offspring, which replace the whole population. Of a species
   with more than ``elite_size`` individuals the best one stays as it is.
4. A species that did not improve for ``stagnation`` generations has no offspring. If the population
   did not improve for ``population_stagnation``, only the two best species have any.

What the paper leaves open: docs/optimizers.md.
"""

from typing import Annotated, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, above, within
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import mean
from zswarm.nets.neat import Neat
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers import breeding
from zswarm.ot.optimizers.base import BaseOptimizer
from zswarm.ot.optimizers.breeding import Individual, Population, Probability, Share

# Fitness is scaled by this: differences and sums stay finite, in the same proportions.
SMALL = 2.0**-64

Generations = Annotated[int, Meta(ge=1, le=1_000_000_000)]


class NeatSettings(PartSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "neat"``; the paper's numbers (section 4.1)."""

    population: Annotated[Population, about("individuals of a generation")] = 150
    threshold: Annotated[
        float, above(0, 1e6, "first distance at which another species begins")
    ] = 3.0
    species: Annotated[
        int, within(0, 1_000_000, "species that the threshold aims at; 0: none")
    ] = 10
    threshold_step: Annotated[
        float, above(0, 10, "share by which it moves in a generation")
    ] = 0.1
    survival: Annotated[
        float, above(0, 1, "share of a species, the best, that has offspring")
    ] = 0.2
    elite_size: Annotated[
        int, within(1, 1_000_000, "larger species keep their best one")
    ] = 5
    crossover: Annotated[
        Share, about("share of offspring with two parents; rest: mutants")
    ] = 0.75
    unmutated: Annotated[Share, about("share of unmutated children of two parents")] = 0.2
    interspecies: Annotated[Share, about("chance of a parent from another species")] = (
        0.001
    )
    stagnation: Annotated[
        Generations, about("generations until a stagnant species ends")
    ] = 15
    population_stagnation: Annotated[
        Generations, about("the same for the population: all but two species end")
    ] = 20
    severity: Annotated[float, above(0, 1e6, "maximum change of a number, in ranges")] = (
        0.3
    )
    probability: Probability = 1.0


class Species(msgspec.Struct):
    """Similar individuals; after a tell they are ranked, best first."""

    representative: bytes
    members: list[Individual] = []
    best: float = float("-inf")  # fitness of all generations
    improved: int = 0  # generation of the best fitness

    def shared(self, worst: float) -> float:
        """Return the mean fitness above the worst, scaled (eq. 2)."""
        total = 0.0
        for member in self.members:
            if member.fitness == member.fitness:
                total += member.fitness * SMALL - worst
        return total / len(self.members)


class NEAT(BaseOptimizer):
    """Networks grow from inputs and outputs alone, in species that share their fitness.

    Needs the representation neat. Portable: yes. With fresh seeds elites are evaluated again.
    """

    settings_type = NeatSettings
    competes = True
    stored = ("threshold", "species", "improved")
    types: ClassVar = {"species": list[Species]}
    settings: NeatSettings
    representation: Neat

    def __init__(
        self, settings: NeatSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        if not isinstance(representation, Neat):
            text = "neat evolves networks of representation neat"
            raise ConfigError(f"optimizer: {text}; others have no innovation numbers")
        self.candidates = settings.population
        self._threshold = settings.threshold
        self._species: list[Species] = []  # of the last evaluated generation
        self._population: list[Individual] = []  # of the generation asked for
        self._founded: list[Species] = []  # species that it may join
        self._improved = 0  # generation of the best fitness

    def _ask(self) -> list[bytes]:
        stream = self._stream("neat")
        if self._species:
            self._founded = []
            for species in self._species:
                genome = species.members[stream.integer(len(species.members))].genome
                self._founded.append(Species(genome, [], species.best, species.improved))
            self._population = self._offspring(stream)
        else:
            genomes = self.representation.random(self.settings.population, stream)
            self._population = [Individual(genome) for genome in genomes]
        return breeding.unevaluated(self._population)

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  unused
        settings, best_before = self.settings, self._best
        breeding.set_fitness(self._population, fitness)
        self._count(fitness)
        if self._best != best_before and not self._best[1] <= best_before[1]:
            self._improved = self.generation
        self._species = self._speciated()
        for species in self._species:
            # The sort is stable: ties stay in order.
            species.members.sort(key=lambda member: member.rank)
            best = species.members[0].fitness
            if best > species.best:
                species.best, species.improved = best, self.generation
        if settings.species and len(self._species) > settings.species:
            self._threshold *= 1.0 + settings.threshold_step
        elif len(self._species) < settings.species:
            self._threshold /= 1.0 + settings.threshold_step

    # ---- species

    def _speciated(self) -> list[Species]:
        """Put each individual into the first species near enough, or into a new one."""
        genomes = breeding.genomes(self._population)
        species = list(self._founded)
        distances = self.representation.distances(
            [kind.representative for kind in species], genomes
        )
        near = list(distances < self._threshold)
        for index, individual in enumerate(self._population):
            at = next((at for at, row in enumerate(near) if row[index]), len(species))
            if at == len(species):
                species.append(Species(individual.genome, improved=self.generation))
                distances = self.representation.distances([individual.genome], genomes)
                near.extend(distances < self._threshold)
            species[at].members.append(individual)
        return [kind for kind in species if kind.members]

    def _counts(self) -> list[int]:
        """Return the offspring of each species in proportion to its mean fitness (section 3.3)."""
        members = [member for kind in self._species for member in kind.members]
        known = [
            member.fitness * SMALL
            for member in members
            if member.fitness == member.fitness
        ]
        worst = min(known, default=0.0)
        allowed = np.isin(np.arange(len(self._species)), list(self._allowed()))
        shares = np.where(allowed, [kind.shared(worst) for kind in self._species], 0.0)
        if not shares.any():
            shares = np.where(allowed, [len(kind.members) for kind in self._species], 0.0)
        return _rounded(shares.tolist(), self.settings.population)

    def _allowed(self) -> set[int]:
        """Return the species that may have offspring: those that do not stagnate."""
        count = len(self._species)
        best = [species.members[0] for species in self._species]
        order = sorted(range(count), key=lambda index: best[index].rank)
        if self.relative:
            return set(order)
        last = self.generation - 1
        if last - self._improved >= self.settings.population_stagnation:
            return set(order[:2])
        limit = last - self.settings.stagnation
        return {order[0]} | {
            index for index in order if self._species[index].improved > limit
        }

    # ---- offspring

    def _offspring(self, stream: Stream) -> list[Individual]:
        """Return the next population; elites are evaluated already unless fitness is relative."""
        population: list[Individual] = []
        for index, count in enumerate(self._counts()):
            members, end = self._species[index].members, len(population) + count
            if count and len(members) > self.settings.elite_size:
                population.append(msgspec.structs.replace(members[0], operator="elite"))
                population[-1].evaluated = not (self.relative or self.fresh)
            while len(population) < end:
                population.append(self._child(index, stream))
        mutated = [child for child in population if child.operator == "mutation"]
        genomes = self.representation.mutate(
            breeding.genomes(mutated),
            stream,
            method=1,
            severity=self.settings.severity,
            probability=self.settings.probability,
        )
        for child, genome in zip(mutated, genomes, strict=True):
            child.genome = genome
        return population

    def _child(self, index: int, stream: Stream) -> Individual:
        """Return a child of a species; its operator is "mutation" if it is to be mutated."""
        settings, members = self.settings, self._species[index].members
        survivors = members[: int(settings.survival * len(members)) + 1]
        two, unmutated, strange = stream.uniform(0.0, 1.0, 3)
        parent = survivors[stream.integer(len(survivors))]
        if two >= settings.crossover:
            return Individual(parent.genome, "mutation")
        mate = survivors[stream.integer(len(survivors))]
        if strange < settings.interspecies and len(self._species) > 1:
            other = stream.integer(len(self._species) - 1)
            mate = self._species[other + (other >= index)].members[0]
        fitter, weaker = sorted(
            (parent, mate), key=lambda one: (*one.rank, len(one.genome))
        )
        genome = self.representation.crossover(fitter.genome, weaker.genome, stream)
        mutates = unmutated >= settings.unmutated or mate is parent
        return Individual(genome, "mutation" if mutates else "crossover")

    # ---- statistics

    def statistics(self) -> dict[str, float]:
        """Return best and mean fitness, evaluations, species, and sizes of networks.

        ``threshold`` is that of the next generation. ``hidden_`` and ``links_`` count hidden
        neurons and enabled links: the mean of all individuals, and those of the best so far.
        """
        structure = self.representation.structure
        population = [member for kind in self._species for member in kind.members]
        hidden, links = np.array([structure(member.genome) for member in population]).T
        (best, _), nan = self._best, float("nan")
        hidden_best, links_best = structure(best) if best else (nan, nan)
        return {
            **self._statistics,
            "mean": breeding.mean_fitness(population),
            "species": float(len(self._species)),
            "species_largest": float(max(len(kind.members) for kind in self._species)),
            "threshold": self._threshold,
            "hidden_mean": mean(hidden),
            "links_mean": mean(links),
            "hidden_best": float(hidden_best),
            "links_best": float(links_best),
        }


def _rounded(shares: list[float], count: int) -> list[int]:
    """Return whole numbers in these proportions whose sum is the count.

    Fractions are rounded down; the rest goes to the largest fractions, the first of equals.
    """
    total = 0.0
    for share in shares:
        total += share
    exact = [count * (share / total) for share in shares]
    counts = [int(number) for number in exact]
    largest = sorted(range(len(shares)), key=lambda index: counts[index] - exact[index])
    for index in largest[: count - int(sum(counts))]:
        counts[index] += 1
    return counts
