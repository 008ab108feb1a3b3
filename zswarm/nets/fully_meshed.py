"""Fully-meshed recurrent network, exactly FREVO's ``FullyMeshedNet``.

Source: FREVO 1.5, github.com/smartgrids-aau/Frevo. Nodes are inputs, hidden, outputs; each node but
the inputs receives the outputs of all nodes. A decision repeats ``iterations`` times: compute all
activations from the previous outputs, then set all outputs. Outputs last from one decision to the
next. Genome and what differs from FREVO: docs/representations.md.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from zswarm.config.meta import about
from zswarm.kernels.jit import STEP_SIGNATURE, kernel
from zswarm.kernels.lanes import LANES, fill, load, store
from zswarm.nets import neurons, vector
from zswarm.nets.meshed import Meshed, MeshedSettings
from zswarm.nets.neurons import (
    ONE,
    activate,
    add,
    copy_lanes,
    copy_outputs,
    put,
    take,
    weigh,
    weigh_inputs_lanes,
    weigh_lanes,
)

HEADER = 4  # iterations, activation, neurons, 0


class FullyMeshedSettings(MeshedSettings, frozen=True):
    """Settings of ``[representation]`` with ``kind = "fully-meshed"``."""

    iterations: Annotated[
        vector.Iterations, about("updates of all nodes in a decision")
    ] = 2
    activation: Annotated[neurons.Activation, about(neurons.MEANING)] = "clamp"
    weight_range: vector.WeightRange = 2.0
    bias_range: vector.BiasRange = 2.0


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Make one decision: sums over the sources in order, of eight neurons at once.

    The inputs do not change between iterations, so their sums are computed once. The additions and
    their order are those of FREVO.
    """
    iterations = int(parameters[0])
    activation = int(parameters[1])
    neurons = int(parameters[2])
    inputs, row = observation.shape[0], state.shape[0] // 3
    from_inputs, fresh = row, 2 * row  # behind the outputs
    inner = HEADER + inputs * row
    biases = inner + neurons * row
    weigh(parameters, HEADER, row, observation, state, from_inputs)
    for _ in range(iterations):
        for first in range(0, row, LANES):
            sums = load(state, from_inputs + first)
            for neuron in range(neurons):
                sums = (
                    sums + load(parameters, inner + neuron * row + first) * state[neuron]
                )
            store(state, fresh + first, load(parameters, biases + first) + sums)
        for first in range(0, row, LANES):
            activate(activation, state, fresh + first, first, min(LANES, neurons - first))
    copy_outputs(state, neurons, output)


@kernel(STEP_SIGNATURE)
def step_lanes(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Make one decision of eight agents, with four independent sums at a time."""
    iterations, activation = int(parameters[0]), int(parameters[LANES])
    neurons = int(parameters[2 * LANES])
    row = state.shape[0] // 3  # the numbers of all neurons
    from_inputs, fresh = row, 2 * row
    inner = HEADER * LANES + observation.shape[0] // LANES * row
    biases, end = inner + neurons * row, neurons * LANES
    weigh_inputs_lanes(
        parameters, HEADER * LANES, row, observation, state, from_inputs, end
    )
    for _ in range(iterations):
        for first in range(0, end, 4 * LANES):
            sums = take(state, from_inputs + first)
            sums = weigh_lanes(sums, parameters, inner + first, row, state, 0, neurons)
            put(add(sums, parameters, biases + first, fill(ONE)), state, fresh + first)
        for first in range(0, end, LANES):
            activate(activation, state, fresh + first, first, LANES)
    copy_lanes(state, end, output)


class FullyMeshed(Meshed):
    """Recurrent network, FREVO's, in which every node is connected to every node."""

    settings_type = FullyMeshedSettings
    step = staticmethod(step)
    step_lanes = staticmethod(step_lanes)
    settings: FullyMeshedSettings

    def __init__(self, settings: FullyMeshedSettings, inputs: int, outputs: int) -> None:
        sources = inputs + settings.hidden + outputs
        neuron = [(settings.weight_range, vector.FINE)] * sources
        neuron.append((settings.bias_range, vector.COARSE))
        super().__init__(settings, inputs, outputs, neuron)
        activation = neurons.ACTIVATIONS.index(settings.activation)
        header = settings.iterations, activation, self.neurons, 0
        self._header = np.array(header, np.float32)

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return header; per source its weights to all neurons, padded; the biases."""
        return neurons.parameter_rows(self._header, self.tables(genomes))
