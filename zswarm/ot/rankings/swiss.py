"""The Swiss system for games of two, after FREVO (github.com/smartgrids-aau/Frevo, Components/Rankings/SwissSystem).

Kept as it is there: the binary logarithm of the candidates, rounded up, as the number of rounds; in the first round the
first plays the last, the second the last but one; later each, best first, plays the next that it did not meet.
Mended:
- whoever has no opponent gets a bye, which counts as a win (there it gives no points), and after the first round it goes to
  the last of those who had none (there to the first, which is the best); nobody gets a second one before all had one;
- who has met all that are left plays one of them again (there they do not play);
- a game is played from both sides (there the one paired first always begins).
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.errors import ConfigError
from zswarm.ot.rankings.tournament import Played, Tournament, TournamentSettings, add_points, best_first

Points = Annotated[int, Meta(ge=0, le=1_000_000)]


class Settings(TournamentSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[ranking]`` with ``kind = "swiss"``."""

    rounds: Annotated[
        int, Meta(ge=0, le=1_000, description="rounds; 0: the binary logarithm of the number of candidates, rounded up")
    ] = 0
    win: Annotated[Points, Meta(description="points of a win, and of a bye")] = 2
    tie: Annotated[Points, Meta(description="points of a tie, for both")] = 1


class Swiss(Tournament):
    """In each round candidates play others with about as many points: a ranking after few games.

    Games: of two. The first round pairs by index, first against last; later ones best first, each with the next it did not
    meet. Of an odd number one has a bye: the middle one, later the last of those who had none. n / 2 games in each of
    log2 n rounds.
    Score: points of wins, byes and ties.
    """

    settings_type = Settings
    settings: Settings

    def __init__(self, settings: Settings, participants: int) -> None:
        super().__init__(settings, participants)
        if participants > 2:
            raise ConfigError(f"ranking: swiss pairs two, and this problem is a game of {participants}: its kind is multi-swiss")

    def _groups(self, candidates: int, told: Sequence[Played]) -> np.ndarray | None:
        if len(told) >= (self.settings.rounds or (candidates - 1).bit_length()):
            return None
        if not told:
            half = candidates // 2
            return np.stack([np.arange(half), np.arange(candidates - 1, candidates - 1 - half, -1)], axis=1)
        waiting = best_first(self._points(candidates, told)).tolist()
        if candidates % 2:
            byes = _byes(candidates, told)
            waiting.remove([candidate for candidate in waiting if byes[candidate] == byes.min()][-1])
        met = {(one, other) for played in told for pair in played.groups.tolist() for one, other in (pair, pair[::-1])}
        pairs = []
        while waiting:
            first = waiting.pop(0)
            second = next((other for other in waiting if (first, other) not in met), waiting[0])
            waiting.remove(second)
            pairs.append((first, second))
        return np.array(pairs)

    def _points(self, candidates: int, told: Sequence[Played]) -> np.ndarray:
        scores = float(self.settings.win) * _byes(candidates, told)
        for played in told:
            add_points(scores, played, float(self.settings.win) * played.better + float(self.settings.tie) * played.level)
        return scores


def _byes(candidates: int, told: Sequence[Played]) -> np.ndarray:
    """(candidates,) int64: rounds without a game."""
    byes = np.full(candidates, len(told))
    for played in told:
        byes[played.groups] -= 1
    return byes
