"""Whether evolution finds controllers that are better than random ones, on seeds that it never saw."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import mannwhitneyu

from zswarm import experiment
from zswarm.draws import Stream, derive_seed
from zswarm.evaluate import evaluate
from zswarm.ot import run
from zswarm.ot.problem import Problem

UNSEEN = 40  # trials


class Comparison(NamedTuple):
    """Of a champion with random controllers, one for each trial."""

    champion: float  # median fitness
    at_random: float
    p: float  # of the champion's trials being no better


def compared(
    simulator: str, settings: Mapping[str, Any], seed: int, generations: int, population: int = 20, trials: int = 3, **parts: Any
) -> Comparison:
    """Evolve a small network, by default a feed-forward one by the genetic algorithm, and compare its champion."""
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
    seeds = np.array([derive_seed(0, "unseen", trial) for trial in range(UNSEEN)], np.uint64)
    champion = played(problem, [optimizer.best()[0]], np.zeros((UNSEEN, 1), np.int64), seeds)[:, 0]
    others = problem.representation.random(UNSEEN, Stream(derive_seed(seed, "others")))
    at_random = played(problem, others, np.arange(UNSEEN).reshape(-1, 1), seeds)[:, 0]
    assert np.isfinite(champion).all()
    assert np.isfinite(at_random).all()
    p = mannwhitneyu(champion, at_random, alternative="greater").pvalue
    return Comparison(float(np.median(champion)), float(np.median(at_random)), float(p))


def played(problem: Problem, genomes: list[bytes], participants: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """(trials, participants) fitness."""
    return evaluate(problem.simulator, problem.representation, genomes, participants, seeds).fitness
