"""Genomes of recurrent networks whose neurons are connected to all inputs and neurons."""

from collections.abc import Sequence

import numpy as np

from zswarm.config.meta import PartSettings
from zswarm.nets.graph import Graph, of_meshed
from zswarm.nets.neurons import padded
from zswarm.nets.vector import Hidden, VectorRepresentation


class MeshedSettings(PartSettings, frozen=True):
    """Settings of every meshed network."""

    hidden: Hidden = 2


class Meshed(VectorRepresentation):
    """A meshed network: a genome has, per neuron, the weights of all sources, then other genes.

    ``neurons`` are the nodes that are not inputs, ``sources`` all nodes. The outputs are the last.

    Args:
        neuron: range and least reach of each gene of a neuron.
        others: those of genes that no neuron has.
    """

    settings: MeshedSettings

    def __init__(
        self,
        settings: MeshedSettings,
        inputs: int,
        outputs: int,
        neuron: Sequence[tuple[float, float]],
        others: Sequence[tuple[float, float]] = (),
    ) -> None:
        self.neurons = settings.hidden + outputs
        self.sources = inputs + self.neurons
        ranges, least = np.array([*neuron] * self.neurons + [*others]).T.copy()
        blocks = range(0, self.neurons * len(neuron) + 1, len(neuron))
        super().__init__(
            settings, inputs, outputs, ranges=ranges, blocks=blocks, least=least
        )
        self.state_size = 3 * padded(self.neurons)
        self.hidden_at = range(settings.hidden)

    def tables(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return (genomes, neurons, genes of a neuron) float32."""
        return self.shaped(self.vectors(genomes))

    def shaped(self, vectors: np.ndarray) -> np.ndarray:
        """Return the ``tables`` of vectors."""
        genes = vectors[:, : self.blocks[-1]]
        return genes.reshape(len(vectors), self.neurons, self.blocks[1])

    def graph(self, genome: bytes) -> Graph:
        """Return the network with the weights of its genome."""
        (table,) = self.tables([genome])
        weights = table[:, : self.sources]
        return of_meshed(self.inputs, self.outputs, weights, self._texts(table))

    def _texts(self, table: np.ndarray) -> list[str]:
        """Return a text about each neuron."""
        return [f"bias {bias:.4g}" for bias in table[:, -1].tolist()]
