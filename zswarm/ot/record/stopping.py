"""Judge after each generation whether a run ends before its last one (``[stop]``)."""

import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import msgspec

from zswarm.config.sections import StopConfig
from zswarm.experiment import Experiment
from zswarm.system.format import duration, plural

BUDGET_USED = "the budget is used"
STOPPED = "stopped"  # key of ``meta``


class Spent(NamedTuple):
    """What a finished generation found, and took."""

    best: float | None  # fitness
    evaluations: int
    simulations: int
    seconds: float


class StopWatch:
    """Adds up what a run has used, and tells why it is to end.

    Args:
        trials: of a candidate.
        finished: generations that were recorded earlier.
    """

    def __init__(self, stop: StopConfig, trials: int, finished: Iterable[Spent]) -> None:
        self._stop, self._trials = stop, trials
        self._evaluations = self._simulations = self._stagnant = 0
        self._seconds, self._best = 0.0, -float("inf")
        self._last: Spent | None = None
        for spent in finished:
            self.take(spent)

    def take(self, spent: Spent) -> None:
        """Count a generation."""
        self._last = spent
        self._evaluations += spent.evaluations
        self._simulations += spent.simulations
        self._seconds += spent.seconds
        self._stagnant += 1
        if spent.best is not None and spent.best > self._best:
            self._best, self._stagnant = spent.best, 0

    def generations_left(self) -> int | None:
        """Return how many more fit into the budgets, each like the last one; None: no budget."""
        stop, last = self._stop, self._last
        if last is None:
            return None
        budgets = (
            (stop.evaluations, self._evaluations, last.evaluations),
            (stop.simulations, self._simulations, last.simulations),
        )
        fitting = [
            max(0, limit - used) // max(1, each) for limit, used, each in budgets if limit
        ]
        return min(fitting, default=None)

    def reason(self) -> str:
        """Return why the run ends after the last generation that was counted, or ""."""
        stop, last = self._stop, self._last
        if last is None:
            return ""
        if stop.evaluations and self._evaluations + last.evaluations > stop.evaluations:
            used = f"{self._evaluations:,} of {plural(stop.evaluations, 'evaluation')}"
            return f"{BUDGET_USED}: {used}"
        if stop.simulations and self._simulations + last.simulations > stop.simulations:
            used = f"{self._simulations:,} of {plural(stop.simulations, 'simulation')}"
            return f"{BUDGET_USED}: {used}"
        wanted = stop.fitness
        if wanted != "none" and self._best / self._trials >= wanted:
            return f"a candidate has the fitness {wanted:g} that was asked for"
        if stop.stagnation and self._stagnant >= stop.stagnation:
            return f"{plural(self._stagnant, 'generation')} found nothing better"
        if stop.seconds and self._seconds >= stop.seconds:
            return f"{duration(stop.seconds)} of computing are over"
        return ""


def expected_generations(
    complete: Experiment, done: int, evaluations: int, last: int
) -> int:
    """Return how many generations a run has, by its budgets, if the others are as large.

    Args:
        done: finished generations.
        evaluations: in all of them.
        last: evaluations in the last one.
    """
    trials, parts = complete.problem.trials, (evaluations - last, last)
    spent = [Spent(None, count, count * trials, 0.0) for count in parts]
    left = StopWatch(complete.stop, trials, spent if done else ()).generations_left()
    most = complete.generations
    return most if left is None else min(most, done + left)


def entry(stop: StopConfig, reason: str) -> str:
    """Return the text that the record keeps of a run that ended."""
    return json.dumps({"stop": msgspec.to_builtins(stop), "why": reason})


def ended(meta: Mapping[str, Any], complete: Experiment) -> str:
    """Return why a run ended before its last generation, or "".

    A reason does not count after ``[stop]`` was changed.
    """
    try:
        found = json.loads(meta.get(STOPPED, ""))
        same = found["stop"] == msgspec.to_builtins(complete.stop)
        return str(found["why"]) if same else ""
    except (LookupError, TypeError, ValueError):
        return ""
