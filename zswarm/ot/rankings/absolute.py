"""Each candidate is judged by itself."""

from collections.abc import Sequence

import numpy as np

from zswarm.config.meta import PartSettings
from zswarm.errors import ConfigError
from zswarm.ot.rankings.ranking import Ranking, Round


class AbsoluteSettings(PartSettings, frozen=True):
    """Settings of ``[ranking]`` with ``kind = "absolute"``: none."""


class Absolute(Ranking):
    """Each candidate plays alone, and its fitness is the sum over its trials.

    Games: one for each candidate, in one round. For problems of one participant.
    Score: the fitness itself; it compares from generation to generation.
    """

    settings_type = AbsoluteSettings
    relative = False

    def __init__(self, settings: AbsoluteSettings, participants: int) -> None:
        super().__init__(settings, participants)
        if participants != 1:
            raise ConfigError(
                "ranking: absolute judges each candidate by itself, and this problem is a game of "
                f"{participants}; expected full-tournament, swiss or multi-swiss"
            )

    def next_games(self, candidates: int, played: Sequence[Round]) -> np.ndarray | None:
        """See ``Ranking``."""
        return None if played else np.arange(candidates).reshape(-1, 1)

    def scores(self, candidates: int, played: Sequence[Round]) -> np.ndarray:  # noqa: ARG002  one result each
        """See ``Ranking``."""
        return played[0].results[:, 0]
