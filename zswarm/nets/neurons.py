"""Parts of the kernels of several networks: activations, weighted sums, rows of parameters."""

from typing import Literal, get_args

import numpy as np

from zswarm.kernels.jit import float32, inline
from zswarm.kernels.lanes import LANES, fill, load, select, store
from zswarm.kernels.portable import sigmoid, tanh

Activation = Literal["clamp", "sigmoid", "relu", "tanh"]
ACTIVATIONS = get_args(Activation)
MEANING = (
    "clamp: cut to 0..1; sigmoid: 1 / (1 + e^-x); relu: negative is 0; "
    "tanh: -1..1, within 3.7e-5"
)
CLAMP, SIGMOID, RELU, TANH = range(4)
ZERO, ONE = np.float32(0), np.float32(1)


def padded(neurons: int) -> int:
    """Round up to a multiple of eight."""
    return -(-neurons // LANES) * LANES


def parameter_rows(header: np.ndarray, *layers: np.ndarray) -> np.ndarray:
    """Return (genomes, P) float32: header, then per layer and gene the numbers of all neurons.

    Args:
        layers: (genomes, neurons, genes of a neuron). Neurons are padded to a multiple of eight.
    """
    ends = [len(header)]
    for layer in layers:
        ends.append(ends[-1] + layer.shape[2] * padded(layer.shape[1]))
    rows = np.zeros((len(layers[0]), ends[-1]), np.float32)
    rows[:, : ends[0]] = header
    for layer, begin, end in zip(layers, ends, ends[1:], strict=False):
        count, neurons, genes = layer.shape
        part = rows[:, begin:end].reshape(count, genes, -1)  # a view
        part[..., :neurons] = layer.transpose(0, 2, 1)
    return rows


@inline(counts=False)
def activate(activation, state, at, to, wanted):  # type: ignore[no-untyped-def]  # compiled
    """Store the outputs of eight sums; sigmoid computes only the first ``wanted``."""
    sums = load(state, at)
    if activation == CLAMP:
        positive = select(sums < ZERO, ZERO, sums)
        store(state, to, select(positive > ONE, ONE, positive))
    elif activation == RELU:
        store(state, to, select(sums < ZERO, ZERO, sums))
    elif activation == TANH:
        store(state, to, tanh(sums))
    else:
        for lane in range(wanted):
            state[to + lane] = float32(sigmoid(np.float64(state[at + lane])))


@inline(counts=False)
def copy_outputs(state, end, output):  # type: ignore[no-untyped-def]  # compiled
    """Copy the values of the last neurons, which end at ``end``, to the output."""
    begin = end - output.shape[0]
    for index in range(output.shape[0]):
        output[index] = state[begin + index]


# ---- one agent, eight neurons at once


@inline(counts=False)
def weigh(parameters, at, row, values, state, to):  # type: ignore[no-untyped-def]  # compiled
    """Store the sums of values, in order, times their weights, for all neurons.

    The weights of the first value, ``row`` numbers, begin at ``at``; those of the next follow.
    """
    for first in range(0, row, LANES):
        sums = fill(ZERO)
        for source in range(values.shape[0]):
            weights = load(parameters, at + source * row + first)
            sums = sums + weights * values[source]
        store(state, to + first, sums)


# ---- eight agents, four neurons at once


@inline(counts=False)
def take(array, at):  # type: ignore[no-untyped-def]  # compiled
    """Load the numbers of four neurons, eight agents each."""
    return (
        load(array, at),
        load(array, at + LANES),
        load(array, at + 2 * LANES),
        load(array, at + 3 * LANES),
    )


@inline(counts=False)
def put(sums, array, at):  # type: ignore[no-untyped-def]  # compiled
    """Store the numbers of four neurons."""
    for neuron in range(4):
        store(array, at + neuron * LANES, sums[neuron])


@inline(counts=False)
def add(sums, parameters, at, value):  # type: ignore[no-untyped-def]  # compiled
    """Add one source's value times its weights to the sums of four neurons."""
    weights = take(parameters, at)
    return (
        sums[0] + weights[0] * value,
        sums[1] + weights[1] * value,
        sums[2] + weights[2] * value,
        sums[3] + weights[3] * value,
    )


@inline(counts=False)
def weigh_lanes(sums, parameters, at, row, values, first, count):  # type: ignore[no-untyped-def]  # compiled
    """Add weighted values as ``weigh`` does, to the sums of four neurons of eight agents."""
    for source in range(count):
        sums = add(
            sums, parameters, at + source * row, load(values, first + source * LANES)
        )
    return sums


@inline(counts=False)
def weigh_inputs_lanes(parameters, at, row, observation, state, to, end):  # type: ignore[no-untyped-def]  # compiled
    """Store the weighted sums of the inputs for all neurons, ``end`` numbers, of eight agents."""
    inputs = observation.shape[0] // LANES
    for first in range(0, end, 4 * LANES):
        sums = fill(ZERO), fill(ZERO), fill(ZERO), fill(ZERO)
        sums = weigh_lanes(sums, parameters, at + first, row, observation, 0, inputs)
        put(sums, state, to + first)


@inline(counts=False)
def copy_lanes(state, end, output):  # type: ignore[no-untyped-def]  # compiled
    """Copy outputs as ``copy_outputs`` does, of eight agents: faster than number by number."""
    begin = end - output.shape[0]
    for index in range(0, output.shape[0], LANES):
        store(output, index, load(state, begin + index))
