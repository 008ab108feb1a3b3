"""The Swiss system for games of two.

Source: ``SwissSystem`` of FREVO 1.5 (github.com/smartgrids-aau/Frevo). As there: rounds are the
binary logarithm of the candidates, rounded up; in the first round the first plays the last, the
second the last but one; later each, best first, plays the next one that it did not meet. What
differs: docs/co-evolution.md.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.config.meta import about, within
from zswarm.errors import ConfigError
from zswarm.ot.rankings.tournament import (
    PlayedMatch,
    Tournament,
    TournamentSettings,
    best_first,
    games_played,
)

Points = Annotated[int, Meta(ge=0, le=1_000_000)]


class SwissSettings(TournamentSettings, frozen=True):
    """Settings of ``[ranking]`` with ``kind = "swiss"``."""

    rounds: Annotated[
        int, within(0, 1_000, "rounds; 0: log2 of the candidates, rounded up")
    ] = 0
    win: Annotated[Points, about("points of a win, and of a bye")] = 2
    tie: Annotated[Points, about("points of a tie, for both")] = 1


class Swiss(Tournament):
    """In each round candidates with similar points play each other: few games.

    Games: of two. The first round pairs by index, first against last; later ones best first, each
    with the next it did not meet. Of an odd number one has a bye: the middle one, later the last of
    those with the fewest byes. n / 2 games in each of log2 n rounds.
    Score: points of wins, byes and ties.
    """

    settings_type = SwissSettings
    settings: SwissSettings

    def __init__(self, settings: SwissSettings, participants: int) -> None:
        super().__init__(settings, participants)
        if participants > 2:
            raise ConfigError(
                f"ranking: swiss pairs two, and this problem is a game of {participants}; "
                "expected multi-swiss"
            )

    def _groups(
        self, candidates: int, rounds: Sequence[PlayedMatch]
    ) -> np.ndarray | None:
        if len(rounds) >= (self.settings.rounds or (candidates - 1).bit_length()):
            return None
        if not rounds:
            half = np.arange(candidates // 2)
            return np.stack([half, candidates - 1 - half], axis=1)
        waiting = best_first(self._points(candidates, rounds)).tolist()
        if candidates % 2:
            games = games_played(candidates, rounds)
            waiting.remove([one for one in waiting if games[one] == games.max()][-1])
        met = {frozenset(pair) for matches in rounds for pair in matches.groups.tolist()}
        pairs = []
        while waiting:
            first = waiting.pop(0)
            fresh = (other for other in waiting if frozenset((first, other)) not in met)
            second = next(fresh, waiting[0])
            waiting.remove(second)
            pairs.append((first, second))
        return np.array(pairs)

    def _points(self, candidates: int, rounds: Sequence[PlayedMatch]) -> np.ndarray:
        win, tie = float(self.settings.win), float(self.settings.tie)
        scores = win * (len(rounds) - games_played(candidates, rounds))
        for matches in rounds:
            np.add.at(scores, matches.groups, win * matches.better + tie * matches.level)
        return scores
