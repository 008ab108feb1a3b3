"""NNGA, the genetic algorithm of FREVO (github.com/smartgrids-aau/Frevo, version 1.5), step by step.

A generation is ranked, best first, and the next one is made of: the elite; "random" survivors drawn with a bias to the good;
mutants of survivors; crossovers of a survivor with the most different of eleven good ones; new random individuals.

Kept as it is there:
- the triangular draw of survivors, each pick a swap, so that a displaced individual can come back;
- fathers come from the first places of the ranking before those swaps; generation 0 counts for exchange between islands;
- crossovers identical to an existing individual are repeated 100 times in all; after that the rest is new at random.
Mended:
- the best fitness starts at minus infinity (there at 0.0, so a problem whose maximum is 0 ended after one generation);
- the effectivity of new individuals is counted (there it is always 0);
- an exchange interval of 0 means never (there it divides by zero).
Elites and survivors keep their fitness and are not evaluated again.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.errors import ConfigError
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.diversity import distances_of_pairs
from zswarm.ot.optimizers.optimizer import Optimizer, Told

REPEATS = 100  # of rejected crossovers, in a generation of one island
SUITORS = 11  # fathers to choose from
OPERATORS = ("elite", "random", "mutation", "crossover", "renew")

Share = Annotated[float, Meta(ge=0, le=1)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "nnga"``; what the shares leave over is the elite: 0.15 here."""

    population: Annotated[int, Meta(ge=2, le=1_000_000, description="individuals of an island")] = 50
    islands: Annotated[int, Meta(ge=1, le=1_000, description="populations that evolve side by side")] = 1
    exchange_interval: Annotated[
        int,
        Meta(
            ge=0,
            le=1_000_000_000,
            description="generations between two with fathers from other islands; 0: never",
        ),
    ] = 10
    random: Annotated[Share, Meta(description="share of survivors drawn with a bias to the good")] = 0.10
    mutation: Annotated[Share, Meta(description="share of mutants of survivors")] = 0.40
    crossover: Annotated[Share, Meta(description="share of children of two survivors")] = 0.30
    renew: Annotated[Share, Meta(description="share of new random individuals")] = 0.05
    mutation_method: Annotated[
        Literal[1, 2],
        Meta(
            description="1: absolute, plus or minus `severity` times the range; 2: relative to the gene, as FREVO's code has it"
        ),
    ] = 1
    severity: Annotated[float, Meta(gt=0, le=1e6, description="of method 1")] = 0.3
    probability: Annotated[float, Meta(gt=0, le=1, description="that a gene of a mutant changes")] = 1.0


class Individual(msgspec.Struct):
    """A genome, where it came from, and its fitness once told."""

    genome: bytes
    operator: str
    fitness: float = float("nan")
    told: bool = False


class NNGA(Optimizer):
    """FREVO's genetic algorithm: elite, survivors, their mutants and crossovers, and some new individuals.

    Its steps stand in the module's text. Every generation draws from a stream of its own.
    """

    settings_type = Settings
    portable = True
    competes = True
    settings: Settings

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        size = settings.population
        self.counts = {name: int(size * getattr(settings, name)) for name in ("random", "mutation", "crossover", "renew")}
        self.counts["elite"] = size - sum(self.counts.values())
        if self.counts["elite"] < 1:
            raise ConfigError(
                f"optimizer: random, mutation, crossover and renew leave {self.counts['elite']} of {size} individuals to the "
                "elite; it needs at least 1"
            )
        if not self.counts["mutation"] + self.counts["crossover"] + self.counts["renew"]:
            raise ConfigError(
                f"optimizer: mutation, crossover and renew make nobody new of {size} individuals; expected at least one in all"
            )
        self.candidates = size * settings.islands
        self._islands: list[list[Individual]] = []  # each ranked, best first, after a tell
        self._told: list[list[Individual]] = []  # as they were after the last tell
        self._best = (b"", float("-inf"))
        self._evaluations = 0
        self._effectivity = dict.fromkeys(OPERATORS, 0.0)
        self._count = dict.fromkeys(OPERATORS, 0)

    def _ask(self) -> list[bytes]:
        stream = Stream(derive_seed(self.seed, "nnga", self.generation))
        if not self._islands:
            size = self.settings.population
            self._islands = [
                [Individual(genome, "renew") for genome in self.representation.random(size, stream)]
                for _ in range(self.settings.islands)
            ]
        else:
            places = self.counts["elite"] + self.counts["random"]
            fathers = [[individual.genome for individual in island[:places]] for island in self._islands]
            for index in range(self.settings.islands):
                self._islands[index] = self._evolve(index, fathers, stream)
                fathers[index] = [individual.genome for individual in self._islands[index][:places]]
        if self.relative:
            for island in self._islands:
                for individual in island:
                    individual.told = False
        return [individual.genome for individual in self._untold()]

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  it wants none
        if self.relative:
            self._best = (b"", float("-inf"))
        for individual, value in zip(self._untold(), fitness, strict=True):
            individual.fitness, individual.told = float(value), True
            if value > self._best[1]:
                self._best = (individual.genome, float(value))
        self._evaluations += len(fitness)
        created = [individual.operator for island in self._islands for individual in island]
        for island in self._islands:
            island.sort(key=lambda individual: _rank_key(individual.fitness))  # stable: ties stay in order
        elite = [individual.operator for island in self._islands for individual in island[: self.counts["elite"]]]
        self._count = {name: created.count(name) for name in OPERATORS}
        self._effectivity = {name: elite.count(name) / max(1, self._count[name]) for name in OPERATORS}
        self._told = list(self._islands)

    def _untold(self) -> list[Individual]:
        return [individual for island in self._islands for individual in island if not individual.told]

    def _evolve(self, index: int, fathers: list[list[bytes]], stream: Stream) -> list[Individual]:
        """The next population of one island from its ranking."""
        ranked = list(self._islands[index])
        size, elite = len(ranked), self.counts["elite"]
        places = elite + self.counts["random"]
        for slot in range(elite, places):
            other = slot + _triangular_offset(size - 1 - slot, stream)
            ranked[slot], ranked[other] = ranked[other], ranked[slot]
        survivors = ranked[:places]
        for position, individual in enumerate(survivors):
            individual.operator = "elite" if position < elite else "random"
        made = list(survivors)

        parents = stream.integers(places, self.counts["mutation"])
        mutants = self.representation.mutate(
            [survivors[parent].genome for parent in parents],
            stream,
            method=self.settings.mutation_method,
            severity=self.settings.severity,
            probability=self.settings.probability,
        )
        made += [Individual(genome, "mutation") for genome in mutants]
        interval = self.settings.exchange_interval
        exchange = interval > 0 and (self.generation - 1) % interval == 0
        islands = fathers if exchange else [fathers[index]]
        made += self._crossovers([survivor.genome for survivor in survivors], islands, {m.genome for m in made}, stream)
        made += [Individual(genome, "renew") for genome in self.representation.random(size - len(made), stream)]
        return made

    def _crossovers(
        self, mothers: list[bytes], islands: list[list[bytes]], existing: set[bytes], stream: Stream
    ) -> list[Individual]:
        """Children of a uniform mother and the father most different from her among eleven of a uniform island."""
        children: list[Individual] = []
        distances = [self.representation.distances(mothers, fathers) for fathers in islands]
        repeats = REPEATS
        while len(children) < self.counts["crossover"]:
            mother, island = stream.integer(len(mothers)), stream.integer(len(islands))
            suitors = [stream.integer(len(islands[island])) for _ in range(SUITORS)]
            father = max(suitors, key=distances[island][mother].item)  # the first of equals
            child = self.representation.crossover(mothers[mother], islands[island][father], stream)
            if child not in existing:
                existing.add(child)
                children.append(Individual(child, "crossover"))
            elif repeats:
                repeats -= 1
            else:
                break
        return children

    def state(self) -> dict[str, Any]:
        """See ``Optimizer.state``."""
        return {
            "generation": self.generation,
            "islands": msgspec.to_builtins(self._islands, builtin_types=(bytes,)),
            "best": list(self._best),
            "evaluations": self._evaluations,
            "count": self._count,
            "effectivity": self._effectivity,
        }

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:  # noqa: ARG002  the state is all
        """See ``Optimizer.restore``."""
        self.generation = state["generation"]
        self._islands = [[Individual(**individual) for individual in island] for island in state["islands"]]
        self._told = list(self._islands)
        self._best = (state["best"][0], state["best"][1])
        self._evaluations = state["evaluations"]
        self._count, self._effectivity = dict(state["count"]), dict(state["effectivity"])

    def best(self) -> tuple[bytes, float]:
        """See ``Optimizer.best``."""
        return self._best

    def statistics(self) -> dict[str, float]:
        """Best and mean fitness, evaluations so far, diversity, and per operator its count and effectivity.

        Diversity is the distance between two individuals of an island, over all pairs of 250 at most: average, maximum, minimum
        and standard deviation. Effectivity is the share of an operator's individuals that reached the elite.
        """
        fitness = np.array([individual.fitness for island in self._told for individual in island])
        told = fitness[~np.isnan(fitness)]
        genomes = [[individual.genome for individual in island] for island in self._told]
        pairs = np.concatenate([distances_of_pairs(self.representation, island) for island in genomes])
        return {
            "best": self._best[1],
            "mean": float(told.mean()) if told.size else float("nan"),
            "evaluations": float(self._evaluations),
            "diversity_mean": float(pairs.mean()),
            "diversity_max": float(pairs.max()),
            "diversity_min": float(pairs.min()),
            "diversity_deviation": float(pairs.std()),
            **{f"count_{name}": float(self._count[name]) for name in OPERATORS},
            **{f"effectivity_{name}": self._effectivity[name] for name in OPERATORS},
        }


def _rank_key(fitness: float) -> tuple[bool, float]:
    """Best first, NaN last."""
    return (fitness != fitness, -fitness if fitness == fitness else 0.0)


def _triangular_offset(rest: int, stream: Stream) -> int:
    """|a + b - (rest - 1)| for a < rest, b < rest - 1: small offsets are likely, 0 has half weight, rest never comes."""
    if rest < 2:
        return 0
    return abs(stream.integer(rest) + stream.integer(rest - 1) - (rest - 1))
