"""The examples of optimizers find what their comments say, and each optimizer beats random search on its example."""

from collections.abc import Sequence

import pytest
from scipy.stats import mannwhitneyu

from zswarm import experiment, plugins
from zswarm.evaluate import evaluate
from zswarm.ot import run
from zswarm.ot.assessment import Assessment

STADIUM = ("cea2d", "cuckoo", "openai-es", "pso")
NAMED = {  # optimizers with the example of what they are known for, and evaluations
    **{name: (name, 2000) for name in STADIUM},
    "cmaes": ("long-genome", 2000),
    "neat": ("xor-neat", 3000),
    "nnga": ("stadium", 2000),
    "novelty": ("maze", 15_000),
}
BY_SCORE = {"cma-me", "map-elites"}  # of the archive: tests/ot/test_elites.py


def best(name: str, changes: Sequence[str] = (), evaluations: int = 10**9) -> float:
    """Of an example in one process, after its generations or so many evaluations: what a run of it records."""
    return evolved(name, changes, evaluations)[0]


def evolved(name: str, changes: Sequence[str], evaluations: int) -> tuple[float, int]:
    """The best, and how many evaluations there were: whole generations, as many as it takes for those asked for."""
    loaded = experiment.load(experiment.examples_folder() / f"{name}.toml", changes)
    complete = experiment.complete(loaded, name)
    (problem, optimizer), told = run.build(complete), 0
    for generation in range(complete.generations):
        assessment, more = Assessment(problem, optimizer.ask(), generation), True
        while more:
            workload = assessment.workload
            outcomes = evaluate(
                problem.simulator, problem.representation, workload.genomes, workload.participants, workload.seeds
            )
            workload.fitness[:], workload.metrics[:] = outcomes.fitness, outcomes.metrics
            more = assessment.advance()
        optimizer.tell(assessment.fitness(), assessment.measures(optimizer.measures))
        told += len(assessment.genomes)
        if told >= evaluations:
            break
    return optimizer.best()[1], told


@pytest.mark.parametrize("name", STADIUM)
def test_everybody_leaves_the_stadium(name: str) -> None:
    """Fitness above 0 says so."""
    assert best(name) > 0.0


def test_every_optimizer_has_an_example_on_which_it_is_compared() -> None:
    assert NAMED.keys() | BY_SCORE | {"random"} == set(plugins.BUNDLED["optimizer"])
    for name, (example, _) in NAMED.items():
        assert experiment.load(experiment.find(example)).optimizer.kind == name


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in NAMED if name != "novelty"])
def test_each_beats_random_search_at_equal_evaluations(name: str) -> None:
    """Random search has as many or some more, of the same genomes."""
    example, evaluations = NAMED[name]
    found, chance = [], []
    for seed in range(10):
        fitness, told = evolved(example, [f"seed={seed}"], evaluations)
        found.append(fitness)
        chance.append(by_chance(example, seed, told))
    assert mannwhitneyu(found, chance, alternative="greater").pvalue < 0.01


@pytest.mark.long
def test_novelty_finds_the_way_round_where_fitness_leads_behind_a_wall() -> None:
    """The goal is reached with fitness 1 and more; who breeds for nearness to it does not come there, and chance is worse."""
    example, evaluations = NAMED["novelty"]
    found = [best(example, [f"seed={seed}"]) for seed in range(10)]
    bred = [best(example, [f"seed={seed}", 'optimizer={kind="nnga"}', "generations=1000"], evaluations) for seed in range(10)]
    chance = [by_chance(example, seed, evaluations) for seed in range(10)]
    assert sum(fitness >= 1.0 for fitness in found) >= 8
    assert sum(fitness >= 1.0 for fitness in bred) <= 2
    assert mannwhitneyu(found, bred, alternative="greater").pvalue < 0.01
    assert mannwhitneyu(found, chance, alternative="greater").pvalue < 0.01


def by_chance(example: str, seed: int, evaluations: int) -> float:
    return best(example, [f"seed={seed}", 'optimizer={kind="random"}', "generations=1000"], evaluations)
