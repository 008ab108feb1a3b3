"""The Swiss system for games of two and more.

Source: ``MultiSwiss`` of FREVO 1.5 (github.com/smartgrids-aau/Frevo). As there: rounds are the
logarithm of the candidates to the base of the participants, rounded up; the first round goes by
index, later ones by score; points by place, 1 for the last of a game; the score is their mean, or
(participants + 1) / 2 without a game. What differs: docs/co-evolution.md.
"""

from collections.abc import Sequence

import numpy as np

from zswarm.ot.rankings.tournament import (
    PlayedMatch,
    Tournament,
    best_first,
    games_played,
)


class MultiSwiss(Tournament):
    """In each round candidates with similar scores play each other, as many as a game takes.

    Games: the first round groups by index, later ones by score, best first; the rest sits out.
    n / k games of k in each of log(n) / log(k) rounds.
    Score: the mean over its games of k points for the best, 1 for the last; equals share.
    """

    def _groups(
        self, candidates: int, rounds: Sequence[PlayedMatch]
    ) -> np.ndarray | None:
        limit = 0
        while self.participants**limit < candidates:
            limit += 1
        if len(rounds) >= max(1, limit):
            return None
        order = best_first(self._points(candidates, rounds))
        # The last ones of those with the most games sit out.
        games, last_first = games_played(candidates, rounds), order[::-1]
        by_games = last_first[np.argsort(-games[last_first], kind="stable")]
        sitting_out = by_games[: candidates % self.participants]
        return order[~np.isin(order, sitting_out)].reshape(-1, self.participants)

    def _points(self, candidates: int, rounds: Sequence[PlayedMatch]) -> np.ndarray:
        total, games = np.zeros(candidates), games_played(candidates, rounds)
        for matches in rounds:
            points = 1.0 + matches.better + matches.level / 2.0
            np.add.at(
                total, matches.groups, np.where(np.isnan(matches.results), 0.0, points)
            )
        return np.where(
            games > 0, total / np.maximum(games, 1), (self.participants + 1) / 2.0
        )
