"""The contract of a ranking: which candidates play each other, and the scores that result."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import msgspec
import numpy as np


class Round(NamedTuple):
    """Games that were played in parallel."""

    games: np.ndarray  # (games, participants) int64, candidates
    # (games, participants) float64, fitness summed over trials; NaN: failed.
    results: np.ndarray


class Ranking(ABC):
    """Derives the next games from those played, and nothing else: same games, same answer.

    Attributes:
        settings_type: the struct of its settings in an experiment file.
        relative: whether scores compare within a generation only.

    Args:
        participants: candidates of a game.

    Raises:
        ConfigError: it supports no such games.
    """

    settings_type: ClassVar[type[msgspec.Struct]]
    relative: ClassVar[bool]

    def __init__(self, settings: msgspec.Struct, participants: int) -> None:
        self.settings = settings
        self.participants = participants

    @abstractmethod
    def next_games(self, candidates: int, played: Sequence[Round]) -> np.ndarray | None:
        """Return the games of the next round, or None after the last one.

        Args:
            candidates: how many there are.
            played: the rounds of the generation so far.

        Returns:
            (games, participants) int64: candidates, each at most once in a game.

        Raises:
            ConfigError: there are too few candidates for a game.
        """

    @abstractmethod
    def scores(self, candidates: int, played: Sequence[Round]) -> np.ndarray:
        """Return (candidates,) float64 after the last round, higher is better.

        A candidate that failed in all its games has NaN.
        """
