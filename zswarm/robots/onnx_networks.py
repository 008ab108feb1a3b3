"""Networks as graphs of ONNX: a decision from parameters, memory and observation, as their kernels compute it.

Sums are those of matrix products, whose order is the run-time's, so the last bits differ; ``tanh`` is that of ``portable.py``.
The memory is a row of numbers, all zero at the start of a trial; it has no place for what a kernel only computes with.
"""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from zswarm import portable
from zswarm.errors import ConfigError
from zswarm.nets import neat
from zswarm.nets.bulk import Bulk
from zswarm.nets.ctrnn import CTRNN
from zswarm.nets.feed_forward import Layered
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.nets.hebbian import Hebbian
from zswarm.nets.mealy import HEADER, PER_INPUT, Mealy
from zswarm.nets.neat import Neat
from zswarm.nets.neurons import Activation
from zswarm.nets.representation import Representation
from zswarm.robots.onnx_graph import Graph

INT_MIN, INT_MAX = -(2**31), 2**31 - 1


class Memory(NamedTuple):
    """How many numbers a network keeps from one decision to the next, and of which type."""

    length: int
    dtype: type[np.floating[Any]] = np.float32


class Decided(NamedTuple):
    """Names of values in the graph."""

    action: str
    memory: str


def memory(network: Representation) -> Memory:
    """What a network keeps.

    Raises:
        ConfigError: it is none of those that can be written.
    """
    match network:
        case FullyMeshed() | CTRNN():
            return Memory(network.neurons)
        case Layered():
            return Memory(0)
        case Hebbian():
            return Memory(network.neurons * (1 + network.sources) + 1)
        case Mealy():
            return Memory(1)
        case Neat():
            return Memory(network.settings.max_hidden + network.outputs, np.float64)
        case Bulk():
            part = memory(network.part)
            return Memory(network.settings.parts * part.length, part.dtype)
    raise ConfigError(f"--to onnx: knows the networks that are bundled, not {type(network).__name__}; python and c99 may know it")


def decide(graph: Graph, network: Representation, genome: bytes, observation: str, before: str) -> Decided:
    """Write one decision into a graph.

    Args:
        observation: (inputs,) float32.
        before: as ``memory`` says; of no meaning where that is of length 0.
    """
    write = WRITERS[next(kind for kind in type(network).__mro__ if kind in WRITERS)]
    return write(graph, network, genome, observation, before)


# ---- what networks have in common


def _tanh(graph: Graph, x: str) -> str:
    """``portable.tanh``."""
    op, number = graph.op, graph.constant
    size = op("Min", op("Abs", x), number(portable.FLAT))
    root = number(portable.T4)
    for coefficient in (portable.T3, portable.T2, portable.T1, portable.ONE):
        root = op("Add", number(coefficient), op("Mul", size, root))
    square = op("Mul", root, root)
    below = op("Add", op("Mul", square, square), number(portable.ONE))
    return op("Mul", op("Sign", x), op("Sub", number(portable.ONE), op("Div", number(portable.TWO), below)))


def _activated(graph: Graph, activation: Activation, sums: str) -> str:
    match activation:
        case "clamp":
            return graph.op("Clip", sums, graph.constant(0), graph.constant(1))
        case "relu":
            return graph.op("Relu", sums)
        case "tanh":
            return _tanh(graph, sums)
        case "sigmoid":
            return graph.op("Sigmoid", sums)


def _last(graph: Graph, values: str, count: int, of: int) -> str:
    return graph.part(values, of - count, of)


# ---- networks


def _fully_meshed(graph: Graph, network: FullyMeshed, genome: bytes, observation: str, before: str) -> Decided:
    table = network.vectors([genome]).reshape(network.shape)
    op, inputs, values = graph.op, network.inputs, before
    fixed = op("Add", op("MatMul", graph.constant(table[:, :inputs]), observation), graph.constant(table[:, -1]))
    for _ in range(network.settings.iterations):
        sums = op("Add", op("MatMul", graph.constant(table[:, inputs:-1]), values), fixed)
        values = _activated(graph, network.settings.activation, sums)
    return Decided(_last(graph, values, network.outputs, network.neurons), values)


def _layered(graph: Graph, network: Layered, genome: bytes, observation: str, before: str) -> Decided:
    vector, values, begin, sources = network.vectors([genome])[0], observation, 0, network.inputs
    hidden, last = network.activations
    for number, nodes in enumerate(network.widths, 1):
        end = begin + nodes * (sources + 1)
        table = vector[begin:end].reshape(nodes, sources + 1)
        sums = graph.op("Add", graph.op("MatMul", graph.constant(table[:, :-1]), values), graph.constant(table[:, -1]))
        values = _activated(graph, last if number == len(network.widths) else hidden, sums)
        begin, sources = end, nodes
    return Decided(values, before)


def _ctrnn(graph: Graph, network: CTRNN, genome: bytes, observation: str, before: str) -> Decided:
    """The memory is y."""
    op, half, inputs = graph.op, graph.constant(0.5), network.inputs
    rows = network.parameters([genome])[0][2:].reshape(network.sources + 2, -1)[:, : network.neurons]
    biases, speeds = graph.constant(rows[-2]), graph.constant(rows[-1])

    def firing(y: str) -> str:
        return op("Add", half, op("Mul", half, _tanh(graph, op("Mul", half, op("Add", y, biases)))))

    fixed, y = op("MatMul", graph.constant(rows[:inputs].T), observation), before
    for _ in range(network.settings.iterations):
        sums = op("Add", fixed, op("MatMul", graph.constant(rows[inputs:-2].T), firing(y)))
        y = op("Add", y, op("Mul", speeds, op("Sub", sums, y)))
    return Decided(_last(graph, firing(y), network.outputs, network.neurons), y)


def _hebbian(graph: Graph, network: Hebbian, genome: bytes, observation: str, before: str) -> Decided:
    """The memory is outputs, weights neuron by neuron, and whether the weights are there."""
    op, neurons, sources, inputs = graph.op, network.neurons, network.sources, network.inputs
    vector = network.vectors([genome])[0]
    table = vector[:-1].reshape(neurons, -1)
    values, begun = graph.part(before, 0, neurons), graph.part(before, neurons * (1 + sources), neurons * (1 + sources) + 1)
    learnt = graph.shaped(graph.part(before, neurons, neurons * (1 + sources)), neurons, sources)
    is_new = op("Equal", begun, graph.constant([0]))
    weights = op("Where", is_new, graph.constant(table[:, :sources]), learnt)
    for _ in range(network.settings.iterations):
        sums = op("MatMul", weights, op("Concat", observation, values, axis=0))
        values = _activated(graph, "clamp", op("Add", sums, graph.constant(table[:, -1])))
    double = np.float64
    centre, rate = graph.constant(0.5, double), graph.constant(np.float64(vector[-1]), double)
    change = op("Mul", rate, op("Sub", graph.cast(graph.shaped(values, neurons, 1), double), centre))
    heard = graph.cast(graph.shaped(op("Concat", observation, values, axis=0), 1, sources), double)
    deltas = graph.cast(op("Mul", change, op("Sub", heard, centre)), np.float32)
    others = np.ones((neurons, sources), np.float32)  # all but the weight of a neuron to itself
    others[np.arange(neurons), inputs + np.arange(neurons)] = 0
    total = op("ReduceSum", op("Mul", deltas, graph.constant(others)), keepdims=0)
    mean = op("Div", total, graph.constant(neurons * (sources - 1)))
    plasticity = table[:, sources : 2 * sources] if network.plastic else np.float32(1)
    learning = op("Mul", graph.constant(others * plasticity), op("Sub", deltas, mean))
    weights = graph.shaped(op("Add", weights, learning), neurons * sources)
    after = op("Concat", values, weights, graph.constant([1]), axis=0)
    return Decided(_last(graph, values, network.outputs, neurons), after)


def _neat(graph: Graph, network: Neat, genome: bytes, observation: str, before: str) -> Decided:
    """The memory is the neurons' values, float64, hidden ones first; behind them is room for those that could grow."""
    op, double, row = graph.op, np.float64, network.parameters([genome])[0]
    iterations, hidden, neurons = (int(number) for number in row[:3])
    per_neuron = row[neat.HEADER :][: neurons * neat.PER_NEURON].reshape(neurons, neat.PER_NEURON)
    links = row[neat.HEADER + per_neuron.size :].reshape(-1, neat.PER_LINK)
    biases, factors, weights = (_doubles(words) for words in (per_neuron[:, 1:4], per_neuron[:, 4:], links[:, 1:]))
    ends = [0, *itertools.accumulate(per_neuron[:, 0].astype(int).tolist())]
    seen, one = graph.cast(observation, double), graph.constant([1], double)
    values = [graph.part(seen, number, number + 1) for number in range(network.inputs)]
    values += [graph.part(before, number, number + 1) for number in range(neurons)]
    for neuron in [*range(neurons)] * iterations:
        arriving = range(ends[neuron], ends[neuron + 1])
        total = graph.constant([-biases[neuron]], double)
        if arriving:
            heard = op("Concat", *(values[int(links[link, 0])] for link in arriving), axis=0)
            brought = op("Mul", heard, graph.constant(weights[arriving.start : arriving.stop], double))
            total = op("Add", total, op("ReduceSum", brought, keepdims=1))
        if neuron < hidden:
            flat = op("Max", op("Min", total, graph.constant(20, double)), graph.constant(-20, double))
            e = op("Exp", op("Mul", flat, graph.constant(-2, double)))
            values[network.inputs + neuron] = op("Div", op("Sub", one, e), op("Add", one, e))
        else:
            e = op("Exp", op("Mul", total, graph.constant(factors[neuron], double)))
            values[network.inputs + neuron] = op("Div", one, op("Add", one, e))
    room = graph.constant(np.zeros(memory(network).length - neurons), double)
    after = op("Concat", *values[network.inputs :], room, axis=0)
    action = graph.part(after, hidden, neurons)
    return Decided(graph.cast(action, np.float32), after)


def _doubles(words: np.ndarray) -> np.ndarray:
    """What ``neat.load_double`` reads of rows of three float32 numbers."""
    high, middle, low = words.astype(np.uint64).T
    numbers: np.ndarray = (high << neat.HIGH | middle << neat.MIDDLE | low).view(np.float64)
    return numbers


def _mealy(graph: Graph, network: Mealy, genome: bytes, observation: str, before: str) -> Decided:
    """All of it is exact."""
    op, whole, row = graph.op, np.int64, network.parameters([genome])[0]
    states, first, product, table = int(row[0]), int(row[1]), int(row[3]), int(row[5])
    scaled = _to_int(graph, op("Mul", observation, graph.constant(row[4])))
    chosen, combinations, at = graph.constant([product], whole), 1, HEADER
    for number in range(network.inputs):
        thresholds, least, most, units = (int(row[at + place]) for place in range(PER_INPUT))
        value = graph.part(scaled, number, number + 1)
        if thresholds:
            # So many are reached before the first that is not: those whose greatest so far is reached.
            reached = np.maximum.accumulate(row[at + PER_INPUT :][:thresholds]).astype(whole)
            above = op("GreaterOrEqual", value, graph.constant(reached, whole))
            place, classes = op("ReduceSum", graph.cast(above, whole), keepdims=1), thresholds + 1
        else:
            within = op("Min", op("Max", value, graph.constant([least], whole)), graph.constant([most], whole))
            steps = op("Mul", op("Sub", within, graph.constant([least], whole)), graph.constant([units], whole))
            place = graph.cast(op("Div", graph.cast(steps, np.float32), graph.constant([most - least])), whole)
            classes = units + 1
        if product:
            chosen = op("Mul", chosen, op("Add", place, graph.constant([1], whole)))
        else:
            chosen = op("Add", op("Mul", chosen, graph.constant([classes], whole)), place)
        combinations *= classes
        at += PER_INPUT + thresholds
    started = op("Sub", graph.cast(before, whole), graph.constant([1], whole))
    current = op("Where", op("Less", started, graph.constant([0], whole)), graph.constant([first], whole), started)
    row_of = op("Sub", chosen, graph.constant([product], whole))
    entry = op("Add", op("Mul", row_of, graph.constant([states], whole)), current)
    following = row[table : table + combinations * states] + np.float32(1)
    outputs = row[table + combinations * states :][: combinations * states * network.outputs] / row[2]
    action = op("Gather", graph.constant(outputs.reshape(-1, network.outputs)), entry, axis=0)
    return Decided(graph.shaped(action, network.outputs), op("Gather", graph.constant(following), entry, axis=0))


def _to_int(graph: Graph, x: str) -> str:
    """``portable.to_int``, as int64."""
    number = graph.op("Where", graph.op("IsNaN", x), graph.constant(0), x)
    bounded = graph.op("Clip", number, graph.constant(INT_MIN), graph.constant(-INT_MIN))  # float32 has no number for INT_MAX
    return graph.op("Min", graph.cast(bounded, np.int64), graph.constant(INT_MAX, np.int64))


def _bulk(graph: Graph, network: Bulk, genome: bytes, observation: str, before: str) -> Decided:
    """All parts decide; the decision and the new memory of one are taken."""
    op, parts, kept = graph.op, network.settings.parts, memory(network.part)
    said = graph.part(observation, network.settings.input, network.settings.input + 1)
    number = _to_int(graph, op("Add", said, graph.constant(0.5)))
    part = op("Max", op("Min", number, graph.constant([parts - 1], np.int64)), graph.constant([0], np.int64))
    size, action, after = len(genome) // parts, "", []
    for index in range(parts):
        its = graph.part(before, index * kept.length, (index + 1) * kept.length) if kept.length else ""
        decided = decide(graph, network.part, genome[index * size : (index + 1) * size], observation, its)
        is_it = op("Equal", part, graph.constant([index], np.int64))
        action = op("Where", is_it, decided.action, action) if action else decided.action
        if kept.length:
            after.append(op("Where", is_it, decided.memory, its))
    return Decided(action, op("Concat", *after, axis=0) if after else "")


WRITERS: dict[type[Representation], Callable[..., Decided]] = {
    Bulk: _bulk,
    CTRNN: _ctrnn,
    FullyMeshed: _fully_meshed,
    Hebbian: _hebbian,
    Layered: _layered,
    Mealy: _mealy,
    Neat: _neat,
}
