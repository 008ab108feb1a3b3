"""The examples of optimizers find what their comments say, and each optimizer beats random search on its example."""

from collections.abc import Sequence

import pytest
from scipy.stats import mannwhitneyu

from zswarm import experiment
from zswarm.evaluate import evaluate
from zswarm.ot import run
from zswarm.ot.assessment import Assessment

STADIUM = ("cea2d", "cuckoo", "openai-es", "pso")


def best(name: str, changes: Sequence[str] = (), evaluations: int = 10**9) -> float:
    """Of an example in one process, after its generations or so many evaluations: what a run of it records."""
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
    return optimizer.best()[1]


@pytest.mark.parametrize("name", STADIUM)
def test_everybody_leaves_the_stadium(name: str) -> None:
    """Fitness above 0 says so."""
    assert best(name) > 0.0


def by_chance(name: str, seed: int, evaluations: int) -> float:
    return best(name, [f"seed={seed}", 'optimizer={kind="random"}', "generations=1000"], evaluations)


@pytest.mark.long
@pytest.mark.parametrize("name", ["stadium", *STADIUM])
def test_each_beats_random_search_at_equal_evaluations(name: str) -> None:
    found = [best(name, [f"seed={seed}"], 2000) for seed in range(10)]
    chance = [by_chance(name, seed, 2000) for seed in range(10)]
    assert mannwhitneyu(found, chance, alternative="greater").pvalue < 0.01


@pytest.mark.long
def test_novelty_finds_the_way_round_where_fitness_leads_behind_a_wall() -> None:
    """The goal of the maze is reached with fitness 1 and more; neither who breeds for nearness nor chance comes there."""
    found = [best("maze", [f"seed={seed}"]) for seed in range(10)]
    bred = [best("maze", [f"seed={seed}", 'optimizer={kind="nnga"}', "generations=1000"], 15_000) for seed in range(10)]
    chance = [by_chance("maze", seed, 15_000) for seed in range(10)]
    assert sum(fitness >= 1.0 for fitness in found) >= 8
    for others in (bred, chance):
        assert sum(fitness >= 1.0 for fitness in others) <= 2
        assert mannwhitneyu(found, others, alternative="greater").pvalue < 0.01
