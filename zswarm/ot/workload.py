"""Trials that are evaluated together: those of a generation, or of a round of its games."""

import numpy as np


class Workload:
    """Genomes, trials, and their outcomes as they come.

    Args:
        participants: (trials, k) integers, indices into genomes.
        seeds: (trials,) uint64.
        metrics: numbers of a trial besides fitness.

    Attributes:
        generation: for whose evaluation it is; that after the last one for the assessment.
        round, first: which round of its generation, and how many trials the earlier rounds had.
        numbers: (trials,) of each in its generation, ascending: what the record has.
        source: the server that a trial was counted for.
    """

    def __init__(
        self,
        genomes: list[bytes],
        participants: np.ndarray,
        seeds: np.ndarray,
        metrics: int,
    ) -> None:
        trials = len(seeds)
        self.genomes, self.participants, self.seeds = genomes, participants, seeds
        self.fitness = np.full(participants.shape, np.nan)
        self.metrics = np.full((trials, metrics), np.nan)
        self.counted = np.zeros(trials, bool)
        self.faulted = np.zeros(trials, bool)
        self.source = np.full(trials, "", object)
        self.place(0, 0, 0)

    def place(
        self, generation: int, number: int, first: int, numbers: np.ndarray | None = None
    ) -> None:
        """Set which round of which generation it is; by default trials count on from ``first``."""
        self.generation, self.round, self.first = generation, number, first
        self.numbers = first + np.arange(len(self.seeds)) if numbers is None else numbers

    def retract(self, server: str) -> np.ndarray:
        """Uncount the trials that were counted for a server; return these."""
        trials = np.flatnonzero(self.source == server)
        self.counted[trials], self.source[trials] = False, ""
        return trials

    def batch(self, trials: np.ndarray) -> tuple[list[bytes], np.ndarray, np.ndarray]:
        """Return genomes for trials, participants as indices into these, and seeds."""
        used, participants = np.unique(self.participants[trials], return_inverse=True)
        genomes = list(map(self.genomes.__getitem__, used.tolist()))
        return genomes, participants.reshape(len(trials), -1), self.seeds[trials]


def one_nan(numbers: np.ndarray) -> np.ndarray:
    """Return the numbers, with one bit pattern of NaN."""
    return np.where(np.isnan(numbers), np.nan, numbers)
