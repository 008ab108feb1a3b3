"""Continuous-time recurrent network: R. D. Beer, "On the dynamics of small continuous-time recurrent neural networks", 1995.

Neurons are hidden ones, then outputs; each hears all inputs x and all neurons, itself included:

    tau_i dy_i/dt = -y_i + sum over j of w_ij s(y_j + b_j) + I_i,    I_i = sum over k of v_ik x_k        (1)
    output_i = s(y_i + b_i),    s(x) = 1 / (1 + e^-x)

Time is counted in decisions. One decision is ``iterations`` steps of Euler's method, dt = 1 / ``iterations``, all neurons at
once: y_i + dt / tau_i ((I_i + sum) - y_i), the sum over inputs, then neurons, in their order. s is (1 + tanh(x / 2)) / 2 with
``portable.tanh``, within 1.9e-5. State: y, all zero at the start of a trial.

Genome: per neuron the weights from the inputs, those from the neurons, its bias, and a number g for its time constant, new ones
in -1..1: tau = tau_min + (tau_max - tau_min) (g + 1) / 2, with g cut to -1..1; float32, little-endian.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.jit import STEP_SIGNATURE, inline, kernel
from zswarm.lanes import LANES, fill, load, store
from zswarm.nets.graph import Graph, of_meshed
from zswarm.nets.neurons import ZERO, add, padded, put, take
from zswarm.nets.vector import FINE, Range, VectorRepresentation
from zswarm.portable import tanh

HEADER = 2  # iterations, neurons
HALF = np.float32(0.5)

Tau = Annotated[float, Meta(gt=0, le=1e6)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[representation]`` with ``kind = "ctrnn"``."""

    hidden: Annotated[int, Meta(ge=0, le=1000, description="neurons beside the outputs")] = 2
    iterations: Annotated[int, Meta(ge=1, le=100, description="steps of Euler's method in one decision")] = 2
    tau_min: Annotated[
        Tau, Meta(description="the shortest time constant, in decisions; at least 1 / `iterations`, or steps would overshoot")
    ] = 1.0
    tau_max: Annotated[Tau, Meta(description="the longest")] = 10.0
    weight_range: Annotated[
        Range, Meta(description="new weights are uniform in plus or minus this; method 1 of mutation scales with it")
    ] = 4.0
    bias_range: Annotated[Range, Meta(description="the same of biases")] = 4.0

    def __post_init__(self) -> None:
        if self.tau_min * self.iterations < 1:
            raise ValueError(f"tau_min: expected at least 1 / iterations = {1 / self.iterations:.6g}, not {self.tau_min}")
        if self.tau_max < self.tau_min:
            raise ValueError(f"tau_max: expected at least tau_min = {self.tau_min}, not {self.tau_max}")


@inline
def fire(state, at, parameters, biases, to):  # type: ignore[no-untyped-def]  # compiled
    """s(y + b) of eight y."""
    store(state, to, HALF + HALF * tanh(HALF * (load(state, at) + load(parameters, biases))))


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """One decision; the sums run over the sources in order, eight neurons side by side."""
    iterations, neurons = int(parameters[0]), int(parameters[1])
    row = state.shape[0] // 3
    from_inputs, firing = row, 2 * row  # behind y
    inner = HEADER + observation.shape[0] * row
    biases = inner + neurons * row
    speeds = biases + row
    for first in range(0, row, LANES):
        sums = fill(ZERO)
        for source in range(observation.shape[0]):
            sums = sums + load(parameters, HEADER + source * row + first) * observation[source]
        store(state, from_inputs + first, sums)
        fire(state, first, parameters, biases + first, firing + first)
    for _ in range(iterations):
        for first in range(0, row, LANES):  # equation 1
            sums = load(state, from_inputs + first)
            for neuron in range(neurons):
                sums = sums + load(parameters, inner + neuron * row + first) * state[firing + neuron]
            y = load(state, first)
            store(state, first, y + load(parameters, speeds + first) * (sums - y))
        for first in range(0, row, LANES):
            fire(state, first, parameters, biases + first, firing + first)
    for index in range(output.shape[0]):
        output[index] = state[firing + neurons - output.shape[0] + index]


@kernel(STEP_SIGNATURE)
def step_lanes(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """``step`` of eight agents, one in each lane; the sums of four neurons at a time, for they wait for one another."""
    iterations, neurons = int(parameters[0]), int(parameters[LANES])
    row = state.shape[0] // 3  # the numbers of all neurons
    from_inputs, firing = row, 2 * row
    inputs, outputs = observation.shape[0] // LANES, output.shape[0] // LANES
    inner = HEADER * LANES + inputs * row
    biases = inner + neurons * row
    speeds = biases + row
    for first in range(0, neurons * LANES, 4 * LANES):
        sums = fill(ZERO), fill(ZERO), fill(ZERO), fill(ZERO)
        for source in range(inputs):
            sums = add(sums, parameters, HEADER * LANES + source * row + first, load(observation, source * LANES))
        put(sums, state, from_inputs + first)
    for first in range(0, neurons * LANES, LANES):
        fire(state, first, parameters, biases + first, firing + first)
    for _ in range(iterations):
        for first in range(0, neurons * LANES, 4 * LANES):
            sums = take(state, from_inputs + first)
            for neuron in range(neurons):
                sums = add(sums, parameters, inner + neuron * row + first, load(state, firing + neuron * LANES))
            for neuron in range(4):
                at = first + neuron * LANES
                y = load(state, at)
                store(state, at, y + load(parameters, speeds + at) * (sums[neuron] - y))
        for first in range(0, neurons * LANES, LANES):
            fire(state, first, parameters, biases + first, firing + first)
    for index in range(outputs):
        store(output, index * LANES, load(state, firing + (neurons - outputs + index) * LANES))


class CTRNN(VectorRepresentation):
    """Continuous-time recurrent network: its neurons have time constants."""

    settings_type = Settings
    step = staticmethod(step)
    step_lanes = staticmethod(step_lanes)
    settings: Settings

    def __init__(self, settings: Settings, inputs: int, outputs: int) -> None:
        self.neurons = settings.hidden + outputs
        self.sources = inputs + self.neurons
        neuron = [settings.weight_range] * self.sources + [settings.bias_range, 1.0]
        ranges = np.array(neuron * self.neurons)
        blocks = range(0, len(ranges) + 1, len(neuron))
        super().__init__(settings, inputs, outputs, ranges=ranges, blocks=blocks, least=np.full(len(ranges), FINE))
        self._padded = padded(self.neurons)
        self.state_size = 3 * self._padded
        self.hidden_at = range(2 * self._padded, 2 * self._padded + settings.hidden)

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Header; per source its weights to all neurons (padded with zeros); the biases; dt / tau."""
        settings = self.settings
        tables = self.vectors(genomes).reshape(len(genomes), self.neurons, self.sources + 2).transpose(0, 2, 1)
        rows = np.zeros((len(genomes), HEADER + (self.sources + 2) * self._padded), np.float32)
        rows[:, :HEADER] = settings.iterations, self.neurons
        body = rows[:, HEADER:].reshape(len(genomes), self.sources + 2, self._padded)
        body[:, :-1, : self.neurons] = tables[:, :-1]
        body[:, -1, : self.neurons] = 1.0 / (settings.iterations * self._taus(tables[:, -1]))
        return rows

    def graph(self, genome: bytes) -> Graph:
        """See ``Representation``."""
        table = self.vectors([genome]).reshape(self.neurons, self.sources + 2)
        taus = self._taus(table[:, -1]).tolist()
        texts = [f"bias {bias:.4g}, tau {tau:.4g}" for bias, tau in zip(table[:, -2].tolist(), taus, strict=True)]
        return of_meshed(self.inputs, self.outputs, table[:, : self.sources], texts)

    def _taus(self, genes: np.ndarray) -> np.ndarray:
        """Time constants in decisions, float64."""
        settings = self.settings
        share = (np.clip(genes.astype(np.float64), -1.0, 1.0) + 1.0) / 2.0
        return np.asarray(settings.tau_min + (settings.tau_max - settings.tau_min) * share)
