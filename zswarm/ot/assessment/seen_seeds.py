"""Fresh seeds: the fitness of a genome is its mean over all generations that evaluated it."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from zswarm.ot.record.history_hash import digest
from zswarm.ot.record.resuming import Recorded


class GenomeMeans(NamedTuple):
    """What is known of a genome: means over generations, each with as many trials."""

    generations: int
    fitness: float
    measures: np.ndarray


class SeenSeeds:
    """Means of the genomes of the last generation, over it and those right before it."""

    def __init__(self) -> None:
        self._seen: dict[bytes, GenomeMeans] = {}

    @classmethod
    def of_record(cls, record: Recorded) -> Self:
        """Return what a record knows of its last generation."""
        found, last = cls(), record.resumed().generation - 1
        if last < 0:
            return found
        counts = dict.fromkeys(record.digests(last), 1)
        going, generation = set(counts), last - 1
        while generation >= 0 and going:
            going &= set(record.digests(generation))
            for one in going:
                counts[one] += 1
            generation -= 1
        for one, fitness, measures in record.last_told():
            found._seen[one] = GenomeMeans(counts[one], fitness, measures)
        return found

    def merge(
        self, genomes: Sequence[bytes], fitness: np.ndarray, measures: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return fitness and measures of a generation as means over all seeds that were seen.

        A genome that was evaluated in the last generation, too, has been on more seeds than this
        generation's; one that failed once, has failed.
        """
        seen: dict[bytes, GenomeMeans] = {}
        means, of_measures = fitness.copy(), measures.copy()
        for row, genome in enumerate(genomes):
            key = digest(genome)
            count = 0
            if (before := self._seen.get(key)) is not None:
                count = before.generations
                means[row] = (before.fitness * count + fitness[row]) / (count + 1)
                of_measures[row] = (before.measures * count + measures[row]) / (count + 1)
            means[row] += 0.0  # SQLite drops the sign of -0.0
            seen[key] = GenomeMeans(count + 1, float(means[row]), of_measures[row])
        self._seen = seen
        return means, of_measures
