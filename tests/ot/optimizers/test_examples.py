"""Examples of methods find what their comments say, and beat random search."""

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
NAMED = {  # optimizers with the example of what they are known for, and evaluations
    **{name: (name, 2000) for name in STADIUM},
    "cmaes": ("long-genome", 2000),
    "neat": ("xor-neat", 3000),
    "nnga": ("stadium", 2000),
    "novelty": ("maze", 15_000),
}
SOME = {"nnga"}  # with make long
# Compared by the score of their archive, also in test_elites.py; and their opponents.
OTHERWISE = {
    "cma-me": "cma-me",
    "map-elites": "minisim-elites",
    "random": "baseline",
}


def best(name: str, changes: Sequence[str] = (), evaluations: int = 10**9) -> float:
    """Return what a run of an example records, played in this process."""
    return evolved(name, changes, evaluations)[0]


def evolved(name: str, changes: Sequence[str], evaluations: int) -> tuple[float, int]:
    """Return the best and the number of evaluations, in whole generations."""
    (_, optimizer), told = played(name, changes, evaluations)
    return optimizer.best()[1], told


@pytest.mark.parametrize("name", STADIUM)
def test_everybody_leaves_the_stadium(name: str) -> None:
    """A fitness above 0 means that all have left."""
    assert best(name) > 0.0


def test_every_optimizer_has_an_example_on_which_it_is_compared() -> None:
    examples = OTHERWISE | {name: example for name, (example, _) in NAMED.items()}
    assert examples.keys() == set(plugins.BUNDLED["optimizer"])
    for name, example in examples.items():
        assert experiment.load(experiment.find(example)).optimizer.kind == name


def test_every_network_has_an_example() -> None:
    """Parts of a bulk do not count."""
    files = experiment.examples_folder().glob("*.toml")
    assert {experiment.load(file).representation.kind for file in files} == set(
        plugins.BUNDLED["representation"]
    )


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name, marks=pytest.mark.long if name in SOME else pytest.mark.thorough
        )
        for name in NAMED
        if name != "novelty"
    ],
)
def test_each_beats_random_search_at_equal_evaluations(name: str) -> None:
    """Random search has as many or some more, of the same genomes."""
    example, evaluations = NAMED[name]
    found, chance = [], []
    for seed in range(8):
        fitness, told = evolved(example, [f"seed={seed}"], evaluations)
        found.append(fitness)
        chance.append(by_chance(example, seed, told))
    assert mannwhitneyu(found, chance, alternative="greater").pvalue < 0.01


@pytest.mark.thorough
def test_novelty_finds_the_way_round_where_fitness_leads_behind_a_wall() -> None:
    """The goal is reached with fitness above 1; breeding for nearness or chance does not."""
    example, evaluations = NAMED["novelty"]
    seeds = range(5)
    found = [best(example, [f"seed={seed}"]) for seed in seeds]
    bred = [
        best(
            example,
            [f"seed={seed}", 'optimizer={kind="nnga"}', "generations=1000"],
            evaluations,
        )
        for seed in seeds
    ]
    chance = [by_chance(example, seed, evaluations) for seed in seeds]
    assert sum(fitness >= 1.0 for fitness in found) >= 4
    assert sum(fitness >= 1.0 for fitness in bred) <= 1
    assert mannwhitneyu(found, bred, alternative="greater").pvalue < 0.01
    assert mannwhitneyu(found, chance, alternative="greater").pvalue < 0.01


def by_chance(example: str, seed: int, evaluations: int) -> float:
    return best(
        example,
        [f"seed={seed}", 'optimizer={kind="random"}', "generations=1000"],
        evaluations,
    )


@pytest.mark.thorough
def test_cma_me_has_a_higher_score_than_map_elites_with_as_many_candidates() -> None:
    """Six of the ten seeds of the example's comment."""
    scores = {
        name: [
            played(name, [f"seed={seed}", "generations=100"])[0].optimizer.statistics()[
                "qd_score"
            ]
            for seed in range(1, 7)
        ]
        for name in ("cma-me", "minisim-elites")
    }
    assert (
        mannwhitneyu(
            scores["cma-me"], scores["minisim-elites"], alternative="greater"
        ).pvalue
        < 0.01
    )


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


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(1, marks=pytest.mark.long),
        *(pytest.param(seed, marks=pytest.mark.thorough) for seed in range(2, 5)),
    ],
)
def test_a_learning_network_finds_out_what_is_food(seed: int) -> None:
    """Without its learning rate, the champion does not."""
    parts, _ = played("food-or-poison", [f"seed={seed}"])
    champion = parts.optimizer.best()[0]
    assert late(parts, champion) > 0.8
    assert late(parts, champion[:-4] + bytes(4)) < 0.6


@pytest.mark.parametrize(
    "kept",
    [
        pytest.param(
            '{kind="fully-meshed",hidden=0,iterations=1}', marks=pytest.mark.thorough
        ),
        pytest.param('{kind="fully-meshed",hidden=12}', marks=pytest.mark.long),
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
