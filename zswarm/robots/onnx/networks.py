"""Networks as ONNX graphs: a decision from parameters, memory and observation, as in their kernels.

Sums are those of matrix products, in the runtime's order, so the last bits differ. The memory is a
row of numbers, all zero at the start of a trial, without a kernel's scratch space.
"""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.kernels.portable import FLAT, ONE, T1, T2, T3, T4, TWO
from zswarm.nets import neat_kernel as neat
from zswarm.nets.bulk import Bulk
from zswarm.nets.ctrnn import CTRNN
from zswarm.nets.feed_forward import Layered
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.nets.hebbian import Hebbian
from zswarm.nets.mealy import Mealy
from zswarm.nets.mealy_kernel import HEADER, PER_INPUT
from zswarm.nets.neat import Neat
from zswarm.nets.neurons import Activation
from zswarm.nets.representation import Representation
from zswarm.robots.onnx.graph import OnnxValue

INT_MIN, INT_MAX = -(2**31), 2**31 - 1


class Memory(NamedTuple):
    """The numbers that a network keeps from one decision to the next, and their type."""

    length: int
    dtype: type[np.floating[Any]] = np.float32


class Decided(NamedTuple):
    """Values in the graph."""

    action: OnnxValue
    memory: OnnxValue


def memory(network: Representation) -> Memory:
    """Return the size of a network's memory."""
    match network:
        case FullyMeshed() | CTRNN():
            return Memory(network.neurons)
        case Layered():
            return Memory(0)
        case Hebbian():
            return Memory(network.neurons * (1 + network.sources) + 1)
        case Mealy():
            return Memory(1)
        case Neat() if not network.settings.synchronous:
            return Memory(network.settings.max_hidden + network.outputs, np.float64)
        case Bulk():
            part = memory(network.part)
            return Memory(network.settings.parts * part.length, part.dtype)
    raise ConfigError(
        "--to onnx: knows the bundled networks except chocolate, and neat unless it is "
        f"synchronous, not this {type(network).__name__}; python and c99 may know it"
    )


def decide(
    network: Representation, genome: bytes, observation: OnnxValue, before: OnnxValue
) -> Decided:
    """Write one decision into a graph.

    Args:
        observation: (inputs,) float32.
        before: the memory; not read where its length is 0.
    """
    write = WRITERS[next(kind for kind in type(network).__mro__ if kind in WRITERS)]
    return write(network, genome, observation, before)


# ---- what networks have in common


def _tanh(x: OnnxValue) -> OnnxValue:
    """Write ``portable.tanh``."""
    size = x.op("Abs").op("Min", FLAT)
    root: Any = T4
    for coefficient in (T3, T2, T1, ONE):
        root = coefficient + size * root
    square = root * root
    result: OnnxValue = x.op("Sign") * (ONE - TWO / (square * square + ONE))
    return result


def _activated(activation: Activation, sums: OnnxValue) -> OnnxValue:
    match activation:
        case "clamp":
            return sums.op("Clip", 0, 1)
        case "relu":
            return sums.op("Relu")
        case "tanh":
            return _tanh(sums)
        case "sigmoid":
            return sums.op("Sigmoid")


def _to_int(x: OnnxValue) -> OnnxValue:
    """Write ``portable.to_int``, as int64."""
    number = x.graph.where(x.op("IsNaN"), x.graph.constant(0), x)
    bounded = number.op("Clip", INT_MIN, -INT_MIN)  # float32 has no number for INT_MAX
    return bounded.cast(np.int64).op("Min", INT_MAX)


# ---- networks


def _fully_meshed(
    network: FullyMeshed, genome: bytes, observation: OnnxValue, before: OnnxValue
) -> Decided:
    (table,) = network.tables([genome])
    inputs, neurons, values = network.inputs, network.neurons, before
    fixed = table[:, :inputs] @ observation + table[:, -1]
    for _ in range(network.settings.iterations):
        sums = table[:, inputs:-1] @ values + fixed
        values = _activated(network.settings.activation, sums)
    return Decided(values[neurons - network.outputs : neurons], values)


def _layered(
    network: Layered, genome: bytes, observation: OnnxValue, before: OnnxValue
) -> Decided:
    values, (hidden, last) = observation, network.activations
    activations = [hidden] * (len(network.widths) - 1) + [last]
    steepness = np.float32(getattr(network.settings, "steepness", 1))
    for (table,), activation in zip(network.tables([genome]), activations, strict=True):
        rows = table * steepness
        values = _activated(activation, rows[:, :-1] @ values + rows[:, -1])
    return Decided(values, before)


def _ctrnn(
    network: CTRNN, genome: bytes, observation: OnnxValue, before: OnnxValue
) -> Decided:
    """Write a CTRNN; its memory is y."""
    inputs, neurons, half = network.inputs, network.neurons, np.float32(0.5)
    rows = network.parameters([genome])[0][2:].reshape(network.sources + 2, -1)[
        :, :neurons
    ]

    def firing(y: OnnxValue) -> OnnxValue:
        return half + half * _tanh(half * (y + rows[-2]))

    fixed, y = rows[:inputs].T @ observation, before
    for _ in range(network.settings.iterations):
        y = y + rows[-1] * (fixed + rows[inputs:-2].T @ firing(y) - y)
    return Decided(firing(y)[neurons - network.outputs : neurons], y)


def _hebbian(
    network: Hebbian, genome: bytes, observation: OnnxValue, before: OnnxValue
) -> Decided:
    """Write a Hebbian network; its memory is outputs, weights, and whether the weights are set."""
    graph, neurons, sources = observation.graph, network.neurons, network.sources
    rate = np.float64(network.vectors([genome])[0, -1])
    (table,), size = network.tables([genome]), neurons * (1 + sources)
    values, begun = before[0:neurons], before[size : size + 1]
    learnt = before[neurons:size].shaped(neurons, sources)
    is_new = begun.op("Equal", [0])
    weights = graph.where(is_new, graph.constant(table[:, :sources]), learnt)
    for _ in range(network.settings.iterations):
        sums = weights @ graph.concat(observation, values)
        values = _activated("clamp", sums + table[:, -1])
    centre = np.float64(0.5)
    change = rate * (values.shaped(neurons, 1).cast(np.float64) - centre)
    heard = graph.concat(observation, values).shaped(1, sources).cast(np.float64)
    deltas = (change * (heard - centre)).cast(np.float32)
    # 0 for the weight of a neuron to itself.
    others = np.ones((neurons, sources), np.float32)
    others[np.arange(neurons), network.inputs + np.arange(neurons)] = 0
    mean = (deltas * others).op("ReduceSum", keepdims=0) / (neurons * (sources - 1))
    plasticity = table[:, sources : 2 * sources] if network.plastic else np.float32(1)
    weights = weights + (others * plasticity) * (deltas - mean)
    after = graph.concat(values, weights.shaped(neurons * sources), graph.constant([1]))
    return Decided(values[neurons - network.outputs : neurons], after)


def _neat(
    network: Neat, genome: bytes, observation: OnnxValue, before: OnnxValue
) -> Decided:
    """Write a NEAT network.

    The memory is the neurons' values, float64, hidden ones first, then room for those that could
    grow.
    """
    graph, row = observation.graph, network.parameters([genome])[0]
    iterations, hidden, neurons = (int(number) for number in row[:3])
    per_neuron = row[neat.HEADER :][: neurons * neat.PER_NEURON].reshape(
        neurons, neat.PER_NEURON
    )
    links = row[neat.HEADER + per_neuron.size :].reshape(-1, neat.PER_LINK)
    weights, sources = _doubles(links[:, 1:]), links[:, 0].astype(int)
    biases, factors = _doubles(per_neuron[:, 1:4]), _doubles(per_neuron[:, 4:])
    ends = [0, *itertools.accumulate(per_neuron[:, 0].astype(int).tolist())]
    seen, one = observation.cast(np.float64), graph.constant([1], np.float64)
    values = [seen[at : at + 1] for at in range(network.inputs)]
    values += [before[at : at + 1] for at in range(neurons)]
    for neuron in [*range(neurons)] * iterations:
        total = graph.constant([-biases[neuron]], np.float64)
        begin, end = ends[neuron : neuron + 2]
        if begin < end:
            heard = graph.concat(*(values[source] for source in sources[begin:end]))
            total = total + (heard * weights[begin:end]).op("ReduceSum", keepdims=1)
        if neuron < hidden:
            e = (total.op("Min", 20).op("Max", -20) * -2).op("Exp")
            value = (one - e) / (one + e)
        else:
            value = one / (one + (total * factors[neuron]).op("Exp"))
        values[network.inputs + neuron] = value
    room = graph.constant(np.zeros(memory(network).length - neurons), np.float64)
    after = graph.concat(*values[network.inputs :], room)
    return Decided(after[hidden:neurons].cast(np.float32), after)


def _doubles(words: np.ndarray) -> np.ndarray:
    """Decode rows of three float32 numbers as ``neat.load_double`` does."""
    high, middle, low = words.astype(np.uint64).T
    numbers: np.ndarray = (high << neat.HIGH | middle << neat.MIDDLE | low).view(
        np.float64
    )
    return numbers


def _mealy(
    network: Mealy, genome: bytes, observation: OnnxValue, before: OnnxValue
) -> Decided:
    """Write a Mealy machine, exactly."""
    graph, row = observation.graph, network.parameters([genome])[0]
    states, first, product, table = int(row[0]), int(row[1]), int(row[3]), int(row[5])
    scaled = _to_int(observation * row[4])
    chosen, combinations, at = graph.constant([product], np.int64), 1, HEADER
    for number in range(network.inputs):
        place, classes = _class_of(scaled[number : number + 1], row[at:])
        chosen = chosen * (place + 1) if product else chosen * [classes] + place
        combinations *= classes
        at += PER_INPUT + int(row[at])
    started = before.cast(np.int64) - [1]
    is_first = started.op("Less", [0], dtype=np.bool_)
    current = graph.where(is_first, graph.constant([first], np.int64), started)
    entry = (chosen - [product]) * [states] + current
    size = combinations * states
    following = row[table : table + size] + np.float32(1)
    outputs = row[table + size :][: size * network.outputs] / row[2]
    rows = graph.constant(outputs.reshape(-1, network.outputs))
    action = rows.op("Gather", entry, axis=0).shaped(network.outputs)
    return Decided(action, graph.constant(following).op("Gather", entry, axis=0))


def _class_of(value: OnnxValue, row: np.ndarray) -> tuple[OnnxValue, int]:
    """Return the class of an input, and the number of classes."""
    thresholds, least, most, units = (int(number) for number in row[:PER_INPUT])
    if thresholds:
        # A kernel counts up to the first threshold that is not reached: as if they were ascending.
        ascending = np.maximum.accumulate(row[PER_INPUT:][:thresholds]).astype(np.int64)
        above = value.op("GreaterOrEqual", ascending, dtype=np.bool_)
        return above.cast(np.int64).op("ReduceSum", keepdims=1), thresholds + 1
    steps = (value.clip([least], [most]) - [least]) * [units]
    return (steps.cast(np.float32) / [most - least]).cast(np.int64), units + 1


def _bulk(
    network: Bulk, genome: bytes, observation: OnnxValue, before: OnnxValue
) -> Decided:
    """Write all parts; the decision and the new memory of one are chosen."""
    graph = observation.graph
    parts = network.settings.parts
    selector = network.settings.input
    size, length = len(genome) // parts, memory(network.part).length
    number = _to_int(observation[selector : selector + 1] + np.float32(0.5))
    part = number.op("Min", [parts - 1]).op("Max", [0])
    action, after = None, []
    for index in range(parts):
        own = before[index * length : (index + 1) * length] if length else before
        its_genome = genome[index * size : (index + 1) * size]
        decided = decide(network.part, its_genome, observation, own)
        is_it = part.op("Equal", [index], dtype=np.bool_)
        action = graph.where(is_it, decided.action, action) if action else decided.action
        if length:
            after.append(graph.where(is_it, decided.memory, own))
    assert action is not None  # noqa: S101  there is a part
    return Decided(action, graph.concat(*after) if after else before)


WRITERS: dict[type[Representation], Callable[..., Decided]] = {
    Bulk: _bulk,
    CTRNN: _ctrnn,
    FullyMeshed: _fully_meshed,
    Hebbian: _hebbian,
    Layered: _layered,
    Mealy: _mealy,
    Neat: _neat,
}
