"""Whether evolution finds controllers that are better than random ones, on seeds that it never saw."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import mannwhitneyu

from zswarm import experiment
from zswarm.draws import Stream, derive_seed
from zswarm.evaluate import evaluate
from zswarm.ot import run
from zswarm.ot.problem import Problem


class Comparison(NamedTuple):
    """Of the champions of some runs with random controllers, one for each trial."""

    champions: float  # median fitness
    at_random: float
    p: float  # of the champions' trials being no better


def compared(
    simulator: str,
    settings: Mapping[str, Any],
    *,
    seeds: Sequence[int],
    generations: int,
    population: int = 20,
    trials: int = 3,
    unseen: int = 40,
    **parts: Any,
) -> Comparison:
    """Evolve a small network from each seed, by default a feed-forward one by the genetic algorithm, and compare the champions.

    Args:
        unseen: trials of each champion.
    """
    champions, at_random = [], []
    for seed in seeds:
        problem, champion = evolved(simulator, settings, seed, generations, population, trials, parts)
        trial_seeds = np.array([derive_seed(0, "unseen", trial) for trial in range(unseen)], np.uint64)
        others = problem.representation.random(unseen, Stream(derive_seed(seed, "others")))
        champions.append(played(problem, [champion], np.zeros((unseen, 1), np.int64), trial_seeds)[:, 0])
        at_random.append(played(problem, others, np.arange(unseen).reshape(-1, 1), trial_seeds)[:, 0])
    assert np.isfinite(champions).all()
    assert np.isfinite(at_random).all()
    p = mannwhitneyu(np.ravel(champions), np.ravel(at_random), alternative="greater").pvalue
    return Comparison(float(np.median(champions)), float(np.median(at_random)), float(p))


def evolved(
    simulator: str,
    settings: Mapping[str, Any],
    seed: int,
    generations: int,
    population: int,
    trials: int,
    parts: Mapping[str, Any],
) -> tuple[Problem, bytes]:
    """The problem, and the champion."""
    file = {
        "name": "it",
        "seed": seed,
        "generations": generations,
        "problem": {"simulator": simulator, "trials": trials, "settings": dict(settings)},
        "representation": {"kind": "feed-forward", "hidden": [8], "activation": "tanh"},
        "optimizer": {"kind": "nnga", "population": population},
    }
    problem, optimizer = run.build(experiment.complete(experiment.check({**file, **parts}, "it"), "it"))
    for generation in range(generations):
        genomes = optimizer.ask()
        workload = problem.workload(genomes, generation)
        workload.fitness[:] = played(problem, genomes, workload.participants, workload.seeds)
        optimizer.tell(problem.total(workload))
    return problem, optimizer.best()[0]


def played(problem: Problem, genomes: list[bytes], participants: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """(trials, participants) fitness."""
    return evaluate(problem.simulator, problem.representation, genomes, participants, seeds).fitness
