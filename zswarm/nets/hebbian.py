"""Fully-meshed network whose weights learn while it decides: FREVO's ``HebbNet``.

Source: FREVO 1.5, github.com/smartgrids-aau/Frevo. The learning rule, the genome, and what differs
from FREVO: docs/representations.md. State: outputs, sums, learnt weights, their changes, and
whether the trial has begun; then the weights are those of the genome.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np

from zswarm.config.meta import about
from zswarm.kernels.jit import STEP_SIGNATURE, float32, kernel
from zswarm.kernels.lanes import LANES, fill, load, store
from zswarm.nets import vector
from zswarm.nets.meshed import Meshed, MeshedSettings
from zswarm.nets.neurons import (
    CLAMP,
    ONE,
    ZERO,
    activate,
    copy_outputs,
    padded,
    parameter_rows,
)

HEADER = 4  # iterations, neurons, learning rate, 0
RATE = 2
LEAST_RATE = 0.01  # least reach of mutation 2 for the learning rate


class HebbianSettings(MeshedSettings, frozen=True):
    """Settings of ``[representation]`` with ``kind = "hebbian"``."""

    iterations: Annotated[
        vector.Iterations, about("updates of all nodes in a decision; the last learns")
    ] = 2
    plasticity: Annotated[
        Literal["each", "one"],
        about("each: every weight has a gene for its plasticity; one: all are 1"),
    ] = "each"
    weight_range: vector.WeightRange = 2.0
    bias_range: vector.BiasRange = 2.0
    plasticity_range: Annotated[vector.Range, about("the same for plasticities")] = 1.0
    rate_range: Annotated[vector.Range, about("the same for the learning rate")] = 0.01


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Make one decision, and learn from it."""
    iterations = int(parameters[0])
    neurons = int(parameters[1])
    rate = np.float64(parameters[RATE])
    row = (neurons + LANES - 1) // LANES * LANES
    inputs = observation.shape[0]
    table = (inputs + neurons) * row
    fresh, weights, deltas = row, 2 * row, 2 * row + table  # behind the outputs
    inner, begun = weights + inputs * row, deltas + table
    plasticities, biases = HEADER + table, HEADER + 2 * table
    if state[begun] == ZERO:
        state[begun] = ONE
        for place in range(table):
            state[weights + place] = parameters[HEADER + place]
    for _ in range(iterations):
        for first in range(0, row, LANES):
            sums = fill(ZERO)
            for source in range(inputs):
                weight = load(state, weights + source * row + first)
                sums = sums + weight * observation[source]
            for neuron in range(neurons):
                sums = sums + load(state, inner + neuron * row + first) * state[neuron]
            store(state, fresh + first, load(parameters, biases + first) + sums)
        for first in range(0, row, LANES):
            activate(CLAMP, state, fresh + first, first, LANES)
    total = ZERO
    for neuron in range(neurons):
        change = rate * (np.float64(state[neuron]) - 0.5)
        for source in range(inputs):
            delta = float32(change * (np.float64(observation[source]) - 0.5))
            state[deltas + source * row + neuron] = delta
            total = total + delta
        for source in range(neurons):
            delta = float32(change * (np.float64(state[source]) - 0.5))
            state[deltas + (inputs + source) * row + neuron] = delta
            if source != neuron:
                total = total + delta
    mean = total / float32(neurons * (inputs + neurons - 1))
    for source in range(inputs + neurons):
        for neuron in range(neurons):
            if source - inputs != neuron:
                place = source * row + neuron
                learnt = parameters[plasticities + place] * (state[deltas + place] - mean)
                state[weights + place] = state[weights + place] + learnt
    copy_outputs(state, neurons, output)


class Hebbian(Meshed):
    """Recurrent network, FREVO's, whose weights learn while it decides."""

    settings_type = HebbianSettings
    step = staticmethod(step)
    settings: HebbianSettings

    def __init__(self, settings: HebbianSettings, inputs: int, outputs: int) -> None:
        self.plastic = settings.plasticity == "each"
        sources = inputs + settings.hidden + outputs
        neuron = [(settings.weight_range, vector.COARSE)] * sources
        neuron += [(settings.plasticity_range, vector.FINE)] * (
            sources if self.plastic else 0
        )
        neuron += [(settings.bias_range, vector.COARSE)]
        rate = [(settings.rate_range, LEAST_RATE)]
        super().__init__(settings, inputs, outputs, neuron, rate)
        self._header = np.array([settings.iterations, self.neurons, 0, 0], np.float32)
        self.state_size = 2 * (self.sources + 1) * padded(self.neurons) + 1

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return header; weights and plasticities of each source to all neurons; the biases."""
        vectors = self.vectors(genomes)
        tables = self.shaped(vectors)
        if not self.plastic:
            tables = np.insert(tables, [self.sources] * self.sources, 1.0, axis=2)
        rows = parameter_rows(self._header, tables)
        rows[:, RATE] = vectors[:, -1]
        return rows
