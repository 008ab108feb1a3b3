"""The contract of a representation: a kind of network, from the genome's bytes to a decision.

A genome is bytes in a layout that the representation documents. ``parameters`` turns genomes into rows of float32 for
the compiled ``step``, which every simulator calls with the same signature: (parameters, state, observation, output).
The operators (random, mutate, crossover, distances) are numpy on the optimizer's side and draw from the stream they get.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import msgspec
import numpy as np

from zswarm.draws import Stream
from zswarm.jit import Step
from zswarm.nets.graph import Graph, Node


class Representation(ABC):
    """A kind of network with its settings, for so many inputs and outputs.

    Attributes:
        settings_type: the struct of its settings in an experiment file.
        step: one decision, compiled with ``jit.STEP_SIGNATURE``; reads parameters and observation, changes
            state, fills output; makes no arrays.
        step_lanes: the same decision of eight agents side by side (``lanes.py``), or None. In each of the four arrays number k of
            the agent in a lane stands at 8 k + lane; each agent has parameters and state of its own. Same bits as ``step``.
        state_size: float32 numbers of state per agent; all zero at the start of a trial.
        genome_bytes: length of every genome, or None where it varies.
        genes: float32 numbers that a genome is a plain list of, any finite ones; None where it is something else.
        hidden_at: where in a state the hidden neurons' values stand after a decision, for pictures; empty where they do not.
        ranges: (genes,) float64, new genomes are uniform in plus or minus these; None where ``genes`` is.
    """

    settings_type: ClassVar[type[msgspec.Struct]]
    step: Step
    step_lanes: Step | None = None
    state_size: int
    genome_bytes: int | None
    genes: int | None = None
    hidden_at: range = range(0)
    ranges: np.ndarray | None = None

    def __init__(self, settings: msgspec.Struct, inputs: int, outputs: int) -> None:
        self.settings = settings
        self.inputs = inputs
        self.outputs = outputs

    @abstractmethod
    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """(len(genomes), P) float32, one row for ``step`` per genome.

        Raises:
            ValueError: a genome has the wrong length, or a number in it is not finite.
        """

    @abstractmethod
    def random(self, count: int, stream: Stream) -> list[bytes]:
        """New random genomes."""

    @abstractmethod
    def mutate(
        self, genomes: Sequence[bytes], stream: Stream, *, method: int, severity: float, probability: float
    ) -> list[bytes]:
        """A changed copy of each genome."""

    @abstractmethod
    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """A child of two genomes."""

    @abstractmethod
    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """(len(left), len(right)) float64: how different each is from each; the same bits on every machine."""

    def graph(self, genome: bytes) -> Graph:  # noqa: ARG002  this one knows its inputs and outputs only
        """A genome's network, to draw it; here its inputs and outputs alone.

        Raises:
            ValueError: as ``parameters``.
        """
        inputs = [Node("input", number) for number in range(self.inputs)]
        return Graph([*inputs, *(Node("output", number) for number in range(self.outputs))], [])
