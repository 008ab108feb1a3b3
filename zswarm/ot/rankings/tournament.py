"""The base of tournaments: sides, points, and who met whom."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from zswarm.config.meta import PartSettings, about
from zswarm.errors import ConfigError
from zswarm.ot.rankings.ranking import Ranking, Round


class PlayedMatch(NamedTuple):
    """The matches of a round as they were paired, all sides of each together.

    Arrays are (matches, participants).
    """

    groups: np.ndarray  # int64, candidates
    results: np.ndarray  # float64, summed over the sides; NaN: failed
    better: np.ndarray  # int64, participants that did worse; 0 for one that failed
    level: np.ndarray  # int64, others that did as well; 0 for one that failed


class TournamentSettings(PartSettings, frozen=True):
    """Settings of ``[ranking]`` with the kind of a tournament."""

    all_sides: Annotated[
        bool,
        about(
            "play each game from all sides and add the results; false: once, as "
            "paired, which is faster if sides do not matter"
        ),
    ] = True


class Tournament(Ranking):
    """Candidates play each other; a child pairs them and counts their points.

    With ``all_sides`` a game of k participants is played k times: as paired, then with all of them
    moved by one place, and so on. The summed fitness of each counts.
    """

    settings_type = TournamentSettings
    relative = True
    settings: TournamentSettings

    def __init__(self, settings: TournamentSettings, participants: int) -> None:
        super().__init__(settings, participants)
        if participants < 2:
            raise ConfigError(
                "ranking: a tournament needs a problem of several participants; "
                "for this one, expected absolute"
            )
        self.sides = participants if settings.all_sides else 1

    def next_games(self, candidates: int, played: Sequence[Round]) -> np.ndarray | None:
        """See ``Ranking``; the sides of a game follow each other."""
        if candidates < self.participants:
            raise ConfigError(
                f"ranking: a game of {self.participants} needs as many candidates; "
                f"there are {candidates}"
            )
        groups = self._groups(candidates, [self._summed(round_) for round_ in played])
        if groups is None:
            return None
        turns = [np.roll(groups, -side, axis=1) for side in range(self.sides)]
        return np.stack(turns, axis=1).reshape(-1, self.participants)

    def scores(self, candidates: int, played: Sequence[Round]) -> np.ndarray:
        """See ``Ranking``."""
        rounds = [self._summed(round_) for round_ in played]
        scores = self._points(candidates, rounds)
        seen, finished = np.zeros((2, candidates), bool)
        for matches in rounds:
            seen[matches.groups] = True
            finished[matches.groups[~np.isnan(matches.results)]] = True
        scores[seen & ~finished] = np.nan
        return scores

    @abstractmethod
    def _groups(
        self, candidates: int, rounds: Sequence[PlayedMatch]
    ) -> np.ndarray | None:
        """Return the pairing of the next round, (groups, participants) int64, or None."""

    @abstractmethod
    def _points(self, candidates: int, rounds: Sequence[PlayedMatch]) -> np.ndarray:
        """Return (candidates,) float64."""

    def _summed(self, played: Round) -> PlayedMatch:
        groups = played.games[:: self.sides]
        results = np.zeros(groups.shape)
        for side in range(self.sides):  # in this order
            results = results + np.roll(played.results[side :: self.sides], side, axis=1)
        results = np.where(np.isfinite(results), results, np.nan)
        one, other = results[:, :, None], results[:, None, :]
        wins = (one > other) | (np.isnan(other) & ~np.isnan(one))
        better = np.count_nonzero(wins, axis=2)
        # not with itself
        level = np.count_nonzero(one == other, axis=2) - ~np.isnan(results)
        return PlayedMatch(groups, results, better, level)


def games_played(candidates: int, rounds: Sequence[PlayedMatch]) -> np.ndarray:
    """Return (candidates,) int64: rounds in which each candidate played."""
    games = np.zeros(candidates, np.int64)
    for matches in rounds:
        games[matches.groups] += 1
    return games


def best_first(scores: np.ndarray) -> np.ndarray:
    """Return candidates by score; equal ones by index."""
    return np.argsort(-scores, kind="stable")
