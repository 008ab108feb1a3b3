"""Examples of methods find what their comments say, and beat random search."""

import functools
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from tests.examples import played
from zswarm import experiment
from zswarm.evaluate import evaluate
from zswarm.kernels.random import derive_seed
from zswarm.ot.build import Parts
from zswarm.plugins import registry as plugins

STADIUM = ("cea2d", "cuckoo", "openai-es", "pso")
# Optimizers with the example of what they are known for, evaluations, and seeds.
NAMED = {
    **{name: (name, 2000, 10) for name in STADIUM},
    "cmaes": ("long-genome", 1000, 6),
    "neat": ("xor-neat", 3000, 6),
    "nnga": ("stadium", 2000, 10),
}
# Compared by the score of their archive in test_elites.py, or below; and their opponents.
OTHERWISE = {
    "cma-me": "cma-me",
    "map-elites": "minisim-elites",
    "novelty": "maze",
    "random": "baseline",
}


def best(name: str, changes: Sequence[str] = (), evaluations: int = 10**9) -> float:
    """Return what a run of an example records, played in this process."""
    (_, optimizer), _ = played(name, changes, evaluations)
    return optimizer.best()[1]


@functools.cache
def by_chance(example: str, seed: int, evaluations: int) -> float:
    """Return what random search finds."""
    return best(
        example,
        [f"seed={seed}", 'optimizer={kind="random"}', "generations=1000"],
        evaluations,
    )


@pytest.mark.parametrize("name", STADIUM)
def test_everybody_leaves_the_stadium(name: str) -> None:
    """A fitness above 0 means that all have left."""
    assert best(name) > 0.0


def test_every_optimizer_has_an_example_on_which_it_is_compared() -> None:
    examples = OTHERWISE | {name: example for name, (example, _, _) in NAMED.items()}
    assert examples.keys() == set(plugins.BUNDLED["optimizer"])
    for name, example in examples.items():
        assert experiment.load(experiment.find(example)).optimizer.kind == name


def test_every_network_has_an_example() -> None:
    """Parts of a bulk do not count."""
    files = experiment.examples_folder().glob("*.toml")
    assert {experiment.load(file).representation.kind for file in files} == set(
        plugins.BUNDLED["representation"]
    )


def test_the_examples_of_the_stadium_differ_only_in_how_they_search() -> None:
    """Random search finds the same in each of them."""
    tasks = [
        experiment.complete(experiment.load(experiment.find(name)), name)
        for name in ("stadium", *STADIUM)
    ]
    for task in tasks:
        assert task.problem == tasks[0].problem
        assert task.representation == tasks[0].representation


@pytest.mark.long
@pytest.mark.parametrize("name", NAMED)
def test_each_beats_random_search_at_equal_evaluations(name: str) -> None:
    """Random search has as many or some more, of the same genomes."""
    example, evaluations, seeds = NAMED[name]
    found, chance = [], []
    for seed in range(seeds):
        (_, optimizer), told = played(example, [f"seed={seed}"], evaluations)
        found.append(optimizer.best()[1])
        rival = "stadium" if name in STADIUM else example
        chance.append(by_chance(rival, seed, told // 100 * 100 + 100))
    assert mannwhitneyu(found, chance, alternative="greater").pvalue < 0.01


@pytest.mark.parametrize(
    ("seeds", "others"),
    [
        pytest.param(7, 3, marks=pytest.mark.long),
        pytest.param(10, 10, marks=pytest.mark.thorough),
    ],
)
def test_novelty_finds_the_way_round_where_fitness_leads_behind_a_wall(
    seeds: int, others: int
) -> None:
    """The goal is reached with fitness 1 or more; breeding for nearness or chance does not."""
    found = []
    for seed in range(seeds):
        (_, optimizer), told = played("maze", [f"seed={seed}"], enough=1.0)
        assert told <= 15_000
        found.append(optimizer.best()[1])
    bred = [
        best(
            "maze",
            [f"seed={seed}", 'optimizer={kind="nnga"}', "generations=1000"],
            15_000,
        )
        for seed in range(others)
    ]
    chance = [by_chance("maze", seed, 15_000) for seed in range(others)]
    assert sum(fitness >= 1.0 for fitness in found) >= 0.8 * seeds
    assert sum(fitness >= 1.0 for fitness in bred) <= 0.2 * others
    assert mannwhitneyu(found, bred, alternative="greater").pvalue < 0.01
    assert mannwhitneyu(found, chance, alternative="greater").pvalue < 0.01


# ---- networks that learn during a trial


def late(parts: Parts, genome: bytes) -> float:
    """Return the share of right decisions in the second half of 200 held-out trials."""
    simulator = parts.problem.simulator
    unseen = np.array(
        [derive_seed(0, "unseen", trial) for trial in range(200)], np.uint64
    )
    outcomes = evaluate(
        simulator,
        parts.problem.representation,
        [genome],
        np.zeros((len(unseen), 1), np.int64),
        unseen,
    )
    return float(outcomes.metrics[:, simulator.metrics.index("late")].mean())


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 5))
def test_a_learning_network_finds_out_what_is_food(seed: int) -> None:
    """Without its learning rate, the champion does not."""
    parts, _ = played("food-or-poison", [f"seed={seed}"])
    champion = parts.optimizer.best()[0]
    assert late(parts, champion) > 0.8
    assert late(parts, champion[:-4] + bytes(4)) < 0.6


@pytest.mark.long
@pytest.mark.parametrize(
    "kept",
    [
        '{kind="fully-meshed",hidden=0,iterations=1}',
        '{kind="fully-meshed",hidden=12}',
    ],
)
def test_networks_that_keep_their_weights_do_not_find_out_what_is_food(kept: str) -> None:
    parts, _ = played("food-or-poison", ["seed=1", f"representation={kept}"])
    assert late(parts, parts.optimizer.best()[0]) < 0.65


# ---- networks without memory


@pytest.mark.long
def test_a_network_without_memory_balances_a_pole() -> None:
    """All 500 steps of five trials: the most there is."""
    assert best("gymnasium") == 2500.0


# ---- random search


@pytest.mark.long
def test_the_baseline_has_the_documented_medians() -> None:
    """The medians in the comment of the example: whole generations within its budget."""
    told = {
        kind: [
            best(
                "baseline", [f"seed={seed}", f'optimizer={{kind="{kind}"}}'], evaluations
            )
            for seed in range(1, 11)
        ]
        for kind, evaluations in (("random", 2206), ("nnga", 2233))
    }
    assert np.median(told["random"]) == pytest.approx(-192, abs=0.5)
    assert np.median(told["nnga"]) == pytest.approx(0.34, abs=0.005)
