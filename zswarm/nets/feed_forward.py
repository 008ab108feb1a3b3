"""Feed-forward networks: FREVO's ``MultiLayerNetwork`` and ``ThreeLayerNetwork`` (github.com/smartgrids-aau/Frevo, version 1.5).

Each node hears the nodes of the layer before it: output = activation(bias + sum of weight times output). FREVO's have sigmoid
nodes throughout, which is the default here, and decide the same, bit for bit; a net of one hidden layer is its
``ThreeLayerNetwork``. Its ``stepNumber`` is not offered: a net without memory decides the same when it is asked twice. State:
room for two layers, of which nothing is read in the next decision.

Genome: per node, layer after layer, the weights from the nodes of the layer before, then its bias; float32, little-endian.
Operators are FREVO's, ``least`` reaches of mutation 2 included (10 for weights, too). The distance is the mean of
|difference| / range; ``MultiLayerNetwork`` divides differences of biases by the weights' range instead.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.jit import STEP_SIGNATURE, kernel
from zswarm.lanes import LANES, fill, load, store
from zswarm.nets.graph import Graph, of_layers
from zswarm.nets.neurons import ACTIVATIONS, MEANING, ONE, ZERO, Activation, activate, add, padded, put
from zswarm.nets.vector import COARSE, Range, VectorRepresentation, absolute_differences

HEADER = 3  # layers, their activation, that of the last one; then the nodes of each

Width = Annotated[int, Meta(ge=1, le=1000)]
WeightRange = Annotated[
    Range, Meta(description="new weights are uniform in plus or minus this; method 1 of mutation scales with it")
]
BiasRange = Annotated[Range, Meta(description="the same of biases")]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[representation]`` with ``kind = "feed-forward"``."""

    hidden: Annotated[
        list[Width], Meta(max_length=8, description="nodes of each hidden layer; []: the outputs hear the inputs")
    ] = msgspec.field(default_factory=lambda: [2, 2])
    activation: Annotated[Activation, Meta(description=f"of hidden nodes; {MEANING}")] = "sigmoid"
    output_activation: Annotated[Activation, Meta(description="of outputs")] = "sigmoid"
    weight_range: WeightRange = 2.0
    bias_range: BiasRange = 2.0


class ThreeLayerSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[representation]`` with ``kind = "three-layer"``."""

    hidden: Annotated[Width, Meta(description="nodes of the hidden layer")] = 2
    weight_range: WeightRange = 2.0
    bias_range: BiasRange = 2.0


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """One decision, layer after layer; the sums run over the sources in order, eight nodes side by side."""
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
                sums = sums + load(parameters, weights + source * row + first) * state[here + source]
            store(state, there + first, load(parameters, biases + first) + sums)
            activate(activation, state, there + first, there + first, min(LANES, nodes - first))
        weights, sources = biases + row, nodes
        here, there = there, here
    for index in range(output.shape[0]):
        output[index] = state[here + index]


@kernel(STEP_SIGNATURE)
def step_lanes(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """``step`` of eight agents, one in each lane; the sums of four nodes at a time, for they wait for one another."""
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
            for source in range(sources):
                sums = add(sums, parameters, weights + source * row + first, load(state, here + source * LANES))
            put(add(sums, parameters, biases + first, fill(ONE)), state, there + first)
        for first in range(0, nodes * LANES, LANES):
            activate(activation, state, there + first, there + first, LANES)
        weights, sources = biases + row, nodes
        here, there = there, here
    for index in range(0, output.shape[0], LANES):
        store(output, index, load(state, here + index))


class Layered(VectorRepresentation):
    """A network of the given layers."""

    step = staticmethod(step)
    step_lanes = staticmethod(step_lanes)
    settings: Settings | ThreeLayerSettings

    def __init__(
        self,
        settings: Settings | ThreeLayerSettings,
        inputs: int,
        outputs: int,
        hidden: Sequence[int],
        activations: tuple[Activation, Activation],
    ) -> None:
        self.widths = [*hidden, outputs]
        self.activations = activations
        ranges: list[float] = []
        blocks = [0]
        for sources, nodes in zip([inputs, *hidden], self.widths, strict=True):
            ranges += ([settings.weight_range] * sources + [settings.bias_range]) * nodes
            blocks += range(blocks[-1] + sources + 1, len(ranges) + 1, sources + 1)
        least = np.full(len(ranges), COARSE)
        super().__init__(settings, inputs, outputs, ranges=np.array(ranges), blocks=blocks, least=least)
        self.state_size = 2 * max(inputs, *map(padded, self.widths))

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Header and the nodes of each layer; then per layer and source its weights to all nodes (padded), then the biases."""
        vectors = self.vectors(genomes)
        header = [len(self.widths), *map(ACTIVATIONS.index, self.activations), *self.widths]
        parts = [np.tile(np.array(header, np.float32), (len(genomes), 1))]
        begin, sources = 0, self.inputs
        for nodes in self.widths:
            end = begin + nodes * (sources + 1)
            layer = np.zeros((len(genomes), sources + 1, padded(nodes)), np.float32)
            layer[:, :, :nodes] = vectors[:, begin:end].reshape(len(genomes), nodes, sources + 1).transpose(0, 2, 1)
            parts.append(layer.reshape(len(genomes), (sources + 1) * padded(nodes)))
            begin, sources = end, nodes
        return np.concatenate(parts, axis=1)

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Means of |difference| / range over all genes, added in gene order."""
        a, b = (self._numbers(side) / self.ranges for side in (left, right))
        return absolute_differences(a, b) / self.genes

    def graph(self, genome: bytes) -> Graph:
        """See ``Representation``."""
        vector, tables, begin, sources = self.vectors([genome])[0], [], 0, self.inputs
        for nodes in self.widths:
            end = begin + nodes * (sources + 1)
            tables.append(vector[begin:end].reshape(nodes, sources + 1))
            begin, sources = end, nodes
        return of_layers(self.inputs, self.widths, tables)


class FeedForward(Layered):
    """Feed-forward network of any number of hidden layers."""

    settings_type = Settings

    def __init__(self, settings: Settings, inputs: int, outputs: int) -> None:
        super().__init__(settings, inputs, outputs, settings.hidden, (settings.activation, settings.output_activation))


class ThreeLayer(Layered):
    """FREVO's feed-forward network of one hidden layer, with sigmoid nodes.

    ``feed-forward`` with one hidden layer decides the same.
    """

    settings_type = ThreeLayerSettings

    def __init__(self, settings: ThreeLayerSettings, inputs: int, outputs: int) -> None:
        super().__init__(settings, inputs, outputs, [settings.hidden], ("sigmoid", "sigmoid"))
