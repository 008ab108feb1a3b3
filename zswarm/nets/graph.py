"""A network as a drawing: nodes and edges."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

Kind = Literal["input", "hidden", "output", "state"]


class Node(NamedTuple):
    """An input, a neuron, or a state of a machine.

    Attributes:
        number: index among the nodes of its kind.
        text: more about it, such as its bias.
        part: number of its network, if a genome holds several.
    """

    kind: Kind
    number: int
    text: str = ""
    part: int = 0


class Edge(NamedTuple):
    """A connection between two nodes, or a transition.

    Attributes:
        source, target: indices into the list of nodes.
        weight: of a transition, the share of the state's inputs that take it.
        text: more about it.
    """

    source: int
    target: int
    weight: float
    text: str = ""


class Graph(NamedTuple):
    """Nodes, inputs first and outputs last, and the edges between them."""

    nodes: list[Node]
    edges: list[Edge]


def numbered(inputs: int, hidden: Sequence[str], outputs: Sequence[str]) -> list[Node]:
    """Return the nodes of a network: inputs, and neurons with these texts."""
    kinds: dict[Kind, Sequence[str]] = {
        "input": [""] * inputs,
        "hidden": hidden,
        "output": outputs,
    }
    return [
        Node(kind, *node) for kind, texts in kinds.items() for node in enumerate(texts)
    ]


def of_layers(inputs: int, tables: Sequence[np.ndarray]) -> Graph:
    """Return the graph of a layered network.

    Args:
        inputs: numbers that the network observes.
        tables: per layer (neurons, nodes of the previous layer + 1): weights, then the bias.
    """
    texts, edges, previous, target = [], [], 0, inputs
    for table in tables:
        layer = target
        for *weights, bias in table.tolist():
            texts.append(f"bias {bias:.4g}")
            edges += [
                Edge(source, target, weight)
                for source, weight in enumerate(weights, previous)
            ]
            target += 1
        previous = layer
    hidden = previous - inputs
    return Graph(numbered(inputs, texts[:hidden], texts[hidden:]), edges)


def of_meshed(
    inputs: int, outputs: int, weights: np.ndarray, texts: Sequence[str]
) -> Graph:
    """Return the graph of a network whose neurons are connected to all inputs and neurons.

    Args:
        inputs: numbers that the network observes.
        outputs: numbers that the network sets.
        weights: (neurons, inputs + neurons); the outputs are the last neurons.
        texts: one per neuron.
    """
    hidden = len(weights) - outputs
    edges = [
        Edge(source, target, weight)
        for target, row in enumerate(weights.tolist(), inputs)
        for source, weight in enumerate(row)
    ]
    return Graph(numbered(inputs, texts[:hidden], texts[hidden:]), edges)
