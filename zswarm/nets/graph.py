"""A network as a drawing has it: what it consists of, and what leads where."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

Kind = Literal["input", "hidden", "output", "state"]


class Node(NamedTuple):
    """An input, a neuron, or a state of a machine.

    Attributes:
        kind: what it is.
        number: among the inputs, the hidden neurons, the outputs or the states, from 0.
        text: what else there is to know of it, such as its bias.
        part: of a genome that holds several networks, the number of its network, from 0.
    """

    kind: Kind
    number: int
    text: str = ""
    part: int = 0


class Edge(NamedTuple):
    """What one node hears of another, or a transition.

    Attributes:
        source, target: places in the list of nodes.
        weight: how much; of transitions, the share of the state's inputs that lead there.
        text: what else there is to know of it.
    """

    source: int
    target: int
    weight: float
    text: str = ""


class Graph(NamedTuple):
    """Nodes, inputs first and outputs last, and edges between them."""

    nodes: list[Node]
    edges: list[Edge]


def of_layers(inputs: int, widths: Sequence[int], tables: Sequence[np.ndarray]) -> Graph:
    """Layers, each of which hears the one before.

    Args:
        inputs: numbers that the network observes.
        widths: neurons of each layer, the outputs last.
        tables: per layer (neurons, nodes of the layer before + 1), weights and at last the bias.
    """
    nodes = [Node("input", number) for number in range(inputs)]
    edges, before, hidden = [], range(inputs), 0
    for layer, (width, table) in enumerate(zip(widths, tables, strict=True)):
        begin, last = len(nodes), layer == len(widths) - 1
        for neuron, row in enumerate(table.tolist()):
            edges += [Edge(source, begin + neuron, weight) for source, weight in zip(before, row, strict=False)]
            number = neuron if last else hidden + neuron
            nodes.append(Node("output" if last else "hidden", number, f"bias {row[-1]:.4g}"))
        hidden += 0 if last else width
        before = range(begin, len(nodes))
    return Graph(nodes, edges)


def of_meshed(inputs: int, outputs: int, weights: np.ndarray, texts: Sequence[str]) -> Graph:
    """Neurons, hidden ones first, each of which hears all inputs and all neurons.

    Args:
        inputs, outputs: numbers that the network observes, and sets.
        weights: (neurons, inputs + neurons).
        texts: of each neuron.
    """
    hidden = len(weights) - outputs
    nodes = [Node("input", number) for number in range(inputs)]
    nodes += [Node("hidden", number, texts[number]) for number in range(hidden)]
    nodes += [Node("output", number, texts[hidden + number]) for number in range(outputs)]
    edges = [
        Edge(source, inputs + neuron, weight) for neuron, row in enumerate(weights.tolist()) for source, weight in enumerate(row)
    ]
    return Graph(nodes, edges)
