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
from zswarm.sims.simulator import Simulator


class Comparison(NamedTuple):
    """Mean fitness on the same unseen seeds."""

    evolved: np.ndarray  # of the champion of each run
    searched: np.ndarray  # of the best of random search with as many evaluations, on the same trials; none without
    networks: np.ndarray  # of random networks
    actions: np.ndarray  # of agents that do anything, decision by decision

    @property
    def p(self) -> float:
        """Of the champions being no better than any of the others (Mann-Whitney's test), the largest."""
        others = [group for group in self[1:] if len(group)]
        return max(float(mannwhitneyu(self.evolved, group, alternative="greater").pvalue) for group in others)


def compared(
    simulator: str,
    settings: Mapping[str, Any],
    *,
    generations: int,
    runs: int = 5,
    search: bool = False,
    population: int = 16,
    trials: int = 3,
    unseen: int = 15,
    others: int = 20,
    **parts: Any,
) -> Comparison:
    """Evolve a small network some times, by default without a hidden layer by CMA-ES, and compare the champions.

    Args:
        runs: how many, each with a seed of its own.
        search: have as many of random search.
        unseen: trials by which controllers are judged.
        others: random networks, and players of random actions.
    """
    seeds = np.array([derive_seed(0, "unseen", trial) for trial in range(unseen)], np.uint64)
    evolved, searched = [], []
    for seed in range(1, runs + 1):
        problem, champion, evaluations = best(simulator, settings, seed, trials, parts, population, generations * population)
        evolved.append(mean(problem, champion, seeds))
        if search:
            at_random = {**parts, "optimizer": {"kind": "random", "population": population}}
            problem, champion, _ = best(simulator, settings, seed, trials, at_random, population, evaluations)
            searched.append(mean(problem, champion, seeds))
    networks = [mean(problem, each, seeds) for each in problem.representation.random(others, Stream(derive_seed(0, "others")))]
    actions = [anything(problem.simulator, seeds, Stream(derive_seed(0, "actions", other))) for other in range(others)]
    found = Comparison(*(np.array(each) for each in (evolved, searched, networks, actions)))
    assert all(np.isfinite(each).all() for each in found)
    return found


def best(
    simulator: str,
    settings: Mapping[str, Any],
    seed: int,
    trials: int,
    parts: Mapping[str, Any],
    population: int,
    evaluations: int,
) -> tuple[Problem, bytes, int]:
    """The problem, the best genome after so many evaluations at least, and how many there were."""
    file = {
        "name": "it",
        "seed": seed,
        "generations": 1_000,
        "problem": {"simulator": simulator, "trials": trials, "settings": dict(settings)},
        "representation": {"kind": "feed-forward", "hidden": []},
        "optimizer": {"kind": "cmaes", "population": population},
    }
    problem, optimizer = run.build(experiment.complete(experiment.check({**file, **parts}, "it"), "it"))
    done = 0
    while done < evaluations:
        genomes = optimizer.ask()
        workload = problem.workload(genomes, optimizer.generation)
        workload.fitness[:] = played(problem, genomes, workload.participants, workload.seeds)
        optimizer.tell(problem.total(workload))
        done += len(genomes)
    return problem, optimizer.best()[0], done


def mean(problem: Problem, genome: bytes, seeds: np.ndarray) -> float:
    """Fitness of a genome on some seeds."""
    return float(played(problem, [genome], np.zeros((len(seeds), 1), np.int64), seeds).mean())


def played(problem: Problem, genomes: list[bytes], participants: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """(trials, participants) fitness."""
    return evaluate(problem.simulator, problem.representation, genomes, participants, seeds).fitness


def anything(simulator: Simulator, seeds: np.ndarray, stream: Stream) -> float:
    """Fitness of agents whose outputs are drawn anew in each decision: any choice, any number between the bounds."""
    fitness = []
    for seed in seeds:
        turn = simulator.reset(int(seed))
        while turn is not None:
            actions = stream.uniform(0.0, 1.0, len(turn.agents) * simulator.outputs).astype(np.float32)
            turn = simulator.step(actions.reshape(-1, simulator.outputs))
        fitness.append(simulator.outcome().fitness[0])
    return float(np.mean(fitness))
