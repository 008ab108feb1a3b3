"""The learning curve on held-out seeds: the best of each k-th generation plays some of its own."""

from typing import Self

import numpy as np

from zswarm.champion.held_out import HeldOut, Tracked
from zswarm.experiment import Experiment
from zswarm.kernels.random import derive_seed
from zswarm.ot.assessment.amount import TRACKED
from zswarm.ot.assessment.interval import of_mean
from zswarm.ot.problem import Problem
from zswarm.ot.record.digests import real
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload

TRACK = "track"  # purpose of the seeds


def generations(complete: Experiment) -> range:
    """Return the generations of a run that are tracked."""
    each = complete.assessment.track
    return range(each - 1, complete.generations, each) if each else range(0)


class Track:
    """The best of each k-th generation: one workload out, its outcomes in."""

    def __init__(self, problem: Problem, best: list[tuple[int, bytes, float]]) -> None:
        self._problem, self._best = problem, best

    @property
    def trials(self) -> int:
        """Return how many trials it has."""
        return TRACKED * len(self._best)

    @classmethod
    def of_run(cls, problem: Problem, record: Record) -> Self | None:
        """Return what is to be tracked of a run after its last generation, or None."""
        numbers = generations(problem.experiment)
        found = [record.best_of(generation) for generation in numbers]
        best = [one for one in found if one is not None]
        return cls(problem, best) if best else None

    def workload(self, number: int, first: int) -> Workload:
        """Return the trials, as a round after others of the assessment."""
        seed = self._problem.experiment.seed
        seeds = [derive_seed(seed, TRACK, number) for number in range(TRACKED)]
        genomes = [genome for _, genome, _ in self._best]
        last = self._problem.experiment.generations
        work = self._problem.workload(genomes, last, np.array(seeds, np.uint64))
        work.place(last, number, first)
        return work

    def result(self, work: Workload) -> list[Tracked]:
        """Return the fitness of each, failed trials left out."""
        scale = float(self._problem.experiment.problem.trials)
        found = []
        for (generation, _, in_search), fitness in zip(
            self._best, work.fitness.reshape(-1, TRACKED), strict=True
        ):
            played = fitness[~np.isnan(fitness)]
            mean, low, high = (real(scale * value) for value in of_mean(played))
            held_out = HeldOut(
                mean=mean, low=low, high=high, seeds=len(played), in_search=in_search
            )
            found.append(Tracked(generation=generation, held_out=held_out))
        return found
