"""Every candidate plays every other one.

Source: ``FullTournament`` of FREVO 1.5 (github.com/smartgrids-aau/Frevo). As there: 2 points for a
win, 1 for a tie; pairs in the order of their indices; ties ranked by index. Unlike there, a game is
played from all sides, and may have more than two participants.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from zswarm.ot.rankings.tournament import PlayedMatch, Tournament


class FullTournament(Tournament):
    """Every candidate plays every other one: the most exact, and the most work.

    Games: all combinations of candidates, in one round; n (n - 1) / 2 games of two.
    Score: per game and other participant 2 points for doing better, 1 for doing as well.
    """

    def _groups(
        self, candidates: int, rounds: Sequence[PlayedMatch]
    ) -> np.ndarray | None:
        if rounds:
            return None
        games = itertools.combinations(range(candidates), self.participants)
        count = math.comb(candidates, self.participants)
        return np.fromiter(games, np.dtype((np.int64, self.participants)), count)

    def _points(self, candidates: int, rounds: Sequence[PlayedMatch]) -> np.ndarray:
        scores = np.zeros(candidates)
        for matches in rounds:
            np.add.at(scores, matches.groups, 2.0 * matches.better + matches.level)
        return scores
