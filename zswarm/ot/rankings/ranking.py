"""The contract of a ranking: which candidates of a generation play which games, and what the games make of each."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import msgspec
import numpy as np


class Round(NamedTuple):
    """Games that were played side by side."""

    games: np.ndarray  # (games, participants) int64, candidates
    results: np.ndarray  # (games, participants) float64, the fitness of each, summed over the game's trials; NaN: it failed


class Ranking(ABC):
    """Says the next games from those that were played, and nothing else: the same games always give the same.

    Attributes:
        settings_type: the struct of its settings in an experiment file.
        relative: whether scores compare within a generation only.
    """

    settings_type: ClassVar[type[msgspec.Struct]]
    relative: ClassVar[bool]

    def __init__(self, settings: msgspec.Struct, participants: int) -> None:
        """For games of so many participants.

        Raises:
            ConfigError: it knows no such games.
        """
        self.settings = settings
        self.participants = participants

    @abstractmethod
    def next_games(self, candidates: int, played: Sequence[Round]) -> np.ndarray | None:
        """The games of the next round, (games, participants) int64: candidates, each once at most in a game.

        Args:
            played: the rounds of the generation so far.

        Returns:
            None: the last round was played.

        Raises:
            ConfigError: there are too few candidates for a game.
        """

    @abstractmethod
    def scores(self, candidates: int, played: Sequence[Round]) -> np.ndarray:
        """(candidates,) float64, higher is better, once all rounds were played; NaN for one that failed in all its games."""
