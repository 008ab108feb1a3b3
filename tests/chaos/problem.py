"""Define a problem whose outcomes depend only on genome and seed, and its expected history."""

import functools
import hashlib

import numpy as np

from zswarm.ot.record.history_hash import History
from zswarm.ot.workload import Workload

Trial = tuple[bytes, int]  # genome and seed


@functools.cache
def outcome(trial: Trial) -> float:
    """Return fitness and metric of a trial; sometimes NaN."""
    number = hashlib.blake2b(
        trial[0] + trial[1].to_bytes(8, "little"), digest_size=4
    ).digest()
    return float("nan") if number[0] == 0 else int.from_bytes(number, "little") / 2**16


def poisonous(trial: Trial) -> bool:
    """Return whether a trial ends every process that plays it."""
    return outcome(trial) % 1.0 < 0.02


class Experiment:
    """Yield the generations of a run, each from the fitness of the previous one."""

    def __init__(
        self, name: str, seed: int, *, generations: int, population: int, trials: int
    ) -> None:
        self.name, self.generations = name, generations
        self._seed, self._population, self._trials = seed, population, trials

    def workload(self, before: np.ndarray | None) -> Workload:
        """Return the generation after the one with this fitness."""
        root = (b"" if before is None else before.tobytes()) + self._seed.to_bytes(
            8, "little"
        )
        genomes = [
            hashlib.blake2b(root + bytes([index]), digest_size=8).digest()
            for index in range(self._population)
        ]
        seeds = np.arange(self._trials, dtype=np.uint64) + np.uint64(self._seed)
        participants = np.repeat(np.arange(self._population), self._trials).reshape(-1, 1)
        return Workload(
            genomes, participants, np.tile(seeds, self._population), metrics=1
        )

    def expected(self, workload: Workload) -> tuple[np.ndarray, np.ndarray]:
        """Return the fitness of each trial, NaN if it is poisonous, and which trials are."""
        trials = [
            (workload.genomes[i], int(seed))
            for (i,), seed in zip(workload.participants, workload.seeds, strict=True)
        ]
        poison = np.array([poisonous(trial) for trial in trials])
        return np.where(poison, np.nan, [outcome(trial) for trial in trials]), poison

    def fitness(self, trials: np.ndarray) -> np.ndarray:
        """Return (population,) from (trials,), added in trial order."""
        return np.cumsum(trials.reshape(-1, self._trials), axis=1)[:, -1]

    def undisturbed(self) -> str:
        """Return the history hash of a run without faults."""
        history, fitness = History(), None
        for _ in range(self.generations):
            workload = self.workload(fitness)
            fitness = self.fitness(self.expected(workload)[0])
            history.add(workload.genomes, fitness)
        return history.hex()
