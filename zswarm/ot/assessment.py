"""A generation as it is judged: rounds of games, a workload each, until the ranking has what it needs."""

from collections.abc import Sequence

import numpy as np

from zswarm.ot.problem import Problem
from zswarm.ot.rankings.ranking import Round
from zswarm.ot.workload import Workload


class Assessment:
    """Genomes of one generation, judged round by round.

    Attributes:
        genomes, generation: as given.
        workload: the games of the round that is played, on the generation's trials.
    """

    def __init__(self, problem: Problem, genomes: list[bytes], generation: int) -> None:
        """Begin the first round.

        Raises:
            ConfigError: there are too few candidates for a game.
        """
        self.genomes, self.generation = genomes, generation
        self._problem = problem
        self._workloads: list[Workload] = []
        self._rounds: list[Round] = []
        self._begin(problem.ranking.next_games(len(genomes), ()))

    def advance(self) -> bool:
        """Begin the next round once all of this one is counted; False where it was the last."""
        self._rounds.append(self._problem.played(self.workload))
        games = self._problem.ranking.next_games(len(self.genomes), self._rounds)
        if games is None:
            return False
        self._begin(games)
        return True

    def fitness(self) -> np.ndarray:
        """(candidates,) float64, as the ranking has it; after the last round."""
        return self._problem.ranking.scores(len(self.genomes), self._rounds)

    def measures(self, names: Sequence[str]) -> np.ndarray:
        """(candidates, names) float64: of each metric the mean over a candidate's trials, added in trial order."""
        columns = [self._problem.simulator.metrics.index(name) for name in names]
        total, trials = np.zeros((len(self.genomes), len(columns))), np.zeros((len(self.genomes), 1))
        if not columns:
            return total
        with np.errstate(over="ignore", invalid="ignore"):  # told below
            for workload in self._workloads:
                who = workload.participants.ravel()
                np.add.at(total, who, np.repeat(workload.metrics[:, columns], workload.participants.shape[1], axis=0))
                np.add.at(trials, who, 1)
            mean = total / trials
        return np.where(np.isfinite(mean), mean, np.nan)

    def _begin(self, games: np.ndarray | None) -> None:
        self.workload = self._problem.workload(self.genomes, self.generation, games=games)
        self.workload.round, self.workload.first = len(self._workloads), sum(len(round_.seeds) for round_ in self._workloads)
        self._workloads.append(self.workload)
