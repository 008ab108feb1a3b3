"""The kernel of NEAT's networks.

A decision repeats ``iterations`` times: each hidden neuron in the order of its genes, then
each output, in place. A neuron sums its enabled links in order, subtracts its bias, and becomes
tanh(x) if it is hidden, 1 / (1 + exp(factor x)) if it is an output. All is float64, as in FREVO.

With no iterations all neurons are updated at once, from the values of the decision before, as in
NEAT 1.2.1: each becomes 1 / (1 + exp(factor x)), or remains 0 while nothing reaches it.
"""

import numpy as np

from zswarm.kernels.jit import STEP_SIGNATURE, inline, kernel
from zswarm.kernels.portable import exp

# A row of parameters: iterations (0: all at once), hidden neurons, neurons, 0; per neuron, hidden
# ones first, its links, bias and factor; then, neuron by neuron, per link its source (inputs, then
# neurons) and weight.
HEADER, PER_NEURON, PER_LINK = 4, 7, 4

# The 64 bits of a float64 stand in three float32 numbers, as integers of 20, 22 and 22 bits, which
# float32 holds exactly.
HIGH, MIDDLE, LOW = np.uint64(44), np.uint64(22), np.uint64((1 << 22) - 1)


@inline
def load_double(array, at):  # type: ignore[no-untyped-def]  # compiled
    """Return the float64 that three float32 numbers hold."""
    high = np.uint64(array[at])
    middle = np.uint64(array[at + 1])
    low = np.uint64(array[at + 2])
    return np.uint64((high << HIGH) | (middle << MIDDLE) | low).view(np.float64)


@inline
def store_double(array, at, number):  # type: ignore[no-untyped-def]  # compiled
    """Store a float64 in three float32 numbers."""
    bits = np.float64(number).view(np.uint64)
    array[at] = np.float32(bits >> HIGH)
    array[at + 1] = np.float32((bits >> MIDDLE) & LOW)
    array[at + 2] = np.float32(bits & LOW)


@inline
def tanh(x):  # type: ignore[no-untyped-def]  # compiled
    """Return the hyperbolic tangent, float64, as FREVO computes it."""
    if x < -20.0:
        return -1.0
    if x > 20.0:
        return 1.0
    e = exp(-2.0 * x)
    return (1.0 - e) / (1.0 + e)


@inline
def total_of(parameters, state, observation, of, link):  # type: ignore[no-untyped-def]  # compiled
    """Return the sum of a neuron's links minus its bias, and whether anything reaches it."""
    inputs = observation.shape[0]
    total = 0.0
    reached = False
    at = link
    for _link in range(int(parameters[of])):
        source = int(parameters[at])
        weight = load_double(parameters, at + 1)
        if source < inputs:
            value = np.float64(observation[source])
            reached = True
        else:
            value = load_double(state, 3 * (source - inputs))
            reached = reached or value != 0.0
        total += value * weight
        at += PER_LINK
    bias = load_double(parameters, of + 1)
    total += -1.0 * bias
    return total, reached or bias != 0.0


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Make one decision; ``state`` holds each neuron's value, in the order of the parameters.

    If all are updated at once, the new values are behind the old ones until all are computed.
    """
    iterations = int(parameters[0])
    hidden = int(parameters[1])
    neurons = int(parameters[2])
    after = 0 if iterations > 0 else state.shape[0] // 2
    for _ in range(max(iterations, 1)):
        link = HEADER + PER_NEURON * neurons
        for neuron in range(neurons):
            of = HEADER + PER_NEURON * neuron
            total, reached = total_of(parameters, state, observation, of, link)
            link += PER_LINK * int(parameters[of])
            if neuron < hidden and iterations > 0:
                value = tanh(total)
            else:
                value = 1.0 / (1.0 + exp(load_double(parameters, of + 4) * total))
            if iterations == 0 and not reached:
                value = 0.0
            store_double(state, after + 3 * neuron, value)
    for number in range(after):
        state[number] = state[after + number]
    for index in range(output.shape[0]):
        output[index] = np.float32(load_double(state, 3 * (hidden + index)))


def words(numbers: np.ndarray) -> np.ndarray:
    """Return (n, 3) float32, as ``load_double`` reads them."""
    bits = np.ascontiguousarray(numbers, "<f8").view(np.uint64)
    return np.stack([bits >> HIGH, (bits >> MIDDLE) & LOW, bits & LOW], axis=1).astype(
        np.float32
    )
