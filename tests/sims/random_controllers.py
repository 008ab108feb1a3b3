"""Compare evolved controllers with random ones on held-out seeds."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import mannwhitneyu

from zswarm import experiment
from zswarm.evaluate import evaluate
from zswarm.kernels.random import Stream, derive_seed
from zswarm.ot.build import build
from zswarm.ot.problem import Problem
from zswarm.sims.simulator import Simulator


class Comparison(NamedTuple):
    """Mean fitness on the same held-out seeds."""

    evolved: np.ndarray  # of the champion of each run
    # Of the best of random search with as many evaluations, on the same trials; none without.
    searched: np.ndarray
    networks: np.ndarray  # of random networks
    actions: np.ndarray  # of agents that do anything, decision by decision

    @property
    def p(self) -> float:
        """Return the largest Mann-Whitney p-value over the other groups.

        The null hypothesis is that the champions are no better than the group.
        """
        others = [group for group in self[1:] if len(group)]
        return max(
            float(mannwhitneyu(self.evolved, group, alternative="greater").pvalue)
            for group in others
        )


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
    """Evolve a small network several times and compare the champions with random controllers.

    By default the network has no hidden layer, and CMA-ES evolves it.

    Args:
        runs: number of runs, each with a different seed.
        search: do as many runs of random search.
        unseen: number of held-out trials that controllers are judged by.
        others: number of random networks, and of agents with random actions.
    """
    seeds = np.array(
        [derive_seed(0, "unseen", trial) for trial in range(unseen)], np.uint64
    )
    evolved, searched = [], []
    for seed in range(1, runs + 1):
        problem, champion, evaluations = best(
            simulator, settings, seed, trials, parts, population, generations * population
        )
        evolved.append(mean(problem, champion, seeds))
        if search:
            at_random = {
                **parts,
                "optimizer": {"kind": "random", "population": population},
            }
            problem, champion, _ = best(
                simulator, settings, seed, trials, at_random, population, evaluations
            )
            searched.append(mean(problem, champion, seeds))
    networks = [
        mean(problem, each, seeds)
        for each in problem.representation.random(
            others, Stream(derive_seed(0, "others"))
        )
    ]
    actions = [
        anything(problem.simulator, seeds, Stream(derive_seed(0, "actions", other)))
        for other in range(others)
    ]
    found = Comparison(
        *(np.array(each) for each in (evolved, searched, networks, actions))
    )
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
    """Return the problem, the best genome after at least that many evaluations, their number."""
    file = {
        "name": "it",
        "seed": seed,
        "generations": 1_000,
        "problem": {"simulator": simulator, "trials": trials, "settings": dict(settings)},
        "representation": {"kind": "feed-forward", "hidden": []},
        "optimizer": {"kind": "cmaes", "population": population},
    }
    problem, optimizer = build(
        experiment.complete(experiment.check({**file, **parts}, "it"), "it")
    )
    done = 0
    while done < evaluations:
        genomes = optimizer.ask()
        workload = problem.workload(genomes, optimizer.generation)
        workload.fitness[:] = played(
            problem, genomes, workload.participants, workload.seeds
        )
        optimizer.tell(problem.total(workload))
        done += len(genomes)
    return problem, optimizer.best()[0], done


def mean(problem: Problem, genome: bytes, seeds: np.ndarray) -> float:
    """Return the fitness of a genome on some seeds."""
    return float(
        played(problem, [genome], np.zeros((len(seeds), 1), np.int64), seeds).mean()
    )


def played(
    problem: Problem, genomes: list[bytes], participants: np.ndarray, seeds: np.ndarray
) -> np.ndarray:
    """Return (trials, participants) fitness."""
    return evaluate(
        problem.simulator, problem.representation, genomes, participants, seeds
    ).fitness


def anything(simulator: Simulator, seeds: np.ndarray, stream: Stream) -> float:
    """Return the mean fitness of agents with random outputs.

    In each decision they draw any choice and any number within the bounds.
    """
    fitness = []
    for seed in seeds:
        turn = simulator.reset(int(seed))
        while turn is not None:
            actions = stream.uniform(
                0.0, 1.0, len(turn.agents) * simulator.outputs
            ).astype(np.float32)
            turn = simulator.step(actions.reshape(-1, simulator.outputs))
        fitness.append(simulator.outcome().fitness[0])
    return float(np.mean(fitness))
