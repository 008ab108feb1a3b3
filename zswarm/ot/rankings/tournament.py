"""What tournaments have in common: sides, points, who met whom."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, ClassVar, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.errors import ConfigError
from zswarm.ot.rankings.ranking import Ranking, Round

AllSides = Annotated[
    bool,
    Meta(
        description="each game is played from all sides, once in every turn of its participants, and the results are added; "
        "false: once, as paired, which takes less time where sides do not matter"
    ),
]


class Played(NamedTuple):
    """Games as they were paired, all sides of each together."""

    groups: np.ndarray  # (groups, participants) int64, candidates
    results: np.ndarray  # (groups, participants) float64, summed over the sides; NaN: it failed
    better: np.ndarray  # (groups, participants) int64, participants of the game that did worse; 0 for one that failed
    level: np.ndarray  # (groups, participants) int64, others that did as well; 0 for one that failed


class TournamentSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What every tournament may be told."""

    all_sides: AllSides = True


class Tournament(Ranking):
    """Candidates play each other; a child pairs them and counts their points.

    A game of k participants is played k times, from every side once (``all_sides``): as paired, and with all moved on by one
    place, and so on. What counts is each one's fitness, summed over these.
    """

    relative: ClassVar[bool] = True
    settings: TournamentSettings

    def __init__(self, settings: TournamentSettings, participants: int) -> None:
        super().__init__(settings, participants)
        if participants < 2:
            raise ConfigError(
                "ranking: a tournament has candidates play each other, and this problem is played by one; "
                "its kind of ranking is absolute"
            )

    @property
    def sides(self) -> int:
        """Times that a game is played."""
        return self.participants if self.settings.all_sides else 1

    def next_games(self, candidates: int, played: Sequence[Round]) -> np.ndarray | None:
        """See ``Ranking.next_games``; the sides of a game follow each other."""
        if candidates < self.participants:
            raise ConfigError(f"ranking: a game of {self.participants} needs as many candidates; there are {candidates}")
        groups = self._groups(candidates, self._told(played))
        if groups is None:
            return None
        turns = [np.roll(groups, -side, axis=1) for side in range(self.sides)]
        return np.stack(turns, axis=1).reshape(-1, self.participants)

    def scores(self, candidates: int, played: Sequence[Round]) -> np.ndarray:
        """See ``Ranking.scores``."""
        told = self._told(played)
        scores = self._points(candidates, told)
        seen, finished = np.zeros(candidates, bool), np.zeros(candidates, bool)
        for round_ in told:
            seen[round_.groups] = True
            finished[round_.groups[~np.isnan(round_.results)]] = True
        scores[seen & ~finished] = np.nan
        return scores

    @abstractmethod
    def _groups(self, candidates: int, told: Sequence[Played]) -> np.ndarray | None:
        """(groups, participants) int64: who plays whom in the next round; None where there is none."""

    @abstractmethod
    def _points(self, candidates: int, told: Sequence[Played]) -> np.ndarray:
        """(candidates,) float64."""

    def _told(self, played: Sequence[Round]) -> list[Played]:
        return [self._summed(round_) for round_ in played]

    def _summed(self, played: Round) -> Played:
        groups = played.games[:: self.sides]
        results = np.zeros(groups.shape)
        for side in range(self.sides):  # in this order
            results = results + np.roll(played.results[side :: self.sides], side, axis=1)
        results = np.where(np.isfinite(results), results, np.nan)
        one, other = results[:, :, None], results[:, None, :]
        better = ((one > other) | (np.isnan(other) & ~np.isnan(one))).sum(axis=2)
        level = (one == other).sum(axis=2) - ~np.isnan(results)  # not with itself
        return Played(groups, results, better, level)


def add_points(scores: np.ndarray, played: Played, points: np.ndarray) -> None:
    """Add what each participant of each game gained, (groups, participants), to the candidates' scores."""
    np.add.at(scores, played.groups, points)


def best_first(scores: np.ndarray) -> np.ndarray:
    """Candidates by score; equal ones by their index."""
    return np.argsort(-scores, kind="stable")
