"""Genomes that are plain lists of numbers, and their operators: those of FREVO (github.com/smartgrids-aau/Frevo, version 1.5).

A genome is float32, little-endian, one number after the other. What the numbers mean is the network's own affair: it says how far
new ones reach, where its neurons begin, and how far mutation 2 moves each number at least.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream
from zswarm.nets.representation import Representation

BLOCK = 64_000  # differences of genes that are held at once: 256 kB stay in the processor's cache
FINE, COARSE = 0.1, 10.0  # the least reaches of mutation 2 that FREVO has

Range = Annotated[float, Meta(gt=0, le=1e6)]  # of new numbers


class VectorRepresentation(Representation):
    """A network whose genome is a plain list of numbers; a child writes ``parameters`` and the steps.

    Attributes:
        blocks: (neurons + 1,) where the genes of each neuron begin, and where the last one's end.
        least: (genes,) float64, the least reach of mutation 2.
    """

    genes: int
    genome_bytes: int
    ranges: np.ndarray

    def __init__(
        self,
        settings: msgspec.Struct,
        inputs: int,
        outputs: int,
        *,
        ranges: np.ndarray,
        blocks: Sequence[int],
        least: np.ndarray,
    ) -> None:
        super().__init__(settings, inputs, outputs)
        self.ranges = ranges
        self.blocks = blocks
        self.least = least
        self.genes = len(ranges)
        self.genome_bytes = 4 * self.genes

    def vectors(self, genomes: Sequence[bytes]) -> np.ndarray:
        """(len(genomes), genes) float32, for ``parameters``.

        Raises:
            ValueError: a genome has the wrong length, or a number in it is not finite.
        """
        for genome in genomes:
            if len(genome) != self.genome_bytes:
                raise ValueError(f"a genome has {len(genome)} bytes; this network takes {self.genome_bytes}")
        numbers = self._numbers(genomes)
        if not np.isfinite(numbers).all():
            raise ValueError("a genome holds a number that is not finite")
        return numbers

    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Each number uniform in plus or minus its range."""
        draws = stream.uniform(-1.0, 1.0, count * self.genes).reshape(count, self.genes)
        return _split(draws * self.ranges)

    def mutate(
        self, genomes: Sequence[bytes], stream: Stream, *, method: int, severity: float, probability: float
    ) -> list[bytes]:
        """FREVO's mutations of each gene, with the given probability.

        Method 1 adds U(-s, s), s = severity times the gene's range. Method 2 is relative, as FREVO's code has it:
        s = max(g / 5, its least reach), cut to an integer where that is 10; so a negative g always has the least reach.
        """
        numbers = self._numbers(genomes)
        hit = stream.uniform(0.0, 1.0, numbers.size).reshape(numbers.shape) < probability
        draws = stream.uniform(-1.0, 1.0, numbers.size).reshape(numbers.shape)
        if method == 1:
            reach = severity * self.ranges
        else:
            reach = np.maximum(numbers.astype(np.float64) / 5.0, self.least)
            reach = np.where(self.least == COARSE, np.trunc(reach), reach)
        return _split(np.where(hit, numbers + (draws * reach).astype(np.float32), numbers))

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """The mother with one block of neurons (all genes of each) of the father, cut at the last neuron."""
        neurons = len(self.blocks) - 1
        length = 1 + stream.integer(max(1, neurons - 1))
        start = stream.integer(neurons)
        begin, end = 4 * self.blocks[start], 4 * self.blocks[min(start + length, neurons)]
        return mother[:begin] + father[begin:end] + mother[end:]

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Sums of the absolute differences of all genes, added in gene order."""
        return absolute_differences(self._numbers(left), self._numbers(right))

    def _numbers(self, genomes: Sequence[bytes]) -> np.ndarray:
        return np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), self.genes)


def absolute_differences(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(len(left), len(right)) float64: sums over the columns of two tables, in their order."""
    # Along its first axis numpy adds one row after the other; numbers that are a single column it adds in pairs.
    columns = right if len(right) != 1 else np.concatenate([right, right])
    a, b = np.ascontiguousarray(left.T), np.ascontiguousarray(columns.T)
    total = np.empty((len(left), len(columns)))
    rows = max(1, BLOCK // max(1, b.size))
    for begin in range(0, len(left), rows):
        block = a[:, begin : begin + rows, None] - b[:, None, :]
        np.add.reduce(np.abs(block, out=block), axis=0, dtype=np.float64, out=total[begin : begin + rows])
    return total[:, : len(right)]


def _split(vectors: np.ndarray) -> list[bytes]:
    return [vector.tobytes() for vector in vectors.astype("<f4")]
