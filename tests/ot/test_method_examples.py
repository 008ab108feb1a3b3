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
@pytest.mark.parametrize(("name", "evaluations"), [*((name, 2000) for name in ("stadium", *STADIUM)), ("novelty", 1500)])
def test_each_beats_random_search_at_equal_evaluations(name: str, evaluations: int) -> None:
    """Also novelty search, which is not told what is good: robots that do what none did come together, too."""
    found = [best(name, [f"seed={seed}"], evaluations) for seed in range(10)]
    chance = [by_chance(name, seed, evaluations) for seed in range(10)]
    assert mannwhitneyu(found, chance, alternative="greater").pvalue < 0.01


@pytest.mark.long
def test_novelty_gathers_robots_nearly_as_well_as_who_breeds_for_it() -> None:
    """Of 3 at best: about 2.4 by either, 2.1 by chance, after 1,500 evaluations."""
    found = sorted(best("novelty", [f"seed={seed}"]) for seed in (1, 2, 3))
    bred = sorted(best("novelty", [f"seed={seed}", 'optimizer={kind="nnga"}'], 1500) for seed in (1, 2, 3))
    assert found[1] > 2.3
    assert found[1] > bred[1] - 0.2
