"""Sample an experiment: how many candidates and games a generation has, without a run."""

import time
from typing import NamedTuple

import numpy as np

from zswarm.ot.assessment import amount, contest
from zswarm.ot.build import Parts
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.ot.problem import Problem
from zswarm.ot.rankings.ranking import Round

MOST_BRED = 5_000  # candidates of a first generation, up to which a second one is bred


class Effort(NamedTuple):
    """What each run of a setting takes."""

    first: int  # candidates of the first generation
    later: int
    generations: int
    evaluations: int
    simulations: int  # at most
    assessment_simulations: int  # at most, after the last generation
    first_simulations: int  # of the first generation
    later_simulations: int


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


def effort(parts: Parts) -> Effort:
    """Count the work of a run up to its budget or its last generation; the parts are used up."""
    problem, optimizer = parts
    first = later = len(optimizer.ask())
    if first <= MOST_BRED:
        later = len(breed(optimizer, first)[0])
    return counted(problem, first, later)


def counted(problem: Problem, first: int, later: int) -> Effort:
    """Count the work of a run whose generations have so many candidates."""
    complete = problem.experiment
    played = simulations(problem, first), simulations(problem, later)
    generations, stop = complete.generations, complete.stop
    for limit, begin, each in (
        (stop.evaluations, first, later),
        (stop.simulations, *played),
    ):
        if limit:
            generations = min(generations, fitting(limit, begin, each))
    others = generations - 1
    searched = played[0] + others * played[1]
    expected = round(amount.played(complete) * searched)
    fit = contest.unfit(problem) == ""
    return Effort(
        first,
        later,
        generations,
        first + others * later,
        searched,
        amount.trials_after(complete, expected, generations, fit=fit),
        *played,
    )


def fitting(limit: int, first: int, later: int) -> int:
    """Return the generations that a budget has room for: the first one is played in any case."""
    return 1 + max(0, limit - first) // max(1, later)
