"""NEAT's genome files, which ARGoS3-NEAT reads and writes; EvoStick's have no hidden nodes.

A file has a line for each node, with its type and place, and for each gene, a link. Numbers of
nodes are the file's own. Inputs and bias are in the order in which the controller sets them.
"""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.nets.neat_genome import LINK, NODE, Genes
from zswarm.system.text import clean

SLOPE = 4.924273  # of the sigmoid of NEAT 1.2.1
SENSOR, NEURON = 1, 0  # types of nodes
HIDDEN, INPUT, OUTPUT, BIAS = range(4)  # places of nodes
KINDS = {(SENSOR, INPUT), (SENSOR, BIAS), (NEURON, HIDDEN), (NEURON, OUTPUT)}
MODELS = {14: "1.2", 24: "1.1"}  # by inputs without the bias
OUTPUTS = 2
MOST_NODES, MOST_GENES = 1_000, 100_000
LARGEST_ID = 2**31 - 1  # NEAT reads them as C integers
NODE_FIELDS, GENE_FIELDS = 4, 8
EVOLVED = {"weight_range": 5.0, "bias_range": 5.0}


class Gene(NamedTuple):
    """A link between two nodes."""

    source: int
    target: int
    weight: float
    enabled: bool


class Network(NamedTuple):
    """A network: its nodes by their numbers in the file, and its genes."""

    inputs: list[int]
    bias: int
    outputs: list[int]
    hidden: list[int]
    genes: list[Gene]


class Built(NamedTuple):
    """A network as zswarm has it."""

    representation: dict[str, Any]
    genome: bytes


# ---- reading


def read(text: str) -> Network:
    """Return the network of a file.

    Raises:
        ConfigError: it is not a genome of an e-puck's network, or names nodes it does not define.
    """
    places: dict[int, int] = {}
    genes: list[Gene] = []
    for line, (word, *fields) in _lines(text):
        if word == "node":
            number, _, kind, place = _integers(fields, NODE_FIELDS, line)
            if number in places:
                raise _error(line, f"node {number} is defined twice")
            if (kind, place) not in KINDS:
                raise _error(
                    line,
                    f"node {number} has the type {kind} and the place {place}; expected 1 1 "
                    "(input), 1 3 (bias), 0 0 (hidden) or 0 2 (output)",
                )
            places[number] = place
        elif word == "gene":
            genes.append(_gene(fields, places, line))
        elif word not in ("genomestart", "genomeend", "trait"):
            raise _error(line, f"expected node, gene or trait, not {clean(word)!r}")
        if len(places) > MOST_NODES or len(genes) > MOST_GENES:
            raise _error(line, f"more than {MOST_NODES} nodes or {MOST_GENES} genes")
    return _network(places, genes)


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the words of each line of the genome."""
    started = ended = False
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0] == "/*":
            continue
        if words[0] == "genomestart":
            if started:
                raise _error(number, "a second genome begins; expected one")
            started = True
        if not started or ended:
            raise _error(number, f"expected genomestart, not {clean(words[0])!r}")
        ended = words[0] == "genomeend"
        yield number, words
    if not ended:
        raise ConfigError("damaged: expected genomestart, nodes, genes and genomeend")


def _gene(fields: list[str], places: dict[int, int], line: int) -> Gene:
    if len(fields) != GENE_FIELDS:
        raise _error(line, f"expected {GENE_FIELDS} numbers behind gene")
    _, source, target = _integers(fields[:3], 3, line)
    for node in (source, target):
        if node not in places:
            raise _error(
                line, f"a gene links node {node}, which the genome does not define"
            )
    if places[target] in (INPUT, BIAS):
        raise _error(line, f"a gene ends at node {target}, which is an input")
    try:
        weight = float(fields[3])
    except ValueError:
        weight = math.nan
    if not abs(weight) <= 1e6:
        raise _error(line, f"expected a weight, not {clean(fields[3])!r}")
    if fields[-1] not in ("0", "1"):
        raise _error(
            line,
            f"expected 0 or 1 at the end: whether it is enabled, not {clean(fields[-1])!r}",
        )
    return Gene(source, target, weight, fields[-1] == "1")


def _integers(fields: list[str], count: int, line: int) -> list[int]:
    if len(fields) != count or not all(field.isdecimal() for field in fields):
        raise _error(line, f"expected {count} whole numbers")
    numbers = [int(field) for field in fields if len(field) < 11]
    if len(numbers) < count or max(numbers) > LARGEST_ID:
        raise _error(line, f"expected numbers up to {LARGEST_ID}")
    return numbers


def _network(places: dict[int, int], genes: list[Gene]) -> Network:
    """Check that a network is one of an e-puck."""
    of = [
        [node for node, place in places.items() if place == each]
        for each in (INPUT, BIAS, OUTPUT, HIDDEN)
    ]
    inputs, biases, outputs, hidden = of
    fits = len(inputs) in MODELS and (len(biases), len(outputs)) == (1, OUTPUTS)
    sensors = [node for node, place in places.items() if place in (INPUT, BIAS)]
    if not fits or sensors != inputs + biases:
        raise ConfigError(
            f"its network has {len(inputs)} inputs, {len(biases)} bias and {len(outputs)} outputs; "
            "expected 14 inputs (reference model 1.2) or 24 (1.1), then a bias, and 2 outputs"
        )
    return Network(inputs, biases[0], outputs, hidden, genes)


def _error(line: int, text: str) -> ConfigError:
    return ConfigError(f"line {line}: {text}")


# ---- as a network of zswarm


def build(network: Network) -> Built:
    """Return a network as a representation and its genome.

    It is ``feed-forward`` if it has neither hidden nodes nor links between outputs, else ``neat``.
    """
    pairs = Counter((gene.source, gene.target) for gene in network.genes)
    between = any(gene.source in network.outputs for gene in network.genes)
    if network.hidden or between or max(pairs.values(), default=0) > 1:
        return _neat(network)
    sensors = [*network.inputs, network.bias]
    weights = np.zeros((OUTPUTS, len(sensors)), "<f4")
    for source, target, weight, enabled in network.genes:
        row = network.outputs.index(target)
        weights[row, sensors.index(source)] = weight if enabled else 0.0
    settings = {"hidden": [], "steepness": SLOPE, "limited": True, **EVOLVED}
    return Built({"kind": "feed-forward", **settings}, weights.tobytes())


def _neat(network: Network) -> Built:
    first = len(network.inputs) + 1
    neurons = [*network.outputs, *network.hidden]
    # Hidden nodes keep their numbers if these are above those of inputs and outputs.
    kept = min(network.hidden, default=first + OUTPUTS) >= first + OUTPUTS
    hidden = network.hidden if kept else range(first + OUTPUTS, first + len(neurons))
    ids = dict(zip(network.inputs, range(1, first), strict=True))
    ids |= zip(neurons, [*range(first, first + OUTPUTS), *hidden], strict=True)
    nodes = np.zeros(len(neurons), NODE)
    nodes["id"] = [ids[node] for node in neurons]
    nodes["factor"] = -SLOPE
    links = []
    for source, target, weight, enabled in network.genes:
        if source != network.bias:
            links.append((ids[source], ids[target], weight, enabled))
        elif enabled:
            nodes["bias"][neurons.index(target)] -= weight
    genome = Genes(nodes, np.array(links, LINK)).genome()
    settings = {
        "synchronous": True,
        "recurrent": True,
        "factor": -SLOPE,
        "max_hidden": max(32, len(network.hidden)),
    }
    return Built({"kind": "neat", **settings, **EVOLVED}, genome)
