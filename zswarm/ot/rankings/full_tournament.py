"""Everybody plays everybody, after FREVO (github.com/smartgrids-aau/Frevo, Components/Rankings/FullTournament).

Kept as it is there: a point for a tie, two for a win, all pairs in the order of their indices, ties ranked by index.
Mended: a game is played from all sides (there the one with the lower index always begins); games of more than two.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from zswarm.ot.rankings.tournament import Played, Tournament, TournamentSettings, add_points


class Settings(TournamentSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[ranking]`` with ``kind = "full-tournament"``."""


class FullTournament(Tournament):
    """Every candidate plays every other one: the most exact, and with many candidates the most work.

    Games: all combinations of candidates, in one round; n (n - 1) / 2 games of two.
    Score: for each game and each other participant 2 points where it did better, 1 where as well.
    """

    settings_type = Settings
    settings: Settings

    def _groups(self, candidates: int, told: Sequence[Played]) -> np.ndarray | None:
        if told:
            return None
        games = itertools.combinations(range(candidates), self.participants)
        return np.fromiter(games, np.dtype((np.int64, self.participants)), math.comb(candidates, self.participants))

    def _points(self, candidates: int, told: Sequence[Played]) -> np.ndarray:
        scores = np.zeros(candidates)
        for played in told:
            add_points(scores, played, 2.0 * played.better + played.level)
        return scores
