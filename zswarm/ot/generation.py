"""A generation under evaluation: rounds of games, until the ranking has what it needs."""

from collections.abc import Sequence

import numpy as np

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
        workload = self._problem.workload(self.genomes, self.generation, games=games)
        workload.generation = self.generation
        workload.round = len(self._workloads)
        workload.first = self.trials
        self._workloads.append(workload)
        self.workload = workload
