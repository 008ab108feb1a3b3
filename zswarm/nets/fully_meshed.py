"""Fully-meshed recurrent network, exactly FREVO's ``FullyMeshedNet`` (github.com/smartgrids-aau/Frevo, version 1.5).

Nodes are numbered inputs, hidden, outputs; every non-input node hears every node, itself included. One decision repeats
``iterations`` times: clamp the inputs, compute all activations from the previous outputs, then set all outputs. Outputs
last from one decision to the next. FREVO's random source (noise on the biases) is not offered: it is off by default there.
``tanh`` is an activation that FREVO does not have.

Genome: per non-input node (hidden, then outputs) the weights from nodes 0..N-1, then its bias; float32, little-endian.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.jit import STEP_SIGNATURE, kernel
from zswarm.lanes import LANES, fill, load, store
from zswarm.nets.graph import Graph, of_meshed
from zswarm.nets.neurons import ACTIVATIONS, MEANING, ONE, ZERO, Activation, activate, add, padded, put, take
from zswarm.nets.vector import COARSE, FINE, Range, VectorRepresentation

HEADER = 4  # iterations, activation, neurons, 0


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[representation]`` with ``kind = "fully-meshed"``."""

    hidden: Annotated[int, Meta(ge=0, le=1000, description="nodes beside inputs and outputs")] = 2
    iterations: Annotated[int, Meta(ge=1, le=100, description="updates of all nodes in one decision")] = 2
    activation: Annotated[Activation, Meta(description=MEANING)] = "clamp"
    weight_range: Annotated[
        Range, Meta(description="new weights are uniform in plus or minus this; method 1 of mutation scales with it")
    ] = 2.0
    bias_range: Annotated[Range, Meta(description="the same of biases")] = 2.0


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """One decision; the sums run over the sources in order, eight neurons side by side.

    The inputs do not change between iterations, so what they add is summed once and each iteration goes on from there:
    the same additions in the same order as FREVO's.
    """
    iterations, activation, neurons = int(parameters[0]), int(parameters[1]), int(parameters[2])
    row = state.shape[0] // 3
    from_inputs, fresh = row, 2 * row  # behind the outputs
    inner = HEADER + observation.shape[0] * row
    biases = inner + neurons * row
    for first in range(0, row, LANES):
        sums = fill(ZERO)
        for source in range(observation.shape[0]):
            sums = sums + load(parameters, HEADER + source * row + first) * observation[source]
        store(state, from_inputs + first, sums)
    for _ in range(iterations):
        for first in range(0, row, LANES):
            sums = load(state, from_inputs + first)
            for neuron in range(neurons):
                sums = sums + load(parameters, inner + neuron * row + first) * state[neuron]
            store(state, fresh + first, load(parameters, biases + first) + sums)
        for first in range(0, row, LANES):
            activate(activation, state, fresh + first, first, min(LANES, neurons - first))
    for index in range(output.shape[0]):
        output[index] = state[neurons - output.shape[0] + index]


@kernel(STEP_SIGNATURE)
def step_lanes(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """``step`` of eight agents, one in each lane; the sums of four neurons at a time, for they wait for one another."""
    iterations, activation, neurons = int(parameters[0]), int(parameters[LANES]), int(parameters[2 * LANES])
    row = state.shape[0] // 3  # the numbers of all neurons
    from_inputs, fresh = row, 2 * row
    inputs, outputs = observation.shape[0] // LANES, output.shape[0] // LANES
    inner = HEADER * LANES + inputs * row
    biases = inner + neurons * row
    for first in range(0, neurons * LANES, 4 * LANES):
        sums = fill(ZERO), fill(ZERO), fill(ZERO), fill(ZERO)
        for source in range(inputs):
            sums = add(sums, parameters, HEADER * LANES + source * row + first, load(observation, source * LANES))
        put(sums, state, from_inputs + first)
    for _ in range(iterations):
        for first in range(0, neurons * LANES, 4 * LANES):
            sums = take(state, from_inputs + first)
            for neuron in range(neurons):
                sums = add(sums, parameters, inner + neuron * row + first, load(state, neuron * LANES))
            put(add(sums, parameters, biases + first, fill(ONE)), state, fresh + first)
        for first in range(0, neurons * LANES, LANES):
            activate(activation, state, fresh + first, first, LANES)
    for index in range(outputs):
        store(output, index * LANES, load(state, (neurons - outputs + index) * LANES))


class FullyMeshed(VectorRepresentation):
    """Recurrent network, FREVO's, in which every node hears every node.

    ``neurons`` are the non-input nodes.
    """

    settings_type = Settings
    step = staticmethod(step)
    step_lanes = staticmethod(step_lanes)
    settings: Settings

    def __init__(self, settings: Settings, inputs: int, outputs: int) -> None:
        self.neurons = settings.hidden + outputs
        self.sources = inputs + self.neurons
        self.shape = (self.neurons, self.sources + 1)  # a genome as a table: weights, then the bias, per neuron
        ranges, least = np.full(self.shape, settings.weight_range), np.full(self.shape, FINE)
        ranges[:, -1], least[:, -1] = settings.bias_range, COARSE
        blocks = range(0, ranges.size + 1, self.sources + 1)
        super().__init__(settings, inputs, outputs, ranges=ranges.ravel(), blocks=blocks, least=least.ravel())
        self._padded = padded(self.neurons)
        self.state_size = 3 * self._padded
        self.hidden_at = range(settings.hidden)

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Header, then per source its weights to all neurons (padded with zeros), then the biases."""
        tables = self.vectors(genomes).reshape(len(genomes), *self.shape)
        rows = np.zeros((len(genomes), HEADER + (self.sources + 1) * self._padded), np.float32)
        rows[:, :3] = self.settings.iterations, ACTIVATIONS.index(self.settings.activation), self.neurons
        body = rows[:, HEADER:].reshape(len(genomes), self.sources + 1, self._padded)
        body[:, :, : self.neurons] = tables.transpose(0, 2, 1)
        return rows

    def graph(self, genome: bytes) -> Graph:
        """See ``Representation``."""
        table = self.vectors([genome]).reshape(self.shape)
        return of_meshed(self.inputs, self.outputs, table[:, :-1], [f"bias {bias:.4g}" for bias in table[:, -1].tolist()])
