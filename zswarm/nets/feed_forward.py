"""Feed-forward networks: FREVO's ``MultiLayerNetwork`` and ``ThreeLayerNetwork``.

Source: FREVO 1.5, github.com/smartgrids-aau/Frevo. With sigmoid nodes, the default, a decision has
the same bits as FREVO's. State: room for two layers; a decision reads nothing of the previous one.
Genome, operators, and what differs from FREVO: docs/representations.md.
"""

import itertools
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta, field

from zswarm.config.meta import PartSettings, about, above
from zswarm.kernels.jit import STEP_SIGNATURE, kernel
from zswarm.kernels.lanes import LANES, fill, load, store
from zswarm.nets import neurons, vector
from zswarm.nets.graph import Graph, of_layers
from zswarm.nets.neurons import (
    ONE,
    ZERO,
    activate,
    add,
    copy_lanes,
    copy_outputs,
    put,
    weigh_lanes,
)

HEADER = 3  # layers, their activation, that of the last one; then the nodes of each

Width = Annotated[int, Meta(ge=1, le=1000)]


class FeedForwardSettings(PartSettings, frozen=True):
    """Settings of ``[representation]`` with ``kind = "feed-forward"``."""

    hidden: Annotated[
        list[Width],
        Meta(max_length=8, description="nodes of each hidden layer; may be empty"),
    ] = field(default_factory=lambda: [2, 2])
    activation: Annotated[
        neurons.Activation, about(f"activation of hidden nodes; {neurons.MEANING}")
    ] = "sigmoid"
    output_activation: Annotated[neurons.Activation, about("activation of outputs")] = (
        "sigmoid"
    )
    weight_range: vector.WeightRange = 2.0
    bias_range: vector.BiasRange = 2.0
    steepness: Annotated[
        float, above(0, 1e3, "a node's sum is multiplied by this before its activation")
    ] = 1.0
    limited: Annotated[
        bool, about("mutation method 1 cuts numbers to plus or minus their range")
    ] = False


class ThreeLayerSettings(PartSettings, frozen=True):
    """Settings of ``[representation]`` with ``kind = "three-layer"``."""

    hidden: Annotated[Width, about("nodes of the hidden layer")] = 2
    weight_range: vector.WeightRange = 2.0
    bias_range: vector.BiasRange = 2.0


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Make one decision: sums over the sources in order, of eight nodes at once."""
    layers, sources = int(parameters[0]), observation.shape[0]
    here, there = 0, state.shape[0] // 2
    weights = HEADER + layers
    for source in range(sources):
        state[source] = observation[source]
    for layer in range(layers):
        nodes = int(parameters[HEADER + layer])
        row = (nodes + LANES - 1) // LANES * LANES
        activation = int(parameters[2 if layer == layers - 1 else 1])
        biases = weights + sources * row
        for first in range(0, row, LANES):
            sums = fill(ZERO)
            for source in range(sources):
                kept = load(parameters, weights + source * row + first)
                sums = sums + kept * state[here + source]
            store(state, there + first, load(parameters, biases + first) + sums)
            activate(
                activation, state, there + first, there + first, min(LANES, nodes - first)
            )
        weights, sources = biases + row, nodes
        here, there = there, here
    copy_outputs(state, here + sources, output)


@kernel(STEP_SIGNATURE)
def step_lanes(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Make one decision of eight agents, with four independent sums at a time."""
    layers, sources = int(parameters[0]), observation.shape[0] // LANES
    here, there = 0, state.shape[0] // 2
    weights = (HEADER + layers) * LANES
    for source in range(sources):
        store(state, source * LANES, load(observation, source * LANES))
    for layer in range(layers):
        nodes = int(parameters[(HEADER + layer) * LANES])
        row = (nodes + LANES - 1) // LANES * LANES * LANES  # the numbers of all nodes
        activation = int(parameters[(2 if layer == layers - 1 else 1) * LANES])
        biases = weights + sources * row
        for first in range(0, nodes * LANES, 4 * LANES):
            sums = fill(ZERO), fill(ZERO), fill(ZERO), fill(ZERO)
            sums = weigh_lanes(
                sums, parameters, weights + first, row, state, here, sources
            )
            put(add(sums, parameters, biases + first, fill(ONE)), state, there + first)
        for first in range(0, nodes * LANES, LANES):
            activate(activation, state, there + first, there + first, LANES)
        weights, sources = biases + row, nodes
        here, there = there, here
    copy_lanes(state, here + sources * LANES, output)


class Layered(vector.VectorRepresentation):
    """A network of given layers.

    Args:
        hidden: nodes of the hidden layers.
        activations: of hidden nodes and of outputs.
    """

    step = staticmethod(step)
    step_lanes = staticmethod(step_lanes)

    def __init__(
        self,
        settings: FeedForwardSettings | ThreeLayerSettings,
        inputs: int,
        outputs: int,
        hidden: Sequence[int],
        *activations: neurons.Activation,
    ) -> None:
        self.widths = [*hidden, outputs]
        self.activations = activations
        ranges: list[float] = []
        blocks = [0]
        for sources, nodes in itertools.pairwise([inputs, *self.widths]):
            ranges += ([settings.weight_range] * sources + [settings.bias_range]) * nodes
            blocks += range(blocks[-1] + sources + 1, len(ranges) + 1, sources + 1)
        least = np.full(len(ranges), vector.COARSE)
        super().__init__(
            settings, inputs, outputs, ranges=np.array(ranges), blocks=blocks, least=least
        )
        header = (
            len(self.widths),
            *map(neurons.ACTIVATIONS.index, activations),
            *self.widths,
        )
        self._header = np.array(header, np.float32)
        self.state_size = 2 * max(inputs, *map(neurons.padded, self.widths))

    def tables(self, genomes: Sequence[bytes]) -> list[np.ndarray]:
        """Return per layer (genomes, nodes, nodes of the previous layer + 1) float32."""
        vectors, begin, found = self.vectors(genomes), 0, []
        for sources, nodes in itertools.pairwise([self.inputs, *self.widths]):
            end = begin + nodes * (sources + 1)
            layer = vectors[:, begin:end].reshape(len(genomes), nodes, sources + 1)
            found.append(layer)
            begin = end
        return found

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return header and widths; per layer and source the weights, padded, then the biases."""
        return neurons.parameter_rows(self._header, *self.tables(genomes))

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Return means of |difference| / range over all genes, added in gene order."""
        return self._differences(left, right, self.ranges) / self.genes

    def distances_between(
        self, genomes: Sequence[bytes], left: np.ndarray, right: np.ndarray
    ) -> np.ndarray:
        """See ``Representation``."""
        found = self._differences_between(genomes, left, right, self.ranges)
        return found / self.genes

    def graph(self, genome: bytes) -> Graph:
        """Return the network with the weights of its genome."""
        return of_layers(self.inputs, [table for (table,) in self.tables([genome])])


class FeedForward(Layered):
    """Feed-forward network of any number of hidden layers."""

    settings_type = FeedForwardSettings
    settings: FeedForwardSettings

    def __init__(self, settings: FeedForwardSettings, inputs: int, outputs: int) -> None:
        activations = settings.activation, settings.output_activation
        super().__init__(settings, inputs, outputs, settings.hidden, *activations)

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return rows as ``Layered.parameters``, of weights and biases times the steepness."""
        steepness = np.float32(self.settings.steepness)
        tables = [table * steepness for table in self.tables(genomes)]
        return neurons.parameter_rows(self._header, *tables)

    def _moved(
        self, numbers: np.ndarray, draws: np.ndarray, method: int, severity: float
    ) -> np.ndarray:
        moved = super()._moved(numbers, draws, method, severity)
        if self.settings.limited and method == 1:
            reach = self.ranges.astype(np.float32)
            moved = np.clip(moved, -reach, reach)
        return moved


class ThreeLayer(Layered):
    """FREVO's feed-forward network of one hidden layer, with sigmoid nodes.

    ``feed-forward`` with one hidden layer decides the same.
    """

    settings_type = ThreeLayerSettings

    def __init__(self, settings: ThreeLayerSettings, inputs: int, outputs: int) -> None:
        super().__init__(
            settings, inputs, outputs, [settings.hidden], "sigmoid", "sigmoid"
        )
