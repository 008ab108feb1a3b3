"""Sample an experiment: how many candidates and games a generation has, without a run."""

import time

import numpy as np

from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.ot.problem import Problem
from zswarm.ot.rankings.ranking import Round


def breed(optimizer: Optimizer, candidates: int) -> tuple[list[bytes], float]:
    """Tell the optimizer arbitrary fitness; return the next generation, and the seconds it took."""
    fitness = np.arange(candidates, dtype=np.float64)
    begin = time.perf_counter()
    optimizer.tell(fitness, np.zeros((candidates, len(optimizer.measures))))
    return optimizer.ask(), time.perf_counter() - begin


def rounds(problem: Problem, candidates: int) -> list[int]:
    """Return the games in each round of a generation, if all of them are tied."""
    played: list[Round] = []
    while (games := problem.ranking.next_games(candidates, played)) is not None:
        played.append(Round(games, np.zeros(games.shape)))
    return [len(round_.games) for round_ in played]


def simulations(problem: Problem, candidates: int) -> int:
    """Return the simulations of a generation."""
    return sum(rounds(problem, candidates)) * problem.experiment.problem.trials
