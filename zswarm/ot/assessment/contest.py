"""The assessment of a run: its candidates, its trials as workloads, and its result."""

import json
from collections.abc import Sequence
from typing import Self

import numpy as np

from zswarm.champion.held_out import HeldOut
from zswarm.errors import ConfigError
from zswarm.kernels.random import derive_seed
from zswarm.ot.assessment.amount import budget_of
from zswarm.ot.assessment.race import LEAST, Race
from zswarm.ot.problem import Problem
from zswarm.ot.record.digests import real
from zswarm.ot.record.history_hash import assessed, digest
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload

RACE, HELD_OUT = "assessment", "held-out"  # purposes of the seeds


class Contest:
    """Candidates that are assessed: workloads out, outcomes in.

    Args:
        genomes: distinct, the best in search first.
        in_search: their fitness there.
        budget: trials in all.
        differ: whether trials are known to differ.

    Attributes:
        plan: a text that is equal for an assessment with the same trials.
        budget: as given.
        round, first: the next round, and how many trials were played before it.
    """

    def __init__(
        self,
        problem: Problem,
        genomes: Sequence[bytes],
        in_search: Sequence[float],
        budget: int,
        *,
        differ: bool,
    ) -> None:
        self._problem, self._in_search, self.budget = problem, in_search, budget
        self._race = Race(len(genomes), budget, differ=differ)
        self._genomes = list(genomes[: self._race.candidates])
        self.round = self.first = 0
        digests = [digest(genome).hex() for genome in self._genomes]
        self.plan = json.dumps([problem.experiment.seed, budget, differ, digests])

    @classmethod
    def of_run(cls, problem: Problem, record: Record) -> Self | None:
        """Return what is to be assessed of a run after its last generation, or None."""
        complete = problem.experiment
        trials = complete.problem.trials
        raced = complete.assessment.racing
        searched = record.trials() if raced else record.evaluations() * trials
        budget = 0 if unfit(problem) else budget_of(complete, searched)
        if not budget:
            return None
        found = record.contenders(complete.assessment.candidates)
        differ = trials > 1 and record.trials_differ(trials)
        known_equal = trials > 1 and not differ and complete.problem.seeds == "fixed"
        if not found or known_equal:
            return None
        genomes, in_search = zip(*found, strict=True)
        return cls(problem, genomes, in_search, budget, differ=differ)

    def workload(self) -> Workload | None:
        """Return the trials to play next; None if it is over."""
        race = self._race
        if race.phase == "over":
            return None
        held_out = race.phase == "held-out"
        players = np.repeat(np.arange(race.candidates), race.trials)
        seeds = [
            self._seed(number, held_out=held_out)
            for played, more in zip(race.fitness, race.trials.tolist(), strict=True)
            for number in range(*_span(0 if held_out else len(played), more))
        ]
        metrics = len(self._problem.simulator.metrics)
        numbers = np.array(seeds, np.uint64)
        work = Workload(self._genomes, players.reshape(-1, 1), numbers, metrics)
        work.place(self._problem.experiment.generations, self.round, self.first)
        return work

    def take(self, workload: Workload) -> None:
        """Take the outcomes of the trials that were to be played."""
        self.round, self.first = self.round + 1, self.first + len(workload.seeds)
        self._race.take(workload.fitness[:, 0] + 0.0, workload.metrics + 0.0)

    def champion(self) -> tuple[bytes, HeldOut] | None:
        """Return the winner's genome and fitness; None if trials do not differ."""
        race, scale = self._race, float(self._problem.experiment.problem.trials)
        if not race.differ:
            return None
        *ends, seeds = race.result()
        mean, low, high = (real(scale * value) for value in ends)
        in_search = self._in_search[race.winner]
        found = HeldOut(mean=mean, low=low, high=high, seeds=seeds, in_search=in_search)
        return self._genomes[race.winner], found

    def hash(self, history: bytes) -> str:
        """Return the history hash of search with this assessment after it: 32 hex digits."""
        return assessed(history, self._genomes, self._race.numbers())

    def _seed(self, number: int, *, held_out: bool) -> int:
        purpose = HELD_OUT if held_out else RACE
        return derive_seed(self._problem.experiment.seed, purpose, number)


def unfit(problem: Problem) -> str:
    """Return why no candidate of a problem can be assessed, or ""."""
    if problem.ranking.relative or problem.simulator.participants > 1:
        return "candidates play each other, so none has a fitness of its own"
    return ""


def check(problem: Problem, candidates: int | None) -> None:
    """Refuse a budget that is given and cannot be used, and a track that has no generation.

    Args:
        candidates: most of a generation; None: unknown.

    Raises:
        ConfigError: it cannot.
    """
    complete = problem.experiment
    budget = complete.assessment.budget
    if (each := complete.assessment.track) and (why := unfit(problem)):
        raise ConfigError(f"assessment: track: expected 0, not {each}: {why}")
    if each > complete.generations:
        raise ConfigError(
            f"assessment: track: expected at most the {complete.generations} generations, not "
            f"{each}"
        )
    if budget == "auto" or not budget:
        return
    if why := unfit(problem):
        raise ConfigError(f"assessment: budget: expected 0, not {budget:g}: {why}")
    if candidates is None:
        return
    trials = complete.generations * candidates * complete.problem.trials
    if int(budget * trials) < LEAST:
        raise ConfigError(
            f"assessment: budget: {budget:g} of the run's {trials:,} simulations at most are fewer "
            f"than a race of two candidates takes: expected {LEAST / trials:.2g} or more, or 0"
        )


def _span(begin: int, count: int) -> tuple[int, int]:
    return begin, begin + count
