"""NNGA makes each generation as FREVO does: checked on recorded generations and on ours."""

import json
from collections import Counter
from typing import Any, Literal

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.errors import ConfigError
from zswarm.evaluate import build, evaluate
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import mean
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers import nnga
from zswarm.ot.optimizers.breeding import MOST, STRIP, distances_of_pairs
from zswarm.ot.optimizers.nnga import (
    AGAIN,
    NNGA,
    OPERATORS,
    REPEATS,
    SUITORS,
    NNGASettings,
)
from zswarm.ot.record.history_hash import History
from zswarm.testing import check_optimizer

GOLDEN = REPOSITORY / "tests" / "golden"
TRACE = json.loads((GOLDEN / "nnga_trace.json").read_text())
CURVES = json.loads((GOLDEN / "nnga_curves.json").read_text())
OURS = {
    "Elite": "elite",
    "Random": "random",
    "Mutation": "mutation",
    "Xover": "crossover",
    "Renew": "renew",
}


class Watched(FullyMeshed):
    """Record every crossover."""

    def __init__(
        self,
        settings: FullyMeshedSettings | None = None,
        inputs: int = 10,
        outputs: int = 2,
    ) -> None:
        super().__init__(settings or FullyMeshedSettings(), inputs, outputs)
        self.crossed: list[tuple[bytes, bytes, bytes]] = []  # mother, father, child

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        child = self.cross(mother, father, stream)
        self.crossed.append((mother, father, child))
        return child

    def cross(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        return super().crossover(mother, father, stream)


class Barren(Watched):
    """The first children are their mothers, which exist; all that follow are new."""

    barren = 10**9

    def cross(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        if len(self.crossed) < self.barren:
            return super().cross(mother, mother, stream)
        (new,) = self.mutate([father], stream, method=1, severity=0.3, probability=1.0)
        return super().cross(mother, new, stream)


def evolved(optimizer: NNGA, generations: int, stream: Stream | None = None) -> NNGA:
    """Tell fitness for some generations: random numbers, or less for more distance from zero."""
    for _ in range(generations):
        genomes = optimizer.ask()
        optimizer.tell(
            stream.uniform(-9.0, -1.0, len(genomes)) if stream else sphere(genomes)
        )
    return optimizer


def sphere(genomes: list[bytes]) -> np.ndarray:
    return np.array(
        [
            -float((np.frombuffer(genome, "<f4").astype(float) ** 2).sum())
            for genome in genomes
        ]
    )


def population(optimizer: NNGA, island: int = 0) -> list[bytes]:
    return [individual.genome for individual in optimizer._population[island]]


def operators(optimizer: NNGA, island: int = 0) -> list[str]:
    return [individual.operator for individual in optimizer._population[island]]


def counts(size: int) -> tuple[int, ...]:
    made = NNGA(NNGASettings(population=size), Watched(), 1).counts
    return tuple(
        made[name] for name in ("elite", "random", "mutation", "crossover", "renew")
    )


# ---- sizes


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (10, (2, 1, 4, 3, 0)),
        (20, (3, 2, 8, 6, 1)),
        (30, (5, 3, 12, 9, 1)),
        (50, (8, 5, 20, 15, 2)),
        (64, (11, 6, 25, 19, 3)),
        (100, (15, 10, 40, 30, 5)),
    ],
)
def test_shares_are_cut_to_whole_individuals_and_the_elite_gets_the_rest(
    size: int, expected: tuple[int, ...]
) -> None:
    """The expected numbers were counted in FREVO."""
    assert counts(size) == expected
    optimizer = evolved(NNGA(NNGASettings(population=size), Watched(), 1), 1)
    optimizer.ask()
    assert Counter(operators(optimizer)) == Counter(
        dict(zip(OPERATORS, expected, strict=True))
    )


def test_the_counts_equal_the_recorded_ones() -> None:
    recorded = {"mutation": "mutate", "crossover": "xover"}
    ours = dict(zip(OPERATORS, counts(TRACE["populationsize"]), strict=True))
    assert {recorded.get(name, name): count for name, count in ours.items()} == TRACE[
        "counts"
    ]


def test_50_are_evaluated_in_the_first_generation_and_37_in_every_other() -> None:
    optimizer = NNGA(NNGASettings(), Watched(), 1)
    asked = []
    for _ in range(200):
        genomes = optimizer.ask()
        asked.append(len(genomes))
        optimizer.tell(np.zeros(len(genomes)))
    assert asked == [50] + 199 * [37]
    assert sum(asked) == CURVES["stadium"]["evaluations_total_per_run"][0] == 7413
    assert optimizer.statistics()["evaluations"] == 7413


@pytest.mark.parametrize("islands", [1, 3])
def test_every_island_has_its_own_population(islands: int) -> None:
    optimizer = NNGA(NNGASettings(islands=islands), Watched(), 1)
    assert len(optimizer.ask()) == 50 * islands
    optimizer.tell(np.zeros(50 * islands))
    assert len(optimizer.ask()) == 37 * islands
    assert (
        len(
            {
                genome
                for island in range(islands)
                for genome in population(optimizer, island)
            }
        )
        == 50 * islands
    )


@pytest.mark.parametrize("share", ["random", "mutation", "crossover", "renew"])
def test_shares_that_leave_nothing_to_the_elite_are_refused(share: str) -> None:
    none = dict.fromkeys(("random", "mutation", "crossover", "renew"), 0.0)
    with pytest.raises(
        ConfigError, match="leave 0 of 50 individuals to the elite; it needs at least 1"
    ):
        NNGA(NNGASettings(**(none | {share: 1.0})), Watched(), 1)
    assert (
        NNGA(NNGASettings(**(none | {"renew": 0.02})), Watched(), 1).counts["elite"] == 49
    )


@pytest.mark.parametrize(
    "settings", [{"population": 2}, {"mutation": 0.0, "crossover": 0.0, "renew": 0.0}]
)
def test_shares_without_new_individuals_are_refused(settings: dict[str, Any]) -> None:
    """Otherwise all are elite, and after the first generation no candidate is asked for."""
    with pytest.raises(
        ConfigError, match=r"make no new individual of .*; expected at least one in all"
    ):
        NNGA(NNGASettings(**settings), Watched(), 1)


# ---- one generation to the next: FREVO's recording


@pytest.mark.parametrize(
    "generation",
    TRACE["generations"],
    ids=lambda generation: str(generation["generation"]),
)
def test_recorded_generations_follow_the_checked_rules(
    generation: dict[str, Any],
) -> None:
    """The facts that our own generations are held to below."""
    elite, random = TRACE["counts"]["elite"], TRACE["counts"]["random"]
    places = elite + random
    ranked = [id_ for id_, _ in generation["ranked"]]
    following = generation["next"]
    ids = [individual["id"] for individual in following]
    assert generation["evaluations"] == (
        10 if generation["generation"] == 0 else 10 - places
    )
    assert ids[:elite] == ranked[:elite]
    assert all(
        elite <= individual["rank_before"] < len(ranked) - 1
        for individual in following[elite:places]
    )
    assert {OURS[individual["created_by"]] for individual in following[:places]} == {
        "elite",
        "random",
    }
    for individual in following[places:]:
        assert individual["rank_before"] == -1
        if individual["created_by"] == "Mutation":
            assert individual["parent"] in ids[:places]
    for _, mother, father, *_ in generation["xover_attempts"]:
        assert mother in ids[:places]
        assert father in ranked[:places], (
            "of the ranking before the random slots were swapped"
        )


def test_recorded_crossovers_were_rejected_only_where_the_child_existed() -> None:
    network = Watched()
    row = 4 * (network.sources + 1)
    rejected = 0
    for generation in TRACE["generations"]:
        ids = [individual["id"] for individual in generation["next"]]
        # Elite, random, mutation.
        existing = {genome(id_) for id_ in ids if id_ in ids[:7]}
        for child, mother, father, first, taken in generation["xover_attempts"]:
            begin, end = first * row, (first + taken) * row
            made = (
                genome(mother)[:begin] + genome(father)[begin:end] + genome(mother)[end:]
            )
            assert (child not in ids) == (made in existing)
            rejected += made in existing
            existing.add(made)
    assert rejected == 2


def genome(id_: int) -> bytes:
    return np.array(TRACE["genomes"][str(id_)], "<f4").tobytes()


def test_survivors_of_a_recorded_generation_kept_their_fitness() -> None:
    for before, after in zip(
        TRACE["generations"], TRACE["generations"][1:], strict=False
    ):
        fitness = dict(after["ranked"])
        survivors = [
            individual["id"]
            for individual in before["next"]
            if individual["rank_before"] >= 0
        ]
        assert len(survivors) == 3
        assert all(fitness[id_] == dict(before["ranked"])[id_] for id_ in survivors)


# ---- one generation to the next: ours


@pytest.mark.parametrize("size", [10, 50])
def test_our_generations_follow_the_rules_of_the_recorded_ones(size: int) -> None:
    network = Watched()
    optimizer = evolved(NNGA(NNGASettings(population=size), network, 1), 1)
    elite, random, mutation, crossover, _ = counts(size)
    places = elite + random
    ranks_drawn: Counter[int] = Counter()
    fathers_outside, farthest = 0, 0
    for _ in range(60):
        ranked = population(optimizer)
        fitness = [individual.fitness for individual in optimizer._islands[0]]
        assert fitness == sorted(fitness, reverse=True)
        network.crossed = []
        asked = optimizer.ask()
        following = population(optimizer)
        survivors = following[:places]

        assert following[:elite] == ranked[:elite]
        ranks = [ranked.index(survivor) for survivor in survivors[elite:]]
        assert all(elite <= rank < size - 1 for rank in ranks), "the last is never drawn"
        assert len(set(survivors)) == places, "a pick is a swap, so nobody survives twice"
        ranks_drawn.update(ranks)
        assert asked == following[places:], "survivors keep their fitness"

        for mutant in following[places : places + mutation]:
            reach = [
                np.abs(numbers(mutant) - numbers(parent)).max() for parent in survivors
            ]
            assert min(reach) <= 0.6 + 1e-6

        existing = following[: places + mutation]
        for _, _, child in network.crossed:
            existing += [child] if child not in existing else []
        assert following[: len(existing)] == existing, (
            "children that existed are left out"
        )
        assert set(operators(optimizer)[len(existing) :]) <= {"renew"}
        assert (
            len(existing) == places + mutation + crossover
            or len(network.crossed) > REPEATS
        )
        for mother, father, _ in network.crossed:
            assert mother in survivors
            assert father in ranked[:places], (
                "of the ranking before the random slots were swapped"
            )
            fathers_outside += father not in survivors
            distances = network.distances([mother], ranked[:places])[0]
            farthest += ranked[int(np.argmax(distances))] == father
        optimizer.tell(sphere(asked))
    assert fathers_outside > 0
    assert farthest > 0.5 * 60 * crossover, "the most different of eleven"
    assert ranks_drawn[elite] > 0, "a slot may keep its own rank"
    offsets = [rank - elite for rank in ranks_drawn.elements()]
    assert np.mean(offsets) < 0.43 * (size - 2 - elite), "with a bias to the good"


def numbers(genome_: bytes) -> np.ndarray:
    return np.frombuffer(genome_, "<f4").astype(float)


@pytest.mark.parametrize("rest", [2, 3, 9, 41])
def test_random_survivors_are_drawn_from_the_recorded_triangle(rest: int) -> None:
    """|a + b - (r - 1)|, a < r, b < r - 1: 0 has half weight, r never comes."""
    ways = Counter(abs(a + b - (rest - 1)) for a in range(rest) for b in range(rest - 1))
    stream = Stream(5)
    drawn = Counter(nnga._triangular_offset(rest, stream) for _ in range(20_000))
    assert set(drawn) == set(ways)
    assert max(drawn) == rest - 1
    for offset, count in ways.items():
        assert abs(drawn[offset] / 20_000 - count / sum(ways.values())) < 0.012
    if rest > 3:
        assert 0.8 < 2 * drawn[0] / drawn[1] < 1.25


def test_a_slot_without_a_later_rank_keeps_its_own() -> None:
    assert [nnga._triangular_offset(rest, Stream(1)) for rest in (0, 1)] == [0, 0]


def test_a_displaced_individual_can_come_back() -> None:
    """A pick swaps two ranks; one that was swapped away is sometimes drawn again."""
    settings = NNGASettings(
        population=20, random=0.5, mutation=0.2, crossover=0.0, renew=0.2
    )
    optimizer = evolved(NNGA(settings, Watched(), 3), 1, Stream(1))
    came_back = 0
    for _ in range(100):
        ranked = population(optimizer)
        optimizer.ask()
        ranks = [ranked.index(survivor) for survivor in population(optimizer)[2:12]]
        came_back += any(rank < slot for slot, rank in enumerate(ranks, 2))
        optimizer.tell(Stream(came_back).uniform(-9, -1, 8))
    assert came_back > 30


def test_mothers_and_parents_of_mutants_are_drawn_evenly_from_the_survivors() -> None:
    network = Watched()
    optimizer = evolved(NNGA(NNGASettings(), network, 2), 1)
    mothers: Counter[int] = Counter()
    for _ in range(200):
        network.crossed = []
        optimizer.ask()
        survivors = population(optimizer)[:13]
        mothers.update(survivors.index(mother) for mother, _, _ in network.crossed)
        optimizer.tell(sphere(population(optimizer)[13:]))
    shares = np.array([mothers[place] for place in range(13)]) / sum(mothers.values())
    assert np.allclose(shares, 1 / 13, atol=0.02)


def test_mutation_receives_the_settings() -> None:
    settings = NNGASettings(mutation_method=2, severity=0.7, probability=0.2)
    told: list[dict[str, Any]] = []

    class Noting(Watched):
        def mutate(self, genomes: Any, stream: Stream, **options: Any) -> list[bytes]:
            told.append(options)
            return super().mutate(genomes, stream, **options)

    evolved(NNGA(settings, Noting(), 1), 2)
    assert told == [{"method": 2, "severity": 0.7, "probability": 0.2}]


# ---- rejected crossovers


def test_random_genomes_replace_crossovers_that_are_not_new() -> None:
    network = Barren()
    optimizer = evolved(NNGA(NNGASettings(), network, 1), 1)
    assert len(optimizer.ask()) == 37
    assert Counter(operators(optimizer)) == {
        "elite": 8,
        "random": 5,
        "mutation": 20,
        "renew": 17,
    }
    assert len(set(population(optimizer))) == 50


@pytest.mark.parametrize("wanted", [3, 15])
def test_a_hundred_rejections_are_repeated(wanted: int) -> None:
    network = Barren()
    network.barren = REPEATS
    optimizer = evolved(
        NNGA(NNGASettings(population=10 if wanted == 3 else 50), network, 1), 1
    )
    optimizer.ask()
    assert REPEATS == 100
    assert len(network.crossed) == 100 + wanted
    assert operators(optimizer).count("crossover") == wanted


@pytest.mark.parametrize("size", [10, 50])
def test_the_hundred_and_first_rejection_ends_crossover(size: int) -> None:
    """Even where many children are still wanted and the next would be new."""
    network = Barren()
    network.barren = REPEATS + 1
    optimizer = evolved(NNGA(NNGASettings(population=size), network, 1), 1)
    optimizer.ask()
    assert len(network.crossed) == 101
    assert operators(optimizer).count("crossover") == 0
    assert len(population(optimizer)) == size


def test_a_child_like_its_sister_is_rejected() -> None:
    class Twins(Watched):
        def cross(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
            return super().cross(bytes(len(mother)), bytes(len(father)), stream)

    optimizer = evolved(NNGA(NNGASettings(), Twins(), 1), 1)
    optimizer.ask()
    assert operators(optimizer).count("crossover") == 1
    assert operators(optimizer).count("renew") == 16


# ---- islands


def foreign_fathers(settings: NNGASettings, generations: int) -> list[int]:
    """Return per generation, from the second, the fathers from other islands."""
    network, stream = Watched(), Stream(8)
    optimizer = evolved(NNGA(settings, network, 4), 1, stream)
    foreign = []
    for _ in range(generations):
        network.crossed = []
        before = [
            set(population(optimizer, island)) for island in range(settings.islands)
        ]
        genomes = optimizer.ask()
        homes = [
            old | set(population(optimizer, island)) for island, old in enumerate(before)
        ]
        foreign.append(
            sum(
                not any({mother, father} <= home for home in homes)
                for mother, father, _ in network.crossed
            )
        )
        optimizer.tell(stream.uniform(-9.0, -1.0, len(genomes)))
    return foreign


def test_an_interval_of_0_exchanges_nothing_ever() -> None:
    assert (
        foreign_fathers(NNGASettings(population=20, islands=3, exchange_interval=0), 25)
        == [0] * 25
    )


def test_islands_exchange_every_so_often_beginning_with_generation_0() -> None:
    foreign = foreign_fathers(
        NNGASettings(population=20, islands=4, exchange_interval=5), 21
    )
    assert {generation for generation, count in enumerate(foreign) if count} == {
        0,
        5,
        10,
        15,
        20,
    }


def test_fathers_come_from_all_islands_including_the_mothers() -> None:
    foreign = foreign_fathers(
        NNGASettings(population=20, islands=2, exchange_interval=1), 100
    )
    assert 0.4 < sum(foreign) / (100 * 2 * 6) < 0.6


def test_a_second_island_finds_fathers_that_the_first_one_just_bred() -> None:
    """Islands evolve one after another, as in FREVO: the first one's fathers are new ones then."""
    network = Watched()
    optimizer = evolved(
        NNGA(NNGASettings(population=20, islands=2, exchange_interval=1), network, 3), 1
    )
    of_new, of_old = 0, 0
    for _ in range(20):
        old = [population(optimizer, island) for island in range(2)]
        network.crossed = []
        genomes = optimizer.ask()
        new = [population(optimizer, island) for island in range(2)]
        for mother, father, _ in network.crossed:
            if mother in old[0] and father not in old[0]:
                assert father in old[1][:5], (
                    "the second island has not evolved yet: elite and random places of its ranking"
                )
                of_old += 1
            if mother in old[1] and father not in old[1]:
                assert father in new[0][:5]
                of_new += 1
        optimizer.tell(sphere(genomes))
    assert min(of_new, of_old) > 20


def test_every_child_draws_the_island_of_its_father_again() -> None:
    foreign = foreign_fathers(
        NNGASettings(population=20, islands=2, exchange_interval=1), 30
    )
    assert sum(count in (0, 12) for count in foreign) < 3, (
        "of the 12 children some fathers are foreign, others not"
    )
    assert sum(count in (0, 6, 12) for count in foreign) < 15


def test_a_single_island_has_no_one_to_exchange_with() -> None:
    assert (
        foreign_fathers(NNGASettings(population=20, islands=1, exchange_interval=1), 5)
        == [0] * 5
    )


# ---- mutation


@pytest.mark.parametrize(("method", "severity"), [(1, 0.3), (1, 0.05), (2, 0.3)])
def test_mutants_differ_from_their_parents_by_the_steps_of_the_method(
    method: Literal[1, 2], severity: float
) -> None:
    """Method 1: severity times the range. Method 2: a fifth of a weight, at least 0.1; 10."""
    network = Watched()
    optimizer = evolved(
        NNGA(
            NNGASettings(population=100, mutation_method=method, severity=severity),
            network,
            2,
        ),
        1,
    )
    optimizer.ask()
    survivors = network.tables(population(optimizer)[:25])
    mutants = [
        individual
        for individual in optimizer._population[0]
        if individual.operator == "mutation"
    ]
    assert len(mutants) == 40
    if method == 1:
        reach = np.full(survivors.shape, severity * 2.0)
    else:
        reach = np.maximum(survivors / 5.0, 0.1)
        reach[..., -1] = 10.0
    used = np.zeros(survivors.shape[1:])
    for mutant in mutants:
        steps = np.abs(network.tables([mutant.genome]) - survivors) / reach
        parent = int(steps.max(axis=(1, 2)).argmin())
        assert steps[parent].max() <= 1.0 + 1e-5
        used = np.maximum(used, steps[parent])
    assert used.min() > 0.8, (
        "among 40 mutants every gene takes nearly the longest step once"
    )


# ---- relative fitness


def test_relative_fitness_makes_all_candidates_compete_again() -> None:
    """Elite and survivors compete again, too; all are ranked by their last fitness."""
    optimizer = NNGA(NNGASettings(population=10, islands=2), Watched(), 1)
    optimizer.relative = True
    assert len(optimizer.ask()) == 20
    optimizer.tell(np.arange(20.0))
    champions = [population(optimizer, island)[0] for island in range(2)]
    genomes = optimizer.ask()
    assert genomes == population(optimizer, 0) + population(optimizer, 1)
    assert [genomes[0], genomes[10]] == champions
    fitness = np.arange(20.0)
    fitness[[0, 10]] = -5.0
    optimizer.tell(fitness)
    assert [population(optimizer, island)[-1] for island in range(2)] == champions
    assert optimizer.best() == (genomes[19], 19.0)
    assert optimizer.statistics()["evaluations"] == 40


# ---- fitness


def test_the_best_of_a_problem_whose_fitness_is_negative_is_known() -> None:
    optimizer = NNGA(NNGASettings(), Watched(), 1)
    genomes = optimizer.ask()
    optimizer.tell(-1.0 - np.arange(50.0)[::-1])
    assert optimizer.best() == (genomes[-1], -1.0)
    assert optimizer.statistics()["best"] == -1.0


def test_ties_stay_in_order_and_failed_evaluations_come_last() -> None:
    optimizer = NNGA(NNGASettings(population=10), Watched(), 1)
    genomes = optimizer.ask()
    nan = float("nan")
    optimizer.tell(np.array([1, nan, 2, 1, nan, 2, -np.inf, 1, 0, 2]))
    order = [2, 5, 9, 0, 3, 7, 8, 6, 1, 4]
    assert population(optimizer) == [genomes[index] for index in order]
    assert optimizer.best() == (genomes[2], 2.0)


def test_the_effectivity_of_new_individuals_is_counted() -> None:
    """Some new individuals reach the elite by random fitness; FREVO's count is always 0."""
    stream = Stream(6)
    optimizer = evolved(
        NNGA(NNGASettings(renew=0.2, mutation=0.25), Watched(), 1), 1, stream
    )
    renewed = []
    for _ in range(30):
        before = optimizer.ask()
        created = operators(optimizer)
        optimizer.tell(stream.uniform(-9.0, -1.0, len(before)))
        statistics = optimizer.statistics()
        elite = [individual.operator for individual in optimizer._islands[0]][
            : optimizer.counts["elite"]
        ]
        for name in OPERATORS:
            assert statistics[f"count_{name}"] == created.count(name)
            assert statistics[f"effectivity_{name}"] == elite.count(name) / max(
                1, created.count(name)
            )
        renewed.append(statistics["effectivity_renew"])
    assert max(renewed) > 0


def test_statistics_describe_the_whole_population() -> None:
    network = Watched()
    optimizer = evolved(NNGA(NNGASettings(population=10, islands=2), network, 1), 3)
    statistics = optimizer.statistics()
    islands = [population(optimizer, island) for island in range(2)]
    pairs = [
        network.distances([island[a]], [island[b]])[0, 0]
        for island in islands
        for a in range(10)
        for b in range(a)
    ]
    fitness = [
        individual.fitness for island in optimizer._islands for individual in island
    ]
    assert statistics["mean"] == mean(np.array(fitness))
    assert statistics["best"] == max(fitness)
    assert statistics["diversity_mean"] == pytest.approx(np.mean(pairs))
    assert statistics["diversity_max"] == max(pairs)
    assert statistics["diversity_min"] == min(pairs)
    assert statistics["diversity_deviation"] == pytest.approx(np.std(pairs))


def test_diversity_is_over_every_pair_once_in_the_order_of_the_ranking() -> None:
    """Strips of the table of distances hold its pairs, to the last bit of their mean."""
    network = FullyMeshed(FullyMeshedSettings(), 10, 2)
    optimizer = evolved(NNGA(NNGASettings(population=2 * STRIP + 3), network, 1), 1)
    genomes = population(optimizer)
    pairs = network.distances(genomes, genomes)[np.triu_indices(len(genomes), 1)]
    statistics = optimizer.statistics()
    found = [
        statistics[f"diversity_{name}"] for name in ("mean", "max", "min", "deviation")
    ]
    centre = mean(pairs)
    deviation = np.sqrt(mean((pairs - centre) ** 2))
    assert found == [centre, pairs.max(), pairs.min(), deviation]
    assert deviation == pytest.approx(pairs.std())


def test_a_sample_of_a_large_population_is_compared() -> None:
    """Pairs of 1,000 individuals with 5,000 genes took a quarter of a minute in each generation."""
    network = FullyMeshed(FullyMeshedSettings(), 2, 1)
    genomes = network.random(2 * MOST + 1, Stream(1))
    taken = [genomes[index * len(genomes) // MOST] for index in range(MOST)]
    assert taken[:3] == [genomes[0], genomes[2], genomes[4]]
    assert np.array_equal(
        distances_of_pairs(network, genomes), distances_of_pairs(network, taken)
    )
    assert len(distances_of_pairs(network, genomes)) == MOST * (MOST - 1) // 2


def test_populations_lose_their_diversity_as_fast_as_frevos() -> None:
    """The median over runs of the mean distance of two individuals, by generation."""
    simulator, network = build("emergency-exit", {"field": "stadium"}, "fully-meshed", {})
    diversity = np.empty((10, 13))
    for seed in range(10):
        optimizer = NNGA(NNGASettings(), network, seed)
        for generation in range(13):
            genomes = optimizer.ask()
            participants = np.arange(len(genomes))[:, None]
            outcomes = evaluate(
                simulator,
                network,
                genomes,
                participants,
                np.zeros(len(genomes), np.uint64),
            )
            optimizer.tell(outcomes.fitness[:, 0])
            diversity[seed, generation] = optimizer.statistics()["diversity_mean"]
    recorded = CURVES["stadium"]["diversity_avg_median"][:13]
    assert recorded[12] < 0.65 * recorded[0]
    assert np.allclose(np.median(diversity, axis=0), recorded, rtol=0.08)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (NNGASettings(), "e388e4e5f53b1e084a69ed9ac7b71de1"),
        (
            NNGASettings(population=23, islands=3, exchange_interval=2),
            "3b5052d5a0ed0e60da879cb848828d58",
        ),
        (
            NNGASettings(population=200, mutation_method=2, probability=0.3),
            "fda6299068319194bb5cd622cb21aa81",
        ),
    ],
)
def test_proposals_equal_recorded_ones(settings: NNGASettings, expected: str) -> None:
    """Recorded once: a run begun with an earlier zswarm continues as it would have there."""
    optimizer, stream, history = (
        NNGA(settings, FullyMeshed(FullyMeshedSettings(), 10, 2), 5),
        Stream(6),
        History(),
    )
    for _ in range(12):
        genomes = optimizer.ask()
        fitness = np.floor(stream.uniform(0.0, 9.0, len(genomes)))
        optimizer.tell(fitness)
        history.add(genomes, fitness)
    assert history.hex() == expected


class Counting(FullyMeshed):
    """Count what is asked of the representation."""

    def __init__(self) -> None:
        super().__init__(FullyMeshedSettings(), 10, 2)
        self.calls: Counter[str] = Counter()

    def random(self, count: int, stream: Stream) -> list[bytes]:
        self.calls["random"] += 1
        return super().random(count, stream)

    def mutate(self, genomes: Any, stream: Stream, **options: Any) -> list[bytes]:
        self.calls["mutate"] += 1
        return super().mutate(genomes, stream, **options)

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        self.calls["crossover"] += 1
        return super().crossover(mother, father, stream)

    def distances(self, left: Any, right: Any) -> np.ndarray:
        self.calls["distances"] += 1
        self.calls["pairs"] += len(left) * len(right)
        return super().distances(left, right)

    def distances_between(self, genomes: Any, left: Any, right: Any) -> np.ndarray:
        self.calls["between"] += 1
        self.calls["pairs"] += right.size
        return super().distances_between(genomes, left, right)


@pytest.mark.parametrize("population", [50, 500])
def test_a_generation_asks_the_representation_once_for_all_and_once_for_each_child(
    population: int,
) -> None:
    """Nothing grows with the square of the population."""
    network = Counting()
    optimizer = evolved(NNGA(NNGASettings(population=population), network, 1), 2)
    network.calls.clear()
    optimizer.statistics()
    assert network.calls.pop("pairs") <= MOST * (MOST + STRIP)
    assert network.calls == {"distances": -(-min(MOST, population) // STRIP)}
    network.calls.clear()
    optimizer.ask()
    children = network.calls.pop("crossover")
    assert 0.3 * population <= children <= 0.3 * population + REPEATS
    asked = network.calls.pop("between")
    prepared = int(0.3 * population) + AGAIN * (asked - 1)
    assert children <= prepared < children + AGAIN
    assert network.calls.pop("pairs") == SUITORS * prepared
    assert network.calls == {"random": 1, "mutate": 1}


class OneByOne(FullyMeshed):
    """Has parents chosen for one child at a time, and each distance computed alone."""

    crossover_draws = None
    distances_between = Representation.distances_between


class OftenMore(FullyMeshed):
    """Draws more words for some crossovers than is expected of it."""

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        child = super().crossover(mother, father, stream)
        return child if child[0] % 3 else super().crossover(child, mother, stream)


class OftenMoreOneByOne(OftenMore, OneByOne):
    """Draws as ``OftenMore``, and has parents chosen one by one."""


@pytest.mark.parametrize(
    ("one_by_one", "at_once"), [(OneByOne, FullyMeshed), (OftenMoreOneByOne, OftenMore)]
)
@pytest.mark.parametrize("islands", [1, 3])
def test_parents_chosen_at_once_are_those_chosen_one_by_one(
    one_by_one: type[FullyMeshed], at_once: type[FullyMeshed], islands: int
) -> None:
    settings = NNGASettings(population=20, islands=islands, exchange_interval=2)
    optimizers = [
        NNGA(settings, kind(FullyMeshedSettings(), 2, 1), 3)
        for kind in (one_by_one, at_once)
    ]
    fitness = Stream(4)
    for _ in range(8):
        asked, same = (optimizer.ask() for optimizer in optimizers)
        assert asked == same
        values = fitness.uniform(0.0, 1.0, len(asked))
        for optimizer in optimizers:
            optimizer.tell(values)


# ---- the contract


@pytest.mark.parametrize(
    "settings",
    [
        {"population": 10, "islands": 3, "exchange_interval": 2},
        {"population": 30, "mutation_method": 2, "probability": 0.3},
        {"population": 7, "random": 0.0},
        {"population": 2, "random": 0.0, "mutation": 0.5, "crossover": 0.0, "renew": 0.0},
    ],
)
def test_other_settings_keep_the_contract(settings: dict[str, Any]) -> None:
    check_optimizer(NNGA, settings, generations=60)
