"""A race of candidates on seeds that evolution never uses: outcomes in, trials to play out.

First the candidate that is best in search plays a few seeds alone: if all outcomes are equal,
trials may not differ at all, and there is nothing to race for. Then all play these seeds. Then OCBA
gives more seeds to those that may be the best, in rounds. At the end the winner plays further
seeds, whose mean no choice was based on. A candidate's nth trial has the nth seed, so all play the
same seeds.
"""

from typing import Literal

import numpy as np

from zswarm.kernels.sums import mean
from zswarm.ot.assessment import ocba
from zswarm.ot.assessment.interval import of_mean, variance

FIRST = 10  # seeds of each in the first round
ROUNDS = 8  # at most, of those that OCBA allocates
HELD_OUT = 4  # the winner's further seeds are a fourth of the budget
LEAST = 3 * FIRST  # trials: two that race, and the winner's further seeds

Phase = Literal["probe", "race", "held-out", "over"]


class Race:
    """Which trials the candidates play next, within a budget.

    Args:
        candidates: how many are available, the best in search first.
        budget: trials in all, at least ``LEAST``.
        differ: whether trials are known to differ from seed to seed.

    Attributes:
        phase: what the trials are for that are played next.
        trials: (candidates,) trials that each is to play next, in addition.
        fitness: of each candidate on its seeds, in their order.
        held_out: (seeds,) of the winner on its further ones.
        differ: whether trials differ, as far as it is known.
    """

    def __init__(self, candidates: int, budget: int, *, differ: bool) -> None:
        held_out = max(FIRST, budget // HELD_OUT)
        # At least half of the trials before those are OCBA's to allocate.
        racing = max(2, (budget - held_out) // (2 * FIRST))
        self.candidates = min(candidates, racing)
        self.differ = differ
        self.phase: Phase = "probe"
        self.trials = np.zeros(self.candidates, np.int64)
        self.trials[0] = FIRST
        self.fitness: list[np.ndarray] = [np.empty(0)] * self.candidates
        self.held_out = np.empty(0)
        self._left, self._further = budget - held_out, held_out
        self._step = 0

    @property
    def winner(self) -> int:
        """Return the candidate with the highest mean, the first of equals; failed ones are last."""
        return int(np.argmax(self.means()))

    def means(self) -> np.ndarray:
        """Return the mean of each, (candidates,) float64; -inf: a trial failed, or no trial yet."""
        failed = [not len(one) or np.isnan(one).any() for one in self.fitness]
        found = [
            -np.inf if bad else mean(one)
            for bad, one in zip(failed, self.fitness, strict=True)
        ]
        return np.array(found)

    def take(self, fitness: np.ndarray, metrics: np.ndarray) -> None:
        """Take the outcomes of the trials to play, candidate after candidate; choose the next ones.

        Args:
            fitness: (trials,) float64.
            metrics: (trials, metrics) float64.
        """
        if self.phase == "held-out":
            self.held_out, self.phase = fitness, "over"
            return
        begin = 0
        for number, count in enumerate(self.trials.tolist()):
            more = fitness[begin : (begin := begin + count)]
            self.fitness[number] = np.concatenate([self.fitness[number], more])
        self._left -= begin
        if self.phase == "probe":
            outcomes = np.column_stack([fitness, metrics])
            first = np.broadcast_to(outcomes[0], outcomes.shape)
            same = np.array_equal(outcomes, first, equal_nan=True)
            self.differ = self.differ or not same
        self._choose()

    def _choose(self) -> None:
        """Choose the trials to play next."""
        if not self.differ:
            self.phase, self.trials = "over", np.zeros_like(self.trials)
        elif self.phase == "probe" and self.candidates > 1:
            self.phase = "race"
            self.trials = np.full(self.candidates, FIRST)
            self.trials[0] = 0
        elif self.candidates == 1 or not (more := self._allocated()).any():
            self.phase = "held-out"
            self.trials = np.zeros(self.candidates, np.int64)
            self.trials[self.winner] = self._further
        else:
            self.trials = more

    def _allocated(self) -> np.ndarray:
        """Return the trials of the next round, (candidates,): none if the race is decided."""
        more = np.zeros(self.candidates, np.int64)
        means = self.means()
        running = np.flatnonzero(np.isfinite(means))
        variances = np.array([variance(self.fitness[one]) for one in running])
        if self._left <= 0 or len(running) < 2 or not variances.max() > 0.0:
            return more
        self._step = self._step or -(-self._left // ROUNDS)
        spent = np.array([len(self.fitness[one]) for one in running])
        budget = min(self._step, self._left)
        more[running] = ocba.allocate(means[running], variances, spent, budget)
        return more

    def numbers(self) -> np.ndarray:
        """Return all outcomes, candidate after candidate, and the held-out ones: float64."""
        return np.concatenate([*self.fitness, self.held_out])

    def result(self) -> tuple[float, float, float, int]:
        """Return the winner's mean on its further seeds, its 95 % interval, and their number.

        Failed trials do not count.
        """
        played = self.held_out[~np.isnan(self.held_out)]
        return *of_mean(played), len(played)
