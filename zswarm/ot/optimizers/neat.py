"""NEAT: networks grow, and species protect what is new.

Source: K. O. Stanley, R. Miikkulainen, "Evolving Neural Networks through Augmenting Topologies", Evolutionary Computation
10(2), 2002. The genomes, their mutations, crossover and distance are those of the representation ``neat``. A generation:

1. Species (section 3.3): each individual joins the first species of whose representative it is nearer than the threshold, or
   founds one. The representative is a random individual that the species had in the generation before.
2. Fitness sharing (section 3.3, equation 2): an individual's fitness is divided by the number of its species, so that a
   species gets offspring as its mean fitness is.
3. Each species loses all but its best, and these have the offspring, which replace the whole population. Of a species with
   more than ``elite_size`` individuals the best one stays as it is.
4. A species that got no better for ``stagnation`` generations has no offspring; if the population got no better for
   ``population_stagnation``, the two best species have all.

Where the paper leaves something open: fitness is counted from the generation's worst, for shares must not be negative. The
species of the best individual may always go on. The threshold rises or falls by ``threshold_step`` after a generation with
more or fewer than ``species`` species. Fractions of offspring are rounded down and the rest goes to the largest fractions.
Of two parents of equal fitness the shorter genome passes for the fitter one, as in FREVO's ``NEAT``. Where fitness compares
within a generation only, nothing is known about getting better, so stagnation does not count.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.errors import ConfigError
from zswarm.nets.neat import Neat
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told

SMALL = 2.0**-64  # times any fitness: differences and sums of such are finite, and in the same proportions

Share = Annotated[float, Meta(ge=0, le=1)]
Generations = Annotated[int, Meta(ge=1, le=1_000_000_000)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "neat"``; the numbers of the paper's section 4.1 where it has any."""

    population: Annotated[int, Meta(ge=2, le=1_000_000, description="individuals of a generation")] = 150
    threshold: Annotated[float, Meta(gt=0, le=1e6, description="distance at which another species begins, at first")] = 3.0
    species: Annotated[
        int, Meta(ge=0, le=1_000_000, description="species that the threshold is moved towards; 0: it stays as it is")
    ] = 10
    threshold_step: Annotated[float, Meta(gt=0, le=10, description="share by which it moves in a generation")] = 0.1
    survival: Annotated[float, Meta(gt=0, le=1, description="share of a species, the best, that has offspring")] = 0.2
    elite_size: Annotated[
        int, Meta(ge=1, le=1_000_000, description="a species of more individuals keeps its best one unchanged")
    ] = 5
    crossover: Annotated[Share, Meta(description="share of offspring with two parents; the others are mutants of one")] = 0.75
    unmutated: Annotated[Share, Meta(description="share of children of two parents that are not mutated as well")] = 0.2
    interspecies: Annotated[Share, Meta(description="chance that the other parent is the best of any other species")] = 0.001
    stagnation: Annotated[Generations, Meta(description="after so many without a better fitness a species has no offspring")] = 15
    population_stagnation: Annotated[
        Generations, Meta(description="after so many without a better fitness at all only the two best species have any")
    ] = 20
    severity: Annotated[float, Meta(gt=0, le=1e6, description="how far a number moves at most, in ranges")] = 0.3
    probability: Annotated[float, Meta(gt=0, le=1, description="that a number of a mutant changes")] = 1.0


class Individual(msgspec.Struct):
    """A genome, and its fitness once told."""

    genome: bytes
    fitness: float = float("nan")
    told: bool = False


class Species(msgspec.Struct):
    """Individuals that are alike; those after a tell are ranked, best first."""

    representative: bytes
    members: list[Individual] = []
    best: float = float("-inf")  # fitness, ever
    improved: int = 0  # in that generation


class NEAT(Optimizer):
    """Networks grow from none but inputs and outputs, in species that share their fitness: needs representation neat.

    Portable: yes. Every generation draws from a stream of its own.
    """

    settings_type = Settings
    portable = True
    competes = True
    settings: Settings
    representation: Neat

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        if not isinstance(representation, Neat):
            raise ConfigError("optimizer: neat evolves networks of representation neat; others have no innovation numbers")
        self.candidates = settings.population
        self._threshold = settings.threshold
        self._species: list[Species] = []  # of the last generation told
        self._population: list[Individual] = []  # of the generation asked for
        self._founded: list[Species] = []  # the species that it may join
        self._best = (b"", float("-inf"))
        self._improved = 0  # in that generation
        self._evaluations = 0

    def _ask(self) -> list[bytes]:
        stream = Stream(derive_seed(self.seed, "neat", self.generation))
        if self._species:
            self._founded = [
                Species(species.members[stream.integer(len(species.members))].genome, [], species.best, species.improved)
                for species in self._species
            ]
            self._population = self._offspring(stream)
        else:
            self._population = [Individual(genome) for genome in self.representation.random(self.settings.population, stream)]
        return [individual.genome for individual in self._population if not individual.told]

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  it wants none
        if self.relative:
            self._best = (b"", float("-inf"))
        untold = [individual for individual in self._population if not individual.told]
        for individual, value in zip(untold, fitness, strict=True):
            individual.fitness, individual.told = float(value), True
            if value > self._best[1]:
                self._best, self._improved = (individual.genome, float(value)), self.generation
        self._evaluations += len(fitness)
        self._species = self._speciated(self._population, self._founded)
        for species in self._species:
            species.members.sort(key=_rank)  # stable: ties stay in order
            if species.members[0].fitness > species.best:
                species.best, species.improved = species.members[0].fitness, self.generation
        if self.settings.species:
            if len(self._species) > self.settings.species:
                self._threshold *= 1.0 + self.settings.threshold_step
            elif len(self._species) < self.settings.species:
                self._threshold /= 1.0 + self.settings.threshold_step

    # ---- species --------------------------------------------------------------------------------------------------

    def _speciated(self, population: list[Individual], founded: list[Species]) -> list[Species]:
        """Each individual in the first species that it is near enough to, or in a new one; without those that nobody joined."""
        genomes = [individual.genome for individual in population]
        species = list(founded)
        near = list(self.representation.distances([of.representative for of in species], genomes) < self._threshold)
        for index, individual in enumerate(population):
            at = next((at for at, those in enumerate(near) if those[index]), len(species))
            if at == len(species):
                species.append(Species(individual.genome, improved=self.generation))
                near.extend(self.representation.distances([individual.genome], genomes) < self._threshold)
            species[at].members.append(individual)
        return [of for of in species if of.members]

    def _counts(self) -> list[int]:
        """Offspring of each species: its share of all species' mean fitness (section 3.3)."""
        told = [[one.fitness * SMALL for one in of.members if one.fitness == one.fitness] for of in self._species]
        worst = min((fitness for of in told for fitness in of), default=0.0)
        shares = []
        for of, fitnesses in zip(self._species, told, strict=True):
            total = 0.0
            for fitness in fitnesses:
                total += fitness - worst
            shares.append(total / len(of.members))  # equation 2: the sum of f / |species|
        order = sorted(range(len(shares)), key=lambda index: _rank(self._species[index].members[0]))
        if not self.relative:
            late = self.generation - 1  # the generation told last
            fresh = {index for index, of in enumerate(self._species) if late - of.improved < self.settings.stagnation}
            allowed = {order[0]} | fresh
            if late - self._improved >= self.settings.population_stagnation:
                allowed = set(order[:2])
            shares = [share if index in allowed else 0.0 for index, share in enumerate(shares)]
        else:
            allowed = set(order)
        if not any(shares):
            shares = [float(len(of.members)) if index in allowed else 0.0 for index, of in enumerate(self._species)]
        return _rounded(shares, self.settings.population)

    # ---- offspring ------------------------------------------------------------------------------------------------

    def _offspring(self, stream: Stream) -> list[Individual]:
        """The next population; elites are told already, unless fitness is relative."""
        settings = self.settings
        population: list[Individual] = []
        mutants: list[int] = []
        for index, (of, count) in enumerate(zip(self._species, self._counts(), strict=True)):
            begin = len(population)
            if count and len(of.members) > settings.elite_size:
                best = of.members[0]
                population.append(Individual(best.genome) if self.relative else msgspec.structs.replace(best))
            survivors = of.members[: int(settings.survival * len(of.members)) + 1]
            for place in range(len(population), begin + count):
                two, unmutated, strange = stream.uniform(0.0, 1.0, 3)
                parent = survivors[stream.integer(len(survivors))]
                if two >= settings.crossover:
                    population.append(Individual(parent.genome))
                    mutants.append(place)
                    continue
                mate = survivors[stream.integer(len(survivors))]
                if strange < settings.interspecies and len(self._species) > 1:
                    other = stream.integer(len(self._species) - 1)
                    mate = self._species[other + (other >= index)].members[0]
                fitter, weaker = sorted((parent, mate), key=lambda one: (*_rank(one), len(one.genome)))
                population.append(Individual(self.representation.crossover(fitter.genome, weaker.genome, stream)))
                if unmutated >= settings.unmutated or mate is parent:
                    mutants.append(place)
        genomes = self.representation.mutate(
            [population[place].genome for place in mutants],
            stream,
            method=1,
            severity=settings.severity,
            probability=settings.probability,
        )
        for place, genome in zip(mutants, genomes, strict=True):
            population[place].genome = genome
        return population

    # ---- what is kept and shown -----------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """See ``Optimizer.state``."""
        return {
            "generation": self.generation,
            "threshold": self._threshold,
            "species": msgspec.to_builtins(self._species, builtin_types=(bytes,)),
            "best": list(self._best),
            "improved": self._improved,
            "evaluations": self._evaluations,
        }

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:  # noqa: ARG002  the state is all
        """See ``Optimizer.restore``."""
        self.generation, self._threshold = state["generation"], state["threshold"]
        self._species = msgspec.convert(state["species"], list[Species])
        self._best = (state["best"][0], state["best"][1])
        self._improved, self._evaluations = state["improved"], state["evaluations"]

    def best(self) -> tuple[bytes, float]:
        """See ``Optimizer.best``."""
        return self._best

    def statistics(self) -> dict[str, float]:
        """Best and mean fitness, evaluations so far, the species, and how large networks are.

        ``species`` is their number, ``species_largest`` the individuals of the largest, ``threshold`` the distance that the next
        generation is divided with. ``hidden_mean`` and ``links_mean`` are hidden neurons and enabled links of an individual,
        ``hidden_best`` and ``links_best`` those of the best network so far.
        """
        population = [individual for of in self._species for individual in of.members]
        fitness = np.array([individual.fitness for individual in population])
        told = fitness[~np.isnan(fitness)]
        hidden, links = np.array([self.representation.structure(individual.genome) for individual in population]).T
        of_best = self.representation.structure(self._best[0]) if self._best[0] else (float("nan"), float("nan"))
        return {
            "best": self._best[1],
            "mean": float(told.mean()) if told.size else float("nan"),
            "evaluations": float(self._evaluations),
            "species": float(len(self._species)),
            "species_largest": float(max(len(of.members) for of in self._species)),
            "threshold": self._threshold,
            "hidden_mean": float(hidden.mean()),
            "links_mean": float(links.mean()),
            "hidden_best": float(of_best[0]),
            "links_best": float(of_best[1]),
        }


def _rank(individual: Individual) -> tuple[bool, float]:
    """Best first, NaN last."""
    fitness = individual.fitness
    return (fitness != fitness, -fitness if fitness == fitness else 0.0)


def _rounded(shares: list[float], count: int) -> list[int]:
    """Whole numbers in these proportions that make up the count."""
    total = 0.0
    for share in shares:
        total += share
    exact = [count * (share / total) for share in shares]
    counts = [int(number) for number in exact]
    largest = sorted(range(len(shares)), key=lambda index: counts[index] - exact[index])  # the first of equals
    for index in largest[: count - sum(counts)]:
        counts[index] += 1
    return counts
