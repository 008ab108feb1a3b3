"""The contract of a representation: a kind of network, from the genome's bytes to a decision.

A genome is bytes in a layout that the representation documents. ``parameters`` turns genomes into
rows of float32 for the compiled ``step``, which has the same signature everywhere. The operators
(random, mutate, crossover, distances) run in numpy on the optimizer's side.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import msgspec
import numpy as np

from zswarm.kernels.jit import Step
from zswarm.kernels.random import Stream
from zswarm.nets.graph import Graph, numbered


class Representation(ABC):
    """A kind of network with its settings, for given numbers of inputs and outputs.

    Attributes:
        settings_type: the struct of its settings in an experiment file.
        step: one decision, compiled with ``jit.STEP_SIGNATURE``. It reads parameters and
            observation, changes the state, fills the output, and allocates nothing.
        step_lanes: the decision of eight agents at once (``lanes.py``), or None. Number k of lane l
            stands at 8 k + l of each array; each agent has its own parameters and state. The bits
            are those of ``step``.
        state_size: float32 numbers of state per agent; all zero at the start of a trial.
        genome_bytes: length of every genome, or None if it varies.
        genes: numbers in a genome that is a plain list of any finite float32; otherwise None.
        hidden_at: indices of the hidden neurons' values in the state, for pictures; may be empty.
        ranges: (genes,) float64, new genomes are uniform in plus or minus these; None if ``genes``
            is.
        crossover_draws: random words that a crossover draws, if most draw equally many: then many
            are prepared at once.
    """

    settings_type: ClassVar[type[msgspec.Struct]]
    step: Step
    step_lanes: Step | None = None
    state_size: int
    genome_bytes: int | None
    genes: int | None = None
    hidden_at: range = range(0)
    ranges: np.ndarray | None = None
    crossover_draws: int | None = None

    def __init__(self, settings: msgspec.Struct, inputs: int, outputs: int) -> None:
        self.settings = settings
        self.inputs = inputs
        self.outputs = outputs

    @abstractmethod
    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return (len(genomes), P) float32, one row for ``step`` per genome.

        Raises:
            ValueError: a genome has the wrong length, or a number in it is not finite.
        """

    @abstractmethod
    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Return new random genomes."""

    @abstractmethod
    def mutate(
        self,
        genomes: Sequence[bytes],
        stream: Stream,
        *,
        method: int,
        severity: float,
        probability: float,
    ) -> list[bytes]:
        """Return a changed copy of each genome."""

    @abstractmethod
    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """Return a child of two genomes."""

    @abstractmethod
    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Return (len(left), len(right)) float64, the same bits on every machine."""

    def distances_between(
        self, genomes: Sequence[bytes], left: np.ndarray, right: np.ndarray
    ) -> np.ndarray:
        """Return (n, k) float64: distances of a genome to k others, n times; bits as ``distances``.

        Args:
            left: (n,) indices of genomes.
            right: (n, k) indices of genomes.
        """
        return np.stack(
            [
                self.distances([genomes[one]], [genomes[other] for other in others])[0]
                for one, others in zip(left.tolist(), right.tolist(), strict=True)
            ]
        )

    def graph(self, genome: bytes) -> Graph:  # noqa: ARG002  the default shows no inside
        """Return a genome's network for drawing; by default only its inputs and outputs.

        Raises:
            ValueError: as ``parameters``.
        """
        return Graph(numbered(self.inputs, [], [""] * self.outputs), [])


def stacked(rows: Sequence[np.ndarray], least: int) -> np.ndarray:
    """Return rows of different lengths as one table, padded with zeros.

    Args:
        rows: float32 each.
        least: columns of the table without any row.
    """
    table = np.zeros((len(rows), max(map(len, rows), default=least)), np.float32)
    for target, row in zip(table, rows, strict=True):
        target[: len(row)] = row
    return table
