"""Fully-meshed network whose weights learn while it decides: FREVO's ``HebbNet`` (github.com/smartgrids-aau/Frevo, version 1.5).

Nodes are numbered inputs, hidden, outputs; every non-input node hears every node, itself included. One decision repeats
``iterations`` times: clamp the inputs, sum over all previous outputs with the learnt weights, cut bias + sum to 0..1. Then all
weights but those of a node to itself learn, from source j to node i:

    d_ij = rate (o_i - 1/2) (o_j - 1/2)                 in float64, rounded to float32
    w_ij = w_ij + plasticity_ij (d_ij - mean of all d)

The inputs enter as they are, so that large ones learn most. State: outputs, learnt weights, and whether a trial has begun: with
it weights begin as the genome has them.

Genome: per non-input node the weights from nodes 0..N-1, with ``plasticity = "each"`` the plasticities of these, then its bias;
at the end the learning rate; float32, little-endian.

With ``plasticity = "one"``, or where each is 1, given weights, biases and rate decide and learn as in FREVO, bit for bit. Mended:
- a plasticity has its effect (there it evolves, but is never used);
- the learning rate mutates as other genes do, by max(rate / 5, 0.01) at most with mutation 2 (there that is cut to 0);
- plasticities mutate in their own range, and are fine in mutation 2 (there as weights do, which had no effect).
New rates and plasticities are of both signs (there positive). The rate is the mother's after a crossover, as there.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.jit import STEP_SIGNATURE, float32, kernel
from zswarm.lanes import LANES, fill, load, store
from zswarm.nets.graph import Graph, of_meshed
from zswarm.nets.neurons import CLAMP, ONE, ZERO, activate, padded
from zswarm.nets.vector import COARSE, FINE, Range, VectorRepresentation

HEADER = 4  # iterations, neurons, learning rate, 0
LEAST_RATE = 0.01  # by which mutation 2 moves the learning rate at least


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[representation]`` with ``kind = "hebbian"``."""

    hidden: Annotated[int, Meta(ge=0, le=1000, description="nodes beside inputs and outputs")] = 2
    iterations: Annotated[int, Meta(ge=1, le=100, description="updates of all nodes in one decision; the last one learns")] = 2
    plasticity: Annotated[
        Literal["each", "one"],
        Meta(description="each: every weight has a gene for how fast it learns; one: all are 1, as FREVO computes"),
    ] = "each"
    weight_range: Annotated[
        Range, Meta(description="new weights are uniform in plus or minus this; method 1 of mutation scales with it")
    ] = 2.0
    bias_range: Annotated[Range, Meta(description="the same of biases")] = 2.0
    plasticity_range: Annotated[Range, Meta(description="the same of plasticities")] = 1.0
    rate_range: Annotated[Range, Meta(description="the same of the learning rate")] = 0.01


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """One decision, and what is learnt from it."""
    iterations, neurons, rate = int(parameters[0]), int(parameters[1]), np.float64(parameters[2])
    row = (neurons + LANES - 1) // LANES * LANES
    inputs = observation.shape[0]
    table = (inputs + neurons) * row
    fresh, weights, deltas = row, 2 * row, 2 * row + table  # behind the outputs
    begun = deltas + table
    plasticities, biases = HEADER + table, HEADER + 2 * table
    if state[begun] == ZERO:
        state[begun] = ONE
        for place in range(table):
            state[weights + place] = parameters[HEADER + place]
    for _ in range(iterations):
        for first in range(0, row, LANES):
            sums = fill(ZERO)
            for source in range(inputs):
                sums = sums + load(state, weights + source * row + first) * observation[source]
            for source in range(neurons):
                sums = sums + load(state, weights + (inputs + source) * row + first) * state[source]
            store(state, fresh + first, load(parameters, biases + first) + sums)
        for first in range(0, row, LANES):
            activate(CLAMP, state, fresh + first, first, LANES)
    total, count = ZERO, 0
    for neuron in range(neurons):
        change = rate * (np.float64(state[neuron]) - 0.5)
        for source in range(inputs + neurons):
            value = observation[source] if source < inputs else state[source - inputs]
            delta = float32(change * (np.float64(value) - 0.5))
            state[deltas + source * row + neuron] = delta
            if source - inputs != neuron:
                total = total + delta
                count += 1
    mean = total / float32(count)
    for source in range(inputs + neurons):
        for neuron in range(neurons):
            if source - inputs != neuron:
                place = source * row + neuron
                learnt = parameters[plasticities + place] * (state[deltas + place] - mean)
                state[weights + place] = state[weights + place] + learnt
    for index in range(output.shape[0]):
        output[index] = state[neurons - output.shape[0] + index]


class Hebbian(VectorRepresentation):
    """Recurrent network, FREVO's, whose weights learn while it decides.

    ``neurons`` are the non-input nodes.
    """

    settings_type = Settings
    step = staticmethod(step)
    settings: Settings

    def __init__(self, settings: Settings, inputs: int, outputs: int) -> None:
        self.neurons = settings.hidden + outputs
        self.sources = inputs + self.neurons
        self.plastic = settings.plasticity == "each"
        neuron = [(settings.weight_range, COARSE)] * self.sources
        neuron += [(settings.plasticity_range, FINE)] * (self.sources if self.plastic else 0)
        neuron += [(settings.bias_range, COARSE)]
        genes = np.array([*(neuron * self.neurons), (settings.rate_range, LEAST_RATE)])
        blocks = range(0, len(genes), len(neuron))
        super().__init__(settings, inputs, outputs, ranges=genes[:, 0].copy(), blocks=blocks, least=genes[:, 1].copy())
        self._padded = padded(self.neurons)
        self.state_size = 2 * (self.sources + 1) * self._padded + 1
        self.hidden_at = range(settings.hidden)

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Header; per source its weights to all neurons (padded with zeros); likewise the plasticities; the biases."""
        vectors = self.vectors(genomes)
        tables = vectors[:, :-1].reshape(len(genomes), self.neurons, -1).transpose(0, 2, 1)
        rows = np.zeros((len(genomes), HEADER + (2 * self.sources + 1) * self._padded), np.float32)
        rows[:, :2] = self.settings.iterations, self.neurons
        rows[:, 2] = vectors[:, -1]
        body = rows[:, HEADER:].reshape(len(genomes), 2 * self.sources + 1, self._padded)
        body[:, : self.sources, : self.neurons] = tables[:, : self.sources]
        body[:, self.sources : -1, : self.neurons] = tables[:, self.sources : -1] if self.plastic else 1.0
        body[:, -1, : self.neurons] = tables[:, -1]
        return rows

    def graph(self, genome: bytes) -> Graph:
        """See ``Representation``; the weights are those that it begins with."""
        table = self.vectors([genome])[0, :-1].reshape(self.neurons, -1)
        return of_meshed(
            self.inputs, self.outputs, table[:, : self.sources], [f"bias {bias:.4g}" for bias in table[:, -1].tolist()]
        )
