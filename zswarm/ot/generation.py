"""A generation under evaluation: rounds of games, until the ranking has what it needs.

With racing the rounds are of trials, for candidates that may still survive.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from zswarm.ot.assessment import racing
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.ot.problem import Problem
from zswarm.ot.rankings.ranking import Round
from zswarm.ot.workload import Workload


class Assessment:
    """Genomes of one generation, evaluated round by round.

    Attributes:
        genomes, generation: as given.
        workload: the games of the present round, on the generation's trials.
    """

    def __init__(self, problem: Problem, genomes: list[bytes], generation: int) -> None:
        """Begin the first round, or raise ConfigError if there are too few genomes for a game."""
        self.genomes, self.generation = genomes, generation
        self._problem = problem
        self._workloads: list[Workload] = []
        self._rounds: list[Round] = []
        self._begin(problem.ranking.next_games(len(genomes), ()))

    @property
    def trials(self) -> int:
        """The number of trials of all rounds so far."""
        return int(sum(len(workload.seeds) for workload in self._workloads))

    def differ(self) -> bool:
        """Return whether trials of a candidate may differ, as far as the first round shows."""
        work = self._workloads[0]
        if work.participants.shape[1] > 1 or self._problem.experiment.problem.trials == 1:
            return True
        outcomes = np.column_stack([work.fitness, work.metrics])
        each = outcomes.reshape(len(self.genomes), -1, outcomes.shape[1])
        return not np.array_equal(each[:, 1:], each[:, :-1], equal_nan=True)

    def advance(self) -> bool:
        """Begin the next round when all of this one is counted; return False if there is none."""
        self._rounds.append(self._problem.played(self.workload))
        games = self._problem.ranking.next_games(len(self.genomes), self._rounds)
        if games is None:
            return False
        self._begin(games)
        return True

    def fitness(self) -> np.ndarray:
        """Return the ranking's scores after the last round: (candidates,) float64."""
        return self._problem.ranking.scores(len(self.genomes), self._rounds)

    def measures(self, names: Sequence[str]) -> np.ndarray:
        """Return the mean of each metric over a candidate's trials, added in trial order.

        The result is (candidates, names) float64; NaN where a mean is not finite.
        """
        columns = [self._problem.simulator.metrics.index(name) for name in names]
        total = np.zeros((len(self.genomes), len(columns)))
        trials = np.zeros((len(self.genomes), 1))
        if not columns:
            return total
        with np.errstate(over="ignore", invalid="ignore"):
            for workload in self._workloads:
                who = workload.participants.ravel()
                players = workload.participants.shape[1]
                np.add.at(
                    total, who, np.repeat(workload.metrics[:, columns], players, axis=0)
                )
                np.add.at(trials, who, 1)
            mean = total / trials
        return np.where(np.isfinite(mean), mean, np.nan)

    def _begin(self, games: np.ndarray | None) -> None:
        self._play(self._problem.workload(self.genomes, self.generation, games=games))

    def _play(self, workload: Workload, numbers: np.ndarray | None = None) -> None:
        """Make a workload the present one; see ``Workload.place`` about the numbers."""
        workload.place(self.generation, len(self._workloads), self.trials, numbers)
        self._workloads.append(workload)
        self.workload = workload


class ResampledAssessment(Assessment):
    """Genomes of one generation, of which those asked for again play further seeds."""

    def _begin(self, games: np.ndarray | None) -> None:
        workload = self._problem.workload(self.genomes, self.generation, games=games)
        seen: Counter[bytes] = Counter()
        times = []
        for genome in self.genomes:
            times.append(seen[genome])
            seen[genome] += 1
        trials = self._problem.experiment.problem.trials
        every = self._problem.trial_seeds(self.generation, trials * (max(times) + 1))
        times_of_games = np.array(times)[workload.participants[::trials, 0]]
        workload.seeds = every.reshape(-1, trials)[times_of_games].ravel()
        self._play(workload)


class RacedAssessment(Assessment):
    """Genomes of one generation whose trials stop when they will hardly survive.

    Args:
        survivors: how many of them may survive.
    """

    def __init__(
        self, problem: Problem, genomes: list[bytes], generation: int, survivors: int
    ) -> None:
        self._survivors = survivors
        trials = problem.experiment.problem.trials
        self._ends = [0, *racing.rounds(trials)]
        self._fitness = np.full((len(genomes), trials), np.nan)
        self._played = np.zeros(len(genomes), np.int64)
        self._running = np.arange(len(genomes))
        super().__init__(problem, genomes, generation)

    def advance(self) -> bool:
        """See ``Assessment``."""
        begin, end = self._ends[:2]
        fitness = self.workload.fitness.reshape(-1, end - begin)
        self._fitness[self._running, begin:end] = fitness
        self._played[self._running] = end
        self._ends.pop(0)
        if len(self._ends) == 1:
            return False
        far = self._fitness[self._running, :end]
        self._running = self._running[racing.remaining(far, self._survivors)]
        if not len(self._running):
            return False
        self._begin(None)
        return True

    def fitness(self) -> np.ndarray:
        """See ``Assessment``."""
        return racing.totals(self._fitness, self._played)

    def _begin(self, games: np.ndarray | None) -> None:  # noqa: ARG002  each plays alone
        begin, end = self._ends[:2]
        numbers = self._running[:, None] * self._fitness.shape[1] + np.arange(begin, end)
        workload = self._problem.workload(
            self.genomes,
            self.generation,
            self._problem.trial_seeds(self.generation)[begin:end],
            self._running[:, None],
        )
        self._play(workload, numbers.ravel())


def assess(problem: Problem, optimizer: Optimizer, generation: int) -> Assessment:
    """Ask an optimizer for a generation, and begin its first round."""
    genomes = optimizer.ask()
    if problem.experiment.assessment.racing and optimizer.survivors:
        return RacedAssessment(problem, genomes, generation, optimizer.survivors)
    kind = ResampledAssessment if optimizer.resamples else Assessment
    return kind(problem, genomes, generation)
