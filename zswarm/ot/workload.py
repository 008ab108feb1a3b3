"""What is evaluated together: a generation's genomes on its trials, or a round of its games."""

import numpy as np


class Workload:
    """Genomes and trials to evaluate, and their outcomes as they come."""

    def __init__(self, genomes: list[bytes], participants: np.ndarray, seeds: np.ndarray, metrics: int) -> None:
        """Start with nothing counted.

        Args:
            participants: (trials, k) integers, indices into genomes.
            seeds: (trials,) uint64.
            metrics: numbers a trial reports beside fitness.
        """
        self.round, self.first = 0, 0  # of its generation: which, and the index of its first trial
        self.genomes = genomes
        self.participants = participants
        self.seeds = seeds
        self.fitness = np.full(participants.shape, np.nan)
        self.metrics = np.full((len(seeds), metrics), np.nan)
        self.counted = np.zeros(len(seeds), bool)
        self.faulted = np.zeros(len(seeds), bool)
        self.source = np.full(len(seeds), "", object)  # the server that a counted trial's outcome came from

    def retract(self, server: str) -> np.ndarray:
        """Count no more what a server was counted for; these trials."""
        trials = np.flatnonzero(self.source == server)
        self.counted[trials], self.source[trials] = False, ""
        return trials

    def batch(self, trials: np.ndarray) -> tuple[list[bytes], np.ndarray, np.ndarray]:
        """The genomes that some trials need, their participants as indices into these, and their seeds."""
        used, participants = np.unique(self.participants[trials], return_inverse=True)
        return [self.genomes[i] for i in used], participants.reshape(len(trials), -1), self.seeds[trials]


def one_nan(numbers: np.ndarray) -> np.ndarray:
    """The numbers, with one bit pattern of NaN."""
    return np.where(np.isnan(numbers), np.nan, numbers)
