"""CMA-ES is the package's own; what is ours are units, restarts, and the way back after a stop."""

import sys

import cmaes
import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from tests.ot.optimizers.spheres import Vector, best_of_random, evolve, make
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.evaluate import evaluate
from zswarm.kernels.random import derive_seed
from zswarm.ot.build import build
from zswarm.ot.optimizers.cmaes import CMAES, GROWTH
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.testing import check_optimizer

GENES = 6


@pytest.mark.parametrize(
    "settings",
    [{"separable": True}, {"restarts": "bipop", "population": 12, "sigma": 1.5}],
)
def test_cmaes_keeps_the_contract_of_optimizers(settings: dict[str, object]) -> None:
    check_optimizer(CMAES, settings)


@pytest.mark.parametrize("separable", [False, True])
def test_proposals_equal_those_of_the_package(separable: bool) -> None:
    """Both have the same seed and are told the vectors that were evaluated."""
    ours = make(CMAES, GENES, seed=5, separable=separable, sigma=0.4, population=10)
    package = (cmaes.SepCMA if separable else cmaes.CMA)(
        mean=np.zeros(GENES),
        sigma=0.4,
        population_size=10,
        seed=derive_seed(5, "cmaes", 0) >> 32,
    )
    ranges = Vector(GENES).ranges
    for _ in range(40):
        proposed = np.array([package.ask() for _ in range(10)])
        (told,) = evolve(ours, 1)
        assert [
            row.tobytes() for row in (proposed * ranges).astype("<f4")
        ] == told.genomes
        evaluated = (
            np.frombuffer(b"".join(told.genomes), "<f4").reshape(-1, GENES) / ranges
        )
        package.tell(
            [
                (solution, -value)
                for solution, value in zip(evaluated, told.fitness, strict=True)
            ]
        )


def test_the_separable_form_finds_the_top_of_a_sphere_that_random_search_does_not() -> (
    None
):
    """Ten seeds of each, as many evaluations."""
    generations, found, at_random = 40, [], []
    for seed in range(10):
        optimizer = make(CMAES, 20, seed=seed, separable=True)
        evolve(optimizer, generations)
        found.append(optimizer.best()[1])
        at_random.append(best_of_random(20, generations * 12, seed))
    assert mannwhitneyu(found, at_random, alternative="greater").pvalue < 0.01
    assert np.median(found) > -0.2


def populations(optimizer: Optimizer, generations: int) -> list[int]:
    """Return the candidates per generation; on the sphere the search converges repeatedly."""
    return [len(told.genomes) for told in evolve(optimizer, generations)]


def starts(optimizer: Optimizer, generations: int) -> list[int]:
    """Return the population of each start."""
    found, restarts = [], 0
    for _ in range(generations):
        (population,) = populations(optimizer, 1)
        if restarts == len(found):
            found.append(population)
        restarts = int(optimizer.statistics()["restarts"])
    return found


def test_ipop_starts_again_with_twice_the_population_up_to_the_largest() -> None:
    optimizer = make(CMAES, 2, restarts="ipop", population=5, largest=18)
    assert starts(optimizer, 350)[:4] == [5, 5 * GROWTH, 18, 18]
    assert optimizer.candidates == 18


def test_bipop_starts_small_again_while_large_starts_spent_more() -> None:
    found = starts(make(CMAES, 2, restarts="bipop", population=5, largest=40), 600)
    assert found[:2] == [5, 10]
    large = [population for population in found[1:] if population in (10, 20, 40)]
    small = [population for population in found[1:] if population not in (10, 20, 40)]
    assert large == sorted(large)
    assert small, "no small start between large ones"
    assert max(small) <= 20


def test_without_restarts_it_continues() -> None:
    optimizer = make(CMAES, 2, restarts="none", population=5)
    assert set(populations(optimizer, 400)) == {5}
    assert optimizer.candidates == 5
    assert optimizer.statistics()["restarts"] == 0
    assert optimizer.best()[1] > -1e-6


def test_a_restart_keeps_the_best_and_begins_at_another_point() -> None:
    optimizer = make(CMAES, 2, population=5)
    while not (optimizer.generation and optimizer.statistics()["restarts"]):
        evolve(optimizer, 1)
    best = optimizer.best()
    (told,) = evolve(optimizer, 1)
    assert told.fitness.mean() < -0.05
    assert optimizer.best() == best


def test_statistics_describe_the_last_generation() -> None:
    """The step size shrinks where the top is near; a sphere has no long axes."""
    optimizer = make(CMAES, GENES, sigma=0.5)
    evolve(optimizer, 1)
    first = optimizer.statistics()
    evolve(optimizer, 80)
    last = optimizer.statistics()
    assert set(last) == {
        "best",
        "mean",
        "evaluations",
        "sigma",
        "condition",
        "population",
        "restarts",
    }
    assert 0.2 < first["sigma"] < 1.0
    assert last["sigma"] < 1e-2
    assert 1.0 <= last["condition"] < 100
    assert first["population"] == 9
    assert last["evaluations"] == 81 * 9


@pytest.mark.parametrize(
    ("genes", "settings", "text"),
    [
        (9, {"population": 3}, "optimizer: population: expected 0, or at least 4, not 3"),
        (
            9,
            {"largest": 5},
            "optimizer: largest: expected 0, or at least the population of 10, not 5",
        ),
        (
            1,
            {"separable": True},
            "optimizer: separable: expected a genome of at least 2 genes, not 1",
        ),
    ],
)
def test_impossible_settings_are_refused_in_one_line(
    genes: int, settings: dict[str, object], text: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        make(CMAES, genes, **settings)
    assert str(refusal.value) == text


def test_where_the_package_is_missing_one_line_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "cmaes", None)
    with pytest.raises(
        ConfigError, match=r"^optimizer cmaes needs cmaes: .* -m pip install cmaes\b"
    ):
        make(CMAES, GENES)


# ---- the example: a network of 726 weights


def reached(seed: int, optimizer: dict[str, object]) -> float:
    """The best after 2,000 evaluations of the stadium, without servers."""
    mapping = experiment.to_mapping(experiment.load(experiment.find("long-genome"))) | {
        "seed": seed
    }
    mapping["optimizer"] = optimizer or mapping["optimizer"]
    problem, evolving = build(
        experiment.complete(experiment.check(mapping, "test"), "test")
    )
    evaluations = 0
    while evaluations < 2000:
        work = problem.workload(evolving.ask(), 0)
        work.fitness[:] = evaluate(
            problem.simulator,
            problem.representation,
            work.genomes,
            work.participants,
            work.seeds,
        ).fitness
        evolving.tell(problem.total(work))
        evaluations += len(work.genomes)
    return evolving.best()[1]


@pytest.mark.long
def test_a_long_genome_evolves_faster_than_with_a_genetic_algorithm() -> None:
    """Five seeds: the swarm leaves the stadium in time, with as many evaluations as nnga."""
    ours = [reached(seed, {}) for seed in range(1, 6)]
    theirs = [reached(seed, {"kind": "nnga", "population": 50}) for seed in range(1, 6)]
    assert min(ours) > 0.2
    assert mannwhitneyu(ours, theirs, alternative="greater").pvalue < 0.01
