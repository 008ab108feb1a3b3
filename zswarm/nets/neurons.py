"""What the kernels of several networks do with eight numbers at once: activations, and sums of four neurons at a time."""

from typing import Literal

import numpy as np

from zswarm.jit import float32, inline
from zswarm.lanes import LANES, load, select, store
from zswarm.portable import sigmoid, tanh

Activation = Literal["clamp", "sigmoid", "relu", "tanh"]
ACTIVATIONS = ("clamp", "sigmoid", "relu", "tanh")
MEANING = "clamp: cut to 0..1; sigmoid: 1 / (1 + e^-x); relu: negative is 0; tanh: -1..1, within 3.7e-5"
CLAMP, SIGMOID, RELU, TANH = range(4)
ZERO, ONE = np.float32(0), np.float32(1)


def padded(neurons: int) -> int:
    """So many neurons and as many more as make whole eights."""
    return -(-neurons // LANES) * LANES


@inline
def activate(activation, state, at, to, wanted):  # type: ignore[no-untyped-def]  # compiled
    """Eight outputs from eight sums, of which so many are wanted."""
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


@inline
def take(array, at):  # type: ignore[no-untyped-def]  # compiled
    """What four neurons have, eight agents each."""
    return load(array, at), load(array, at + LANES), load(array, at + 2 * LANES), load(array, at + 3 * LANES)


@inline
def put(sums, array, at):  # type: ignore[no-untyped-def]  # compiled
    """Write it."""
    for neuron in range(4):
        store(array, at + neuron * LANES, sums[neuron])


@inline
def add(sums, parameters, at, value):  # type: ignore[no-untyped-def]  # compiled
    """Add what one source gives to four neurons."""
    weights = take(parameters, at)
    return (
        sums[0] + weights[0] * value,
        sums[1] + weights[1] * value,
        sums[2] + weights[2] * value,
        sums[3] + weights[3] * value,
    )
