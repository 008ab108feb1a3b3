"""Continuous-time recurrent network (CTRNN).

Source: R. D. Beer, "On the dynamics of small continuous-time recurrent neural networks", 1995.
Equations and genome: docs/representations.md. State: y, inputs' sums, s(y + b).
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.config.meta import about
from zswarm.kernels.jit import STEP_SIGNATURE, inline, kernel
from zswarm.kernels.lanes import LANES, load, store
from zswarm.kernels.portable import tanh
from zswarm.nets import vector
from zswarm.nets.meshed import Meshed, MeshedSettings
from zswarm.nets.neurons import (
    copy_lanes,
    copy_outputs,
    padded,
    parameter_rows,
    take,
    weigh,
    weigh_inputs_lanes,
    weigh_lanes,
)

HEADER = 2  # iterations, neurons
HALF = np.float32(0.5)

Tau = Annotated[float, Meta(gt=0, le=1e6)]


class CtrnnSettings(MeshedSettings, frozen=True):
    """Settings of ``[representation]`` with ``kind = "ctrnn"``."""

    iterations: Annotated[vector.Iterations, about("Euler steps in one decision")] = 2
    tau_min: Annotated[
        Tau, about("shortest time constant, decisions; at least 1 / `iterations`")
    ] = 1.0
    tau_max: Annotated[Tau, about("longest time constant")] = 10.0
    weight_range: vector.WeightRange = 4.0
    bias_range: vector.BiasRange = 4.0

    def __post_init__(self) -> None:
        """Check the time constants against each other."""
        least = 1 / self.iterations
        if self.tau_min * self.iterations < 1:
            text = f"expected at least 1 / iterations = {least:.6g}, not {self.tau_min}"
            raise ValueError(f"tau_min: {text}")
        if self.tau_max < self.tau_min:
            text = f"expected at least tau_min = {self.tau_min}, not {self.tau_max}"
            raise ValueError(f"tau_max: {text}")


@inline
def fire(state, to, parameters, biases, end):  # type: ignore[no-untyped-def]  # compiled
    """Store s(y + b) of all y."""
    for first in range(0, end, LANES):
        biased = load(state, first) + load(parameters, biases + first)
        store(state, to + first, HALF + HALF * tanh(HALF * biased))


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Make one decision: sums over the sources in order, of eight neurons at once."""
    iterations, neurons = int(parameters[0]), int(parameters[1])
    inputs, row = observation.shape[0], state.shape[0] // 3
    from_inputs, firing = row, 2 * row  # behind y
    inner = HEADER + inputs * row
    biases = inner + neurons * row
    speeds = biases + row
    weigh(parameters, HEADER, row, observation, state, from_inputs)
    fire(state, firing, parameters, biases, row)
    for _ in range(iterations):
        for first in range(0, row, LANES):  # equation 1
            sums = load(state, from_inputs + first)
            for neuron in range(neurons):
                weights = load(parameters, inner + neuron * row + first)
                sums = sums + weights * state[firing + neuron]
            y = load(state, first)
            store(state, first, y + load(parameters, speeds + first) * (sums - y))
        fire(state, firing, parameters, biases, row)
    copy_outputs(state, firing + neurons, output)


@kernel(STEP_SIGNATURE)
def step_lanes(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Make one decision of eight agents, with four independent sums at a time."""
    iterations, neurons = int(parameters[0]), int(parameters[LANES])
    row, end = state.shape[0] // 3, neurons * LANES
    from_inputs, firing = row, 2 * row
    inner = HEADER * LANES + observation.shape[0] // LANES * row
    biases = inner + neurons * row
    speeds = biases + row
    weigh_inputs_lanes(
        parameters, HEADER * LANES, row, observation, state, from_inputs, end
    )
    fire(state, firing, parameters, biases, end)
    for _ in range(iterations):
        for first in range(0, end, 4 * LANES):
            sums = take(state, from_inputs + first)
            sums = weigh_lanes(
                sums, parameters, inner + first, row, state, firing, neurons
            )
            for neuron in range(4):
                at = first + neuron * LANES
                y = load(state, at)
                store(state, at, y + load(parameters, speeds + at) * (sums[neuron] - y))
        fire(state, firing, parameters, biases, end)
    copy_lanes(state, firing + end, output)


class CTRNN(Meshed):
    """Continuous-time recurrent network: its neurons have time constants."""

    settings_type = CtrnnSettings
    step = staticmethod(step)
    step_lanes = staticmethod(step_lanes)
    settings: CtrnnSettings

    def __init__(self, settings: CtrnnSettings, inputs: int, outputs: int) -> None:
        sources = inputs + settings.hidden + outputs
        ranges = [settings.weight_range] * sources + [settings.bias_range, 1.0]
        neuron = [(reach, vector.FINE) for reach in ranges]
        super().__init__(settings, inputs, outputs, neuron)
        self._header = np.array([settings.iterations, self.neurons], np.float32)
        firing = self.state_size // 3 * 2
        self.hidden_at = range(firing, firing + settings.hidden)

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return header; per source its weights to all neurons, padded; the biases; dt / tau."""
        iterations, tables = self.settings.iterations, self.tables(genomes)
        rows = parameter_rows(self._header, tables)
        speeds = rows[:, -padded(self.neurons) :]  # a view
        speeds[:, : self.neurons] = 1.0 / (iterations * self._taus(tables[..., -1]))
        return rows

    def _texts(self, table: np.ndarray) -> list[str]:
        taus = self._taus(table[:, -1]).tolist()
        texts = super()._texts(table[:, :-1])
        return [f"{text}, tau {tau:.4g}" for text, tau in zip(texts, taus, strict=True)]

    def _taus(self, genes: np.ndarray) -> np.ndarray:
        """Return time constants in decisions, float64."""
        settings = self.settings
        cut = np.minimum(np.maximum(genes, -1.0), 1.0)  # far faster than np.clip
        share = (cut.astype(np.float64) + 1.0) / 2.0
        return np.asarray(
            settings.tau_min + (settings.tau_max - settings.tau_min) * share
        )
