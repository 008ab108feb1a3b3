"""The Swiss system for games of two and more, after FREVO (github.com/smartgrids-aau/Frevo, Components/Rankings/MultiSwiss).

Kept as it is there: the logarithm of the candidates to the base of the participants, rounded up, as the number of rounds; the
first round by index, later ones by score, neighbours playing each other; points by place, the last of a game has one; the
score is their average, and (participants + 1) / 2 for whoever did not play.
Mended:
- the last group of a round plays (there a full group is left out when it is the last);
- those left over, fewer than a game takes, are the last of those who sat out least (there always the last ones);
- equals share the points of their places (there the order of the list decides);
- a game is played from all sides (there only as listed).
"""

from collections.abc import Sequence

import numpy as np

from zswarm.ot.rankings.tournament import Played, Tournament, TournamentSettings, add_points, best_first


class Settings(TournamentSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[ranking]`` with ``kind = "multi-swiss"``."""


class MultiSwiss(Tournament):
    """In each round candidates with about the same score play each other, as many as a game takes.

    Games: the first round groups by index, later ones by score, best first; those left over sit out. n / k games of k in each
    of log(n) / log(k) rounds.
    Score: the average over its games of k points for the best, 1 for the last; equals share.
    """

    settings_type = Settings
    settings: Settings

    def _groups(self, candidates: int, told: Sequence[Played]) -> np.ndarray | None:
        rounds = 0
        while self.participants**rounds < candidates:
            rounds += 1
        if len(told) >= max(1, rounds):
            return None
        order = best_first(self._points(candidates, told)).tolist()
        games = _games(candidates, told)
        order.reverse()
        sitting_out = sorted(order, key=lambda candidate: -games[candidate])[: candidates % self.participants]
        order = [candidate for candidate in reversed(order) if candidate not in sitting_out]
        return np.array(order).reshape(-1, self.participants)

    def _points(self, candidates: int, told: Sequence[Played]) -> np.ndarray:
        total, games = np.zeros(candidates), _games(candidates, told)
        for played in told:
            add_points(total, played, np.where(np.isnan(played.results), 0.0, 1.0 + played.better + played.level / 2.0))
        return np.where(games > 0, total / np.maximum(games, 1), (self.participants + 1) / 2.0)


def _games(candidates: int, told: Sequence[Played]) -> np.ndarray:
    """(candidates,) int64: rounds in which each played."""
    games = np.zeros(candidates, np.int64)
    for played in told:
        games[played.groups] += 1
    return games
