"""Every optimizer keeps the contract and beats random search; the check finds mistakes."""

import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.nets import neat_genome
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.nets.neat import Neat
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.breeding import unevaluated
from zswarm.ot.optimizers.cea2d import CEA2D
from zswarm.ot.optimizers.nnga import NNGA, NNGASettings
from zswarm.ot.optimizers.novelty import Novelty
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.ot.optimizers.pso import PSO
from zswarm.ot.optimizers.random_search import RandomSearch
from zswarm.ot.record.history_hash import History
from zswarm.plugins import registry as plugins
from zswarm.testing import check_optimizer

VECTORS = ("cuckoo", "openai-es", "pso")
OPERATORS = ("cea2d", "nnga", "novelty", "random")


class Opaque(Representation):
    """A fully-meshed network whose genomes are reversed bytes, not plain numbers."""

    settings_type = FullyMeshedSettings
    step = FullyMeshed.step
    genome_bytes = None

    def __init__(self) -> None:
        super().__init__(FullyMeshedSettings(), 3, 1)
        self.network = FullyMeshed(FullyMeshedSettings(), 3, 1)
        self.state_size = self.network.state_size

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        return self.network.parameters(turned(genomes))

    def random(self, count: int, stream: Stream) -> list[bytes]:
        return turned(self.network.random(count, stream))

    def mutate(
        self, genomes: Sequence[bytes], stream: Stream, **options: Any
    ) -> list[bytes]:
        return turned(self.network.mutate(turned(genomes), stream, **options))

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        return turned([self.network.crossover(*turned([mother, father]), stream)])[0]

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        return self.network.distances(turned(left), turned(right))


def turned(genomes: Sequence[bytes]) -> list[bytes]:
    return [genome[::-1] for genome in genomes]


GRID = {"lows": [-2, -2], "highs": [2, 2], "cells": [10, 10]}
# Settings without a default, and smaller populations where a large one takes long.
NEEDED: dict[str, dict[str, Any]] = {
    "cma-me": GRID | {"emitters": 2},
    "map-elites": GRID,
    "neat": {"population": 40},
}
# Of those that take no others.
OWN_NETWORKS = {
    "neat": Neat(convert({"add_node": 0.2}, Neat.settings_type, "settings"), 3, 1)
}


@pytest.mark.parametrize("name", plugins.names("optimizer"))
def test_every_optimizer_keeps_the_contract(name: str) -> None:
    check_optimizer(
        plugins.load("optimizer", name),
        NEEDED.get(name),
        representation=OWN_NETWORKS.get(name),
    )


@pytest.mark.parametrize("name", OPERATORS)
def test_optimizers_with_operators_evolve_genomes_of_every_kind(name: str) -> None:
    check_optimizer(plugins.load("optimizer", name), representation=Opaque())


@pytest.mark.parametrize("name", VECTORS)
def test_optimizers_of_vectors_refuse_other_genomes(name: str) -> None:
    loaded = plugins.load("optimizer", name)
    with pytest.raises(
        ConfigError,
        match=r"^optimizer: it searches vectors of numbers; .* \(Opaque\) are not vectors$",
    ):
        loaded(loaded.settings_type(), Opaque(), 1)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        (
            "cea2d",
            {
                "width": 3,
                "height": 5,
                "elite": 0.3,
                "mutation": 0.2,
                "crossover": 0.2,
                "mutation_method": 2,
            },
        ),
        ("cuckoo", {"population": 3, "discovery": 1.0, "step": 1.0, "bound": 0.5}),
        (
            "novelty",
            {
                "measures": ["one"],
                "population": 7,
                "neighbours": 100,
                "threshold": 0.01,
                "fitness": 0.5,
            },
        ),
        ("novelty", {"mutation": 1.0, "mutation_method": 2, "fitness": 1.0}),
        ("openai-es", {"population": 2, "deviation": 0.5, "weight_decay": 0.0}),
        ("pso", {"population": 2, "inertia": 0.0, "bound": 3.0, "speed": 0.01}),
        ("random", {"population": 2}),
    ],
)
def test_other_settings_keep_the_contract(name: str, settings: dict[str, Any]) -> None:
    check_optimizer(plugins.load("optimizer", name), settings, generations=60)


YESTERDAY = {
    "cea2d": "4f39e20de871defc571dd0bb63efe373",
    "cuckoo": "ddcba845cb25886c8711162aee74db79",
    "novelty": "480d8efc75a5ae3e69f12a9814160423",
    "openai-es": "f523c3d55247224c579d090560e3fe61",
    "pso": "88636ef5b690dc306781c12d58b4ecd6",
    "random": "2ece45d56a95218f24ce6054e4305998",
}


@pytest.mark.parametrize("name", YESTERDAY)
def test_proposals_equal_recorded_ones_on_every_machine(name: str) -> None:
    """Recorded once: a run begun with an earlier zswarm continues as it would have there."""
    loaded, network, stream, history = (
        plugins.load("optimizer", name),
        FullyMeshed(FullyMeshedSettings(), 4, 2),
        Stream(6),
        History(),
    )
    wanted = {"measures": ["one", "other"]} if name == "novelty" else {}
    optimizer = loaded(convert(wanted, loaded.settings_type, "settings"), network, 5)
    for _ in range(12):
        genomes = optimizer.ask()
        fitness = np.floor(stream.uniform(0.0, 99.0, len(genomes)))
        optimizer.tell(
            fitness,
            stream.uniform(0.0, 1.0, len(genomes) * len(wanted) * 2).reshape(
                len(genomes), -1
            ),
        )
        history.add(genomes, fitness)
    assert history.hex() == YESTERDAY[name]


# ---- better than random

EVALUATIONS = 1500


MEASURES = {"measures": ["one", "other"]}
AIMS: dict[str, dict[str, Any]] = {  # settings on the sphere
    "cma-me": MEASURES | GRID,
    "map-elites": MEASURES | GRID,
    "novelty": MEASURES | {"fitness": 0.9},  # novelty alone seeks no fitness
}
GROWN = Neat(
    convert({"add_node": 0.0, "add_link": 0.0}, Neat.settings_type, "settings"), 6, 5
)
MESHED = FullyMeshed(FullyMeshedSettings(), 2, 3)


def numbers(genomes: list[bytes], network: Representation) -> np.ndarray:
    """(genomes, 35) float64: what the sphere is of."""
    if network is MESHED:
        return (
            np.frombuffer(b"".join(genomes), "<f4")
            .reshape(len(genomes), -1)
            .astype(float)
        )
    rows = []
    for genome in genomes:  # of five outputs and thirty links, for nothing grows
        nodes = np.frombuffer(genome, neat_genome.NODE, 5, neat_genome.COUNTS.size)
        links = np.frombuffer(
            genome, neat_genome.LINK, 30, neat_genome.COUNTS.size + nodes.nbytes
        )
        rows.append(np.concatenate([nodes["bias"], links["weight"]]))
    return np.array(rows)


def reached(name: str, seed: int, network: Representation) -> float:
    """Return the best on the sphere of 35 numbers; measures are the first two."""
    loaded = plugins.load("optimizer", name)
    optimizer = loaded(
        convert(AIMS.get(name, {}), loaded.settings_type, "settings"), network, seed
    )
    told = 0
    while told < EVALUATIONS:
        table = numbers(optimizer.ask()[: EVALUATIONS - told], network)
        fitness = -(table**2).sum(axis=1)
        if len(table) < len(optimizer._asked):
            return float(max(optimizer.best()[1], fitness.max()))
        optimizer.tell(fitness, table[:, : len(optimizer.measures)])
        told += len(table)
    return float(optimizer.best()[1])


@functools.cache
def by_chance(network: Representation) -> list[float]:
    return [reached("random", seed, network) for seed in range(10)]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long)
        if name in OWN_NETWORKS
        else name  # whose genomes take longer
        for name in sorted(set(plugins.BUNDLED["optimizer"]) - {"random"})
    ],
)
def test_each_beats_random_search_on_the_sphere(name: str) -> None:
    network = GROWN if name in OWN_NETWORKS else MESHED
    found = [reached(name, seed, network) for seed in range(10)]
    assert mannwhitneyu(found, by_chance(network), alternative="greater").pvalue < 0.01


# ---- broken ones are found


class SharedDraws(NNGA):
    def _ask(self) -> list[bytes]:
        super()._ask()
        last = self._population[0][-1]
        last.genome = np.random.default_rng().random(21, np.float32).tobytes()
        return [genome for island in self._population for genome in unevaluated(island)]


class DeafToSeeds(NNGA):
    def __init__(self, settings: NNGASettings, representation: Any, seed: int) -> None:
        super().__init__(settings, representation, seed * 0)


class Forgetful(RandomSearch):
    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:
        super().restore(state, told)
        self.seed += 1


class NotPlain(NNGA):
    def state(self) -> dict[str, Any]:
        return {**super().state(), "best": [self._best[0], np.array([self._best[1]])]}


class BestIsLast(NNGA):
    def best(self) -> tuple[bytes, float]:
        if not self._islands:
            return super().best()
        last = self._islands[0][0]
        return last.genome, last.fitness - 1.0


class FooledByNaN(NNGA):
    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:
        super()._tell(np.where(np.isnan(fitness), 1.0, fitness), measures)


class OutOfOrder(NNGA):
    def ask(self) -> list[bytes]:
        self._waiting = False
        return super().ask()


class TellsWhatItAsked(NNGA):
    def statistics(self) -> dict[str, float]:
        return {**super().statistics(), "waiting": float(self._waiting)}


class SaysTooFew(NNGA):
    def ask(self) -> list[bytes]:
        self.candidates = 10
        return super().ask()


class WrongLength(NNGA):
    def _ask(self) -> list[bytes]:
        return [genome[4:] for genome in super()._ask()]


class KeepsFitness(NNGA):
    """Survivors are not asked again where fitness is relative."""

    def _ask(self) -> list[bytes]:
        told = {individual.genome for island in self._islands for individual in island}
        genomes = super()._ask()
        for island in self._population:
            for individual in island:
                individual.evaluated = individual.genome in told
        return [genome for genome in genomes if genome not in told]


class KeepsItsBest(RandomSearch):
    def best(self) -> tuple[bytes, float]:
        self._kept = max(
            getattr(self, "_kept", (b"", float("-inf"))),
            super().best(),
            key=lambda best: best[1],
        )
        return self._kept if self.relative else super().best()


class RanksTheOld(CEA2D):
    """Cells that stay keep their fitness where it is relative."""

    def _ask(self) -> list[bytes]:
        super()._ask()
        if self.generation:
            self._cells = np.flatnonzero(np.array(self._operators) != "elite")
        return [self._population[cell] for cell in self._cells]


class ForgetsVelocity(PSO):
    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:
        super().restore(state, told)
        self._velocities = np.zeros_like(self._velocities)


class DrawsFromOneStream(PSO):
    """A stream that is not in the state."""

    def _ask(self) -> list[bytes]:
        genomes = super()._ask()
        self._shared = getattr(self, "_shared", Stream(self.seed))
        self._positions = self._positions * self._shared.uniform(0.9, 1.0, 1)
        return self._space.genomes(self._positions) if self.generation else genomes


class IgnoresMeasures(Novelty):
    """Accept a tell without measures."""

    def tell(self, fitness: np.ndarray, measures: np.ndarray | None = None) -> None:
        super().tell(
            fitness, np.zeros((len(fitness), 2)) if measures is None else measures
        )


class ForgetsTheArchive(Novelty):
    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:
        super().restore({**state, "archive": b""}, told)


class RepairsFitness(NNGA):
    """Put the worst where fitness is NaN, in the array that the run records."""

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:
        fitness[np.isnan(fitness)] = -1e9
        super()._tell(fitness, measures)


class SortsWhatItAsked(RandomSearch):
    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:
        super()._tell(fitness, measures)
        self._asked.sort()


class ContentWithEquals(CEA2D):
    """Equals of the best stay: where all are equal everybody is content."""

    def _ask(self) -> list[bytes]:
        asked = super()._ask()
        return asked if self.generation == 0 or np.ptp(self._fitness) else []


class AsksArrays(RandomSearch):
    def _ask(self) -> list[bytes]:
        return [bytearray(genome) for genome in super()._ask()]  # type: ignore[misc]


@pytest.mark.parametrize(
    ("broken", "text"),
    [
        (SaysTooFew, "ask gives 50 genomes; candidates is 10"),
        (TellsWhatItAsked, "ask changes best or statistics"),
        (SharedDraws, "the same seed asks other genomes"),
        (WrongLength, "genomes that FullyMeshed.parameters refuses: a genome has"),
        (DeafToSeeds, "another seed asks the same genomes"),
        (Forgetful, "state and restore change what is asked"),
        (BestIsLast, "best"),
        (FooledByNaN, "after NaN fitness must be"),
        (OutOfOrder, "ask before the last one was told must raise RuntimeError"),
        (KeepsFitness, "KeepsFitness.*relative"),
        (
            KeepsItsBest,
            "best must be the best of the last generation where fitness is relative",
        ),
        (RanksTheOld, "ask for all candidates that compete again"),
        (ForgetsVelocity, "state and restore change what is asked"),
        (DrawsFromOneStream, "state and restore change what is asked"),
        (IgnoresMeasures, "tell without its measures must raise ValueError"),
        (RepairsFitness, "tell changes the fitness or measures it is given"),
        (SortsWhatItAsked, "tell changes the list that ask returned"),
        (
            ContentWithEquals,
            "ask gives no genome in generation 1 where all are equally good",
        ),
        (AsksArrays, "ask must give bytes, not bytearray"),
        (ForgetsTheArchive, "a restored optimizer has another state after the same tell"),
    ],
)
def test_the_check_names_what_is_broken(broken: type[Optimizer], text: str) -> None:
    with pytest.raises(AssertionError, match=text):
        check_optimizer(broken)


def test_the_check_finds_optimizers_that_do_not_learn() -> None:
    """Particles that nothing draws; and novelty where all that is done before is done again."""
    with pytest.raises(
        AssertionError,
        match="PSO: the best of 25 generations is no better than the first",
    ):
        check_optimizer(PSO, {"inertia": 0.0, "own": 0.0, "social": 0.0})
    with pytest.raises(
        AssertionError, match=r"no better than the first.*; nor do measures reach further"
    ):
        check_optimizer(Novelty, {"severity": 1e-9, "mutation": 1.0})


def test_the_check_refuses_state_that_cannot_be_encoded() -> None:
    with pytest.raises(TypeError, match="Encoding objects of type"):
        check_optimizer(NotPlain)
