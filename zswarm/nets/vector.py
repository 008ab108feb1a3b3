"""Genomes that are plain lists of numbers, with FREVO's operators.

Source: FREVO 1.5, github.com/smartgrids-aau/Frevo. A genome is float32, little-endian. The network
defines what the numbers mean.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.config.meta import about, within
from zswarm.kernels.random import Stream
from zswarm.nets.representation import Representation

BLOCK = 64_000  # differences computed at once: 256 kB stay in the processor's cache
PART = (
    4_000_000  # numbers of genomes computed at once: large populations take much memory
)
FINE, COARSE = 0.1, 10.0  # FREVO's least reaches of mutation 2

Range = Annotated[float, Meta(gt=0, le=1e6)]
WeightRange = Annotated[
    Range, about("new weights are uniform in ± this; mutation method 1 scales with it")
]
BiasRange = Annotated[Range, about("the same for biases")]
Iterations = Annotated[int, Meta(ge=1, le=100)]
Hidden = Annotated[int, within(0, 1000, "hidden neurons")]


class VectorRepresentation(Representation):
    """A network whose genome is a plain list of numbers; a child writes ``parameters`` and steps.

    Args:
        ranges: (genes,) float64, new numbers are uniform in plus or minus these.
        blocks: (neurons + 1,) where the genes of each neuron begin, and where the last ones end.
        least: (genes,) float64, the least reach of mutation 2.
    """

    genes: int
    genome_bytes: int
    ranges: np.ndarray
    crossover_draws = 2

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
        """Return (len(genomes), genes) float32, for ``parameters``.

        Raises:
            ValueError: a genome has the wrong length, or a number in it is not finite.
        """
        check_lengths(genomes, self.genome_bytes)
        numbers = self._numbers(genomes)
        if not np.isfinite(numbers).all():
            raise ValueError("a genome holds a number that is not finite")
        return numbers

    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Draw each number uniformly in plus or minus its range."""
        genomes: list[bytes] = []
        for rows in self._parts(count):
            size = (rows.stop - rows.start) * self.genes
            draws = stream.uniform(-1.0, 1.0, size)
            genomes += _split(draws.reshape(-1, self.genes) * self.ranges)
        return genomes

    def mutate(
        self,
        genomes: Sequence[bytes],
        stream: Stream,
        *,
        method: int,
        severity: float,
        probability: float,
    ) -> list[bytes]:
        """Move genes by FREVO's mutations, each with the given probability.

        Method 1 adds U(-s, s) with s = severity times the gene's range. Method 2 has, as FREVO's
        code, s = max(g / 5, least reach), truncated where that reach is 10. So a negative g always
        has the least reach.
        """
        size = len(genomes) * self.genes
        hits = Stream(stream.seed, stream.position)
        moves = Stream(stream.seed, stream.position + size)
        stream.position += 2 * size
        made: list[bytes] = []
        for part in self._parts(len(genomes)):
            numbers = self._numbers(genomes[part])
            hit = hits.uniform(0.0, 1.0, numbers.size) < probability
            draws = moves.uniform(-1.0, 1.0, numbers.size).reshape(numbers.shape)
            moved = self._moved(numbers, draws, method, severity)
            made += _split(np.where(hit.reshape(numbers.shape), moved, numbers))
        return made

    def _moved(
        self, numbers: np.ndarray, draws: np.ndarray, method: int, severity: float
    ) -> np.ndarray:
        """Return (genomes, genes) float32: every gene moved by its draw."""
        if method == 1:
            reach = severity * self.ranges
        else:
            reach = np.maximum(numbers.astype(np.float64) / 5.0, self.least)
            reach = np.where(self.least == COARSE, np.trunc(reach), reach)
        moved: np.ndarray = numbers + (draws * reach).astype(np.float32)
        return moved

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """Return the mother with all genes of a block of the father's neurons."""
        neurons = len(self.blocks) - 1
        length = 1 + stream.integer(max(1, neurons - 1))
        start = stream.integer(neurons)
        begin, end = 4 * self.blocks[start], 4 * self.blocks[min(start + length, neurons)]
        return mother[:begin] + father[begin:end] + mother[end:]

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Return sums of the absolute differences of all genes, added in gene order."""
        return self._differences(left, right)

    def distances_between(
        self, genomes: Sequence[bytes], left: np.ndarray, right: np.ndarray
    ) -> np.ndarray:
        """See ``Representation``."""
        return self._differences_between(genomes, left, right)

    def _differences_between(
        self,
        genomes: Sequence[bytes],
        left: np.ndarray,
        right: np.ndarray,
        scale: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return sums as ``distances_between``, of genes divided by a scale if there is one."""
        found = np.empty(right.shape)
        at_once = max(1, PART // (self.genes * (1 + right.shape[1])))
        for begin in range(0, len(left), at_once):
            rows = slice(begin, begin + at_once)
            pairs = np.column_stack([left[rows], right[rows]])
            used, places = np.unique(pairs, return_inverse=True)
            table = self._numbers([genomes[index] for index in used.tolist()])
            places = places.reshape(pairs.shape)
            scaled = table if scale is None else table / scale
            found[rows] = differences_between(scaled, places[:, 0], places[:, 1:])
        return found

    def _differences(
        self,
        left: Sequence[bytes],
        right: Sequence[bytes],
        scale: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return sums of absolute differences, of genes divided by a scale if there is one."""

        def numbers(genomes: Sequence[bytes]) -> np.ndarray:
            found = self._numbers(genomes)
            return found if scale is None else found / scale

        found = np.empty((len(left), len(right)))
        for rows in self._parts(len(left)):
            some = numbers(left[rows])
            for columns in self._parts(len(right)):
                others = numbers(right[columns])
                found[rows, columns] = absolute_differences(some, others)
        return found

    def _parts(self, count: int) -> list[slice]:
        """Return parts of so many genomes that are computed at once."""
        at_once = max(1, PART // self.genes)
        return [
            slice(begin, min(begin + at_once, count))
            for begin in range(0, count, at_once)
        ]

    def _numbers(self, genomes: Sequence[bytes]) -> np.ndarray:
        return np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), self.genes)


def check_lengths(genomes: Sequence[bytes], size: int) -> None:
    """Raise ``ValueError`` if a genome has another length."""
    for genome in genomes:
        if len(genome) != size:
            raise ValueError(
                f"a genome has {len(genome)} bytes; this network takes {size}"
            )


def absolute_differences(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return (len(left), len(right)) float64: sums over the columns of two tables, in order."""
    # Along its first axis numpy adds row after row, but the numbers of a single column in pairs.
    columns = right if len(right) != 1 else np.concatenate([right, right])
    a, b = np.ascontiguousarray(left.T), np.ascontiguousarray(columns.T)
    total = np.empty((len(left), len(columns)))
    rows = max(1, BLOCK // max(1, b.size))
    for begin in range(0, len(left), rows):
        part = slice(begin, begin + rows)
        block = a[:, part, None] - b[:, None, :]
        np.add.reduce(np.abs(block, out=block), axis=0, dtype=np.float64, out=total[part])
    return total[:, : len(right)]


def differences_between(
    table: np.ndarray, left: np.ndarray, right: np.ndarray
) -> np.ndarray:
    """Return (n, k) float64: as ``absolute_differences``, of a row to k others, n times.

    Args:
        left: (n,) indices of rows.
        right: (n, k) indices of rows.
    """
    if right.shape[1] == 1:  # numpy adds the numbers of a single column in pairs
        return differences_between(table, left, np.repeat(right, 2, axis=1))[:, :1]
    columns, total = np.ascontiguousarray(table.T), np.empty(right.shape)
    rows = max(1, BLOCK // max(1, len(columns) * right.shape[1]))
    for begin in range(0, len(left), rows):
        part = slice(begin, begin + rows)
        block = np.take(columns, right[part], axis=1)
        block -= np.take(columns, left[part], axis=1)[:, :, None]
        np.add.reduce(np.abs(block, out=block), axis=0, dtype=np.float64, out=total[part])
    return total


def _split(vectors: np.ndarray) -> list[bytes]:
    return [vector.tobytes() for vector in vectors.astype("<f4")]
