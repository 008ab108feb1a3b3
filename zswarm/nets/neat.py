"""NEAT's networks, whose structure is evolved too; they decide exactly as those of FREVO do.

Sources: K. O. Stanley, R. Miikkulainen, "Evolving Neural Networks through Augmenting Topologies", Evolutionary Computation
10(2), 2002 (*the paper*), for genomes and operators; FREVO's ``NEAT`` (github.com/smartgrids-aau/Frevo, version 1.5) for
what a network does. ``optimizer`` ``neat`` evolves them as the paper does; every other one that uses a representation's
operators can, too.

A decision repeats ``iterations`` times: each hidden neuron in the order of its genes, in place, then each output. A neuron
adds what its enabled links bring, in the order of theirs, subtracts its bias, and becomes tanh(x) if it is hidden and 1 / (1
+ exp(factor x)) if it is an output: so a negative factor rises. All is float64, as there, and the last values stay for the
next decision. A network whose links all lead forward in that order has its values after the first time already; it is swept
once.

Genome, little-endian: uint32 nodes, uint32 links; per node uint64 id, float64 bias, float64 factor, without the inputs, the
outputs first; per link uint64 source, uint64 target, float64 weight, uint8 enabled. Inputs have the ids 1..I, outputs
I+1..I+O.

Innovation numbers need no shared counter, for they tell what the structure is: that of a link is its source and target; that
of a hidden node is its id, a hash of the link that it was put into and of how often that had happened to it in this genome.
So the same change has the same number in every island and on every machine. Two different hidden nodes have one id with a
probability of 2**-64; crossover then takes them for one. Such numbers have no age, so genes that only one of two genomes has
are not told apart as disjoint and excess: the paper treats both alike in crossover, and gives both one coefficient in its
experiments.

FREVO's flaws, mended: its mutations of weight, bias and factor make a new gene and drop it; a clone shares the list of genes
with its parent, so mutants change their parents; a link can be split twice into two nodes with one id, of which the first
one is alive and the others have no effect. Genomes that have such nodes or the same link twice decide as there; operators
leave the dead out.
"""

import hashlib
import struct
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream
from zswarm.jit import STEP_SIGNATURE, inline, kernel
from zswarm.nets.graph import Edge, Graph, Node
from zswarm.nets.representation import Representation
from zswarm.portable import exp

COUNTS = struct.Struct("<II")
NODE = np.dtype([("id", "<u8"), ("bias", "<f8"), ("factor", "<f8")])
LINK = np.dtype([("source", "<u8"), ("target", "<u8"), ("weight", "<f8"), ("enabled", "u1")])

# A row of parameters: iterations, hidden neurons, neurons, 0; per neuron, hidden ones first, its links, bias and factor; then,
# neuron by neuron, per link its source (inputs, then neurons) and weight.
HEADER, PER_NEURON, PER_LINK = 4, 7, 4

# A float64 is kept as its 64 bits in three float32 numbers, as integers of 20, 22 and 22 bits: float32 holds those exactly.
HIGH, MIDDLE, LOW = np.uint64(44), np.uint64(22), np.uint64((1 << 22) - 1)

Chance = Annotated[float, Meta(ge=0, le=1)]
Innovation = tuple[int, int, int]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[representation]`` with ``kind = "neat"``; the paper's numbers where it has any."""

    recurrent: Annotated[
        bool, Meta(description="links may form circles and start at outputs, so that the network has a memory; else they may not")
    ] = False
    max_hidden: Annotated[int, Meta(ge=0, le=1000, description="hidden neurons at most")] = 32
    iterations: Annotated[int, Meta(ge=1, le=100, description="updates of all neurons in one decision, as FREVO's three")] = 3
    weight_range: Annotated[
        float, Meta(gt=0, le=1e6, description="new weights are uniform in plus or minus this; `severity` scales with it")
    ] = 2.0
    bias_range: Annotated[float, Meta(ge=0, le=1e6, description="the same of biases")] = 2.0
    factor: Annotated[float, Meta(ge=-1e3, le=1e3, description="of a new output's sigmoid")] = -4.9
    factor_range: Annotated[
        float, Meta(ge=0, le=1e3, description="new factors are uniform within this of `factor`; 0: factors never change")
    ] = 0.0
    add_node: Annotated[Chance, Meta(description="chance that a mutation by method 1 puts a node into a link")] = 0.03
    add_link: Annotated[Chance, Meta(description="chance that it adds a link, if no node")] = 0.05
    replace: Annotated[Chance, Meta(description="chance that a number that changes is drawn anew")] = 0.1
    keep_disabled: Annotated[
        Chance, Meta(description="chance that a link of a child is disabled if it is disabled in one of its parents")
    ] = 0.75
    unmatched_coefficient: Annotated[
        float, Meta(ge=0, le=1e6, description="c1 and c2 of the distance: of links that one of two genomes has")
    ] = 1.0
    weight_coefficient: Annotated[
        float, Meta(ge=0, le=1e6, description="c3 of the distance: of the mean difference of the numbers that both have")
    ] = 0.4


@inline
def load_double(array, at):  # type: ignore[no-untyped-def]  # compiled
    """The float64 that three float32 numbers keep."""
    high, middle, low = np.uint64(array[at]), np.uint64(array[at + 1]), np.uint64(array[at + 2])
    return np.uint64((high << HIGH) | (middle << MIDDLE) | low).view(np.float64)


@inline
def store_double(array, at, number):  # type: ignore[no-untyped-def]  # compiled
    """Keep a float64."""
    bits = np.float64(number).view(np.uint64)
    array[at] = np.float32(bits >> HIGH)
    array[at + 1] = np.float32((bits >> MIDDLE) & LOW)
    array[at + 2] = np.float32(bits & LOW)


@inline
def tanh(x):  # type: ignore[no-untyped-def]  # compiled
    """The hyperbolic tangent, float64, as FREVO has it."""
    if x < -20.0:
        return -1.0
    if x > 20.0:
        return 1.0
    e = exp(-2.0 * x)
    return (1.0 - e) / (1.0 + e)


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """One decision; ``state`` keeps each neuron's value, in the order of the parameters."""
    iterations, hidden, neurons = int(parameters[0]), int(parameters[1]), int(parameters[2])
    inputs = observation.shape[0]
    for _ in range(iterations):
        link = HEADER + PER_NEURON * neurons
        for neuron in range(neurons):
            of = HEADER + PER_NEURON * neuron
            total = 0.0
            for _link in range(int(parameters[of])):
                source = int(parameters[link])
                weight = load_double(parameters, link + 1)
                value = np.float64(observation[source]) if source < inputs else load_double(state, 3 * (source - inputs))
                total += value * weight
                link += PER_LINK
            total += -1.0 * load_double(parameters, of + 1)
            if neuron < hidden:
                value = tanh(total)
            else:
                value = 1.0 / (1.0 + exp(load_double(parameters, of + 4) * total))
            store_double(state, 3 * neuron, value)
    for index in range(output.shape[0]):
        output[index] = np.float32(load_double(state, 3 * (hidden + index)))


class Genes(NamedTuple):
    """A genome taken apart."""

    nodes: np.ndarray  # (nodes,) NODE
    links: np.ndarray  # (links,) LINK

    def genome(self) -> bytes:
        """The bytes."""
        return COUNTS.pack(len(self.nodes), len(self.links)) + self.nodes.tobytes() + self.links.tobytes()


class Neat(Representation):
    """Networks whose structure is evolved: NEAT's genomes, FREVO's decisions.

    ``mutate``: ``probability`` is that of each number to change, ``severity`` how far, in ranges. Method 1 may change the
    structure instead, with the chances that the settings give; method 2 changes numbers only. ``crossover`` takes the mother
    as the fitter one.
    """

    settings_type = Settings
    step = staticmethod(step)
    settings: Settings
    genome_bytes = None

    def __init__(self, settings: Settings, inputs: int, outputs: int) -> None:
        super().__init__(settings, inputs, outputs)
        self.state_size = 3 * (settings.max_hidden + outputs)
        self._first_hidden = inputs + outputs + 1  # ids below it are inputs and outputs

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """See ``HEADER``; rows of shorter genomes end in zeros."""
        rows = [self._row(genome) for genome in genomes]
        table = np.zeros((len(rows), max(map(len, rows), default=HEADER)), np.float32)
        for into, row in zip(table, rows, strict=True):
            into[: len(row)] = row
        return table

    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Without hidden neurons, every input linked to every output (the paper, section 3.4)."""
        settings = self.settings
        nodes = np.zeros(self.outputs, NODE)
        nodes["id"] = np.arange(self.inputs + 1, self._first_hidden)
        links = np.zeros(self.inputs * self.outputs, LINK)
        links["source"] = np.tile(np.arange(1, self.inputs + 1), self.outputs)
        links["target"] = np.repeat(nodes["id"], self.inputs)
        links["enabled"] = 1
        genomes = []
        for _ in range(count):
            draws = stream.uniform(-1.0, 1.0, len(links) + 2 * len(nodes))
            links["weight"] = draws[: len(links)] * settings.weight_range
            nodes["bias"] = draws[len(links) : len(links) + len(nodes)] * settings.bias_range
            nodes["factor"] = settings.factor + draws[len(links) + len(nodes) :] * settings.factor_range
            genomes.append(Genes(nodes, links).genome())
        return genomes

    def mutate(
        self, genomes: Sequence[bytes], stream: Stream, *, method: int, severity: float, probability: float
    ) -> list[bytes]:
        """See the class; a mutant has one new node, or one new link, or new numbers (the paper, sections 3.1 and 4.1)."""
        mutants = []
        for genome in genomes:
            genes = self._alive(genome)
            node, link = stream.uniform(0.0, 1.0, 2)
            changed = None
            if method == 1 and node < self.settings.add_node:
                changed = self._add_node(genes, stream)
            if changed is None and method == 1 and link < self.settings.add_link:
                changed = self._add_link(genes, stream)
            mutants.append((changed or self._change_numbers(genes, stream, severity, probability)).genome())
        return mutants

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """The mother's structure; genes that both have come from either (the paper, section 3.2, figure 4)."""
        genes, other = self._alive(mother), self._alive(father)
        theirs = {id_: index for index, id_ in enumerate(other.nodes["id"].tolist())}
        chosen = stream.uniform(0.0, 1.0, len(genes.nodes)) < 0.5
        for index, id_ in enumerate(genes.nodes["id"].tolist()):
            if chosen[index] and id_ in theirs:
                genes.nodes[index] = other.nodes[theirs[id_]]
        theirs = {key: index for index, key in enumerate(_innovations(other.links))}
        chosen, kept = stream.uniform(0.0, 1.0, 2 * len(genes.links)).reshape(2, -1)
        for index, key in enumerate(_innovations(genes.links)):
            if key in theirs:
                link, same = genes.links[index], other.links[theirs[key]]
                if chosen[index] < 0.5:
                    link["weight"] = same["weight"]
                if not (link["enabled"] and same["enabled"]):
                    link["enabled"] = kept[index] >= self.settings.keep_disabled
        return genes.genome()

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """The paper's equation 1: (c1 E + c2 D) / N + c3 W, with c1 = c2 and N = 1.

        E + D are the links that one of two genomes has; W is the mean absolute difference of the numbers that both have: weights,
        biases, and the factors of outputs. N would be the size of the larger genome; the paper allows 1 for small ones, as in
        its experiments, and from one to the other distances would jump.
        """
        sides = [[self._numbers(genome) for genome in side] for side in (left, right)]
        # In an order of its own, so that a sum does not depend on which other genomes there are.
        columns = {key: column for column, key in enumerate(sorted({key for side in sides for of in side for key in of}))}
        (a, in_a), (b, in_b) = (_tables(side, columns) for side in sides)
        is_link = np.array([key[0] > 0 for key in columns], bool)[:, None]
        links_a, links_b = (np.add.reduce(there & is_link, axis=0, dtype=np.int64) for there in (in_a, in_b))
        found = np.empty((len(left), len(right)))
        for row in range(len(left)):
            both = in_a[:, row, None] & in_b
            # Along its first axis numpy adds one row after the other; ``_tables`` has two columns at least.
            total = np.add.reduce(np.where(both, np.abs(a[:, row, None] - b), 0.0), axis=0)
            matched = np.add.reduce(both, axis=0, dtype=np.int64)
            unmatched = links_a[row] + links_b - 2 * np.add.reduce(both & is_link, axis=0, dtype=np.int64)
            mean = total / np.maximum(matched, 1)
            distance = self.settings.unmatched_coefficient * unmatched + self.settings.weight_coefficient * mean
            found[row] = distance[: len(right)]
        return found

    def structure(self, genome: bytes) -> tuple[int, int]:
        """How many hidden neurons and how many enabled links."""
        genes = self._alive(genome)
        return len(genes.nodes) - self.outputs, int(np.count_nonzero(genes.links["enabled"]))

    # ---- genomes --------------------------------------------------------------------------------------------------

    def graph(self, genome: bytes) -> Graph:
        """See ``Representation``; without links that are disabled."""
        self.parameters([genome])  # refuses what is no network
        genes = self._alive(genome)
        order = [*genes.nodes[self.outputs :].tolist(), *genes.nodes[: self.outputs].tolist()]
        nodes = [Node("input", number) for number in range(self.inputs)]
        place = {id_: id_ - 1 for id_ in range(1, self.inputs + 1)}
        hidden = len(order) - self.outputs
        for number, (id_, bias, factor) in enumerate(order):
            place[id_] = len(nodes)
            if number < hidden:
                nodes.append(Node("hidden", number, f"bias {bias:.4g}"))
            else:
                nodes.append(Node("output", number - hidden, f"bias {bias:.4g}, factor {factor:.4g}"))
        links = genes.links[genes.links["enabled"] == 1]
        return Graph(nodes, [Edge(place[source], place[target], weight) for source, target, weight, _ in links.tolist()])

    def _alive(self, genome: bytes) -> Genes:
        """A copy to change; of nodes with one id, the first."""
        genes = _taken_apart(genome)
        return Genes(_firsts(genes.nodes).copy(), genes.links.copy())

    def _row(self, genome: bytes) -> np.ndarray:
        nodes, links = _taken_apart(genome)
        if not (np.isfinite(nodes["bias"]) & np.isfinite(nodes["factor"])).all() or not np.isfinite(links["weight"]).all():
            raise ValueError("a genome holds a number that is not finite")
        if (links["enabled"] > 1).any():
            raise ValueError("a genome has a link that is neither enabled (1) nor disabled (0)")
        nodes = self._checked_nodes(nodes)
        hidden = len(nodes) - self.outputs
        order = np.concatenate([np.arange(self.outputs, len(nodes)), np.arange(self.outputs)])  # outputs last
        nodes = nodes[order]
        place = {id_: self.inputs + index for index, id_ in enumerate(nodes["id"].tolist())}
        place |= {id_: id_ - 1 for id_ in range(1, self.inputs + 1)}
        try:
            sources = np.array([place[id_] for id_ in links["source"].tolist()], np.int64)
            targets = np.array([place[id_] for id_ in links["target"].tolist()], np.int64) - self.inputs
        except KeyError as error:
            raise ValueError(f"a genome has a link of node {error}, which it does not have") from None
        if (targets < 0).any():
            raise ValueError("a genome has a link that ends at an input")
        forward = sources - self.inputs < targets
        if not self.settings.recurrent:
            if (sources - self.inputs >= hidden).any():
                raise ValueError("a genome has a link that starts at an output; that takes recurrent = true")
            if not forward.all() and _sorted(range(hidden), _pairs(sources - self.inputs, targets, hidden)) is None:
                raise ValueError("a genome has links in a circle; that takes recurrent = true")
        enabled = links["enabled"] == 1
        once = forward[enabled].all()
        sources, targets, weights = sources[enabled], targets[enabled], links["weight"][enabled]
        by_target = np.argsort(targets, kind="stable")
        table = np.empty((len(nodes), PER_NEURON), np.float32)
        table[:, 0] = np.bincount(targets, minlength=len(nodes))
        table[:, 1:4], table[:, 4:] = _words(nodes["bias"]), _words(nodes["factor"])
        arriving = np.empty((len(sources), PER_LINK), np.float32)
        arriving[:, 0], arriving[:, 1:] = sources[by_target], _words(weights[by_target])
        header = np.array([1 if once else self.settings.iterations, hidden, len(nodes), 0], np.float32)
        return np.concatenate([header, table.ravel(), arriving.ravel()])

    def _checked_nodes(self, nodes: np.ndarray) -> np.ndarray:
        """Those that are alive."""
        ids = nodes["id"].tolist()
        outputs = list(range(self.inputs + 1, self._first_hidden))
        if ids[: self.outputs] != outputs:
            raise ValueError(f"a genome's nodes must begin with the outputs, {outputs[0]} to {outputs[-1]}")
        if not self.inputs < min(ids):
            raise ValueError("a genome has a gene for an input")
        alive = _firsts(nodes)
        if len(alive) - self.outputs > self.settings.max_hidden:
            raise ValueError(f"a genome has {len(alive) - self.outputs} hidden neurons; max_hidden is {self.settings.max_hidden}")
        return alive

    def _numbers(self, genome: bytes) -> dict[Innovation, float]:
        """By what they are: (source, target, which of equal links), (0, node, 0) for a bias, (0, output, 1) for its factor."""
        genes = self._alive(genome)
        numbers = {
            (source, target, which): weight
            for (source, target, which), weight in zip(_innovations(genes.links), genes.links["weight"].tolist(), strict=True)
        }
        for id_, bias, factor in genes.nodes.tolist():
            numbers[0, id_, 0] = bias
            if id_ < self._first_hidden:
                numbers[0, id_, 1] = factor
        return numbers

    # ---- mutations ------------------------------------------------------------------------------------------------

    def _change_numbers(self, genes: Genes, stream: Stream, severity: float, probability: float) -> Genes:
        """Each number with the given probability: moved by up to severity times its range, or drawn anew."""
        settings, (nodes, links) = self.settings, genes
        factors = self.outputs if settings.factor_range else 0
        old = np.concatenate([links["weight"], nodes["bias"], nodes["factor"][:factors]])
        ranges = np.repeat([settings.weight_range, settings.bias_range, settings.factor_range], [len(links), len(nodes), factors])
        middle = np.where(np.arange(len(old)) < len(links) + len(nodes), 0.0, settings.factor)
        hit, anew, draws = stream.uniform(0.0, 1.0, 3 * len(old)).reshape(3, -1)
        draws = (2.0 * draws - 1.0) * ranges
        new = np.where(anew < settings.replace, middle + draws, old + severity * draws)
        new = np.where(hit < probability, new, old)
        links["weight"] = new[: len(links)]
        nodes["bias"] = new[len(links) : len(links) + len(nodes)]
        nodes["factor"][:factors] = new[len(links) + len(nodes) :]
        return genes

    def _add_node(self, genes: Genes, stream: Stream) -> Genes | None:
        """A node in an enabled link, which is disabled: 1 into it, the old weight out of it (the paper, section 3.1)."""
        enabled = np.flatnonzero(genes.links["enabled"])
        if not len(enabled) or len(genes.nodes) - self.outputs >= self.settings.max_hidden:
            return None
        link = genes.links[enabled[stream.integer(len(enabled))]]
        link["enabled"] = 0
        source, target, weight, _ = link.tolist()
        ids = genes.nodes["id"].tolist()
        id_ = self._new_id(source, target, ids)
        at = ids.index(target) if target >= self._first_hidden else len(ids)  # before its target, so that links lead forward
        nodes = np.insert(genes.nodes, at, np.array((id_, 0.0, 0.0), NODE))
        links = np.array([(source, id_, 1.0, 1), (id_, target, weight, 1)], LINK)
        return Genes(nodes, np.concatenate([genes.links, links]))

    def _new_id(self, source: int, target: int, ids: list[int]) -> int:
        for times in range(len(ids) + 1):
            digest = hashlib.blake2b(struct.pack("<QQQ", source, target, times), digest_size=8).digest()
            id_ = int.from_bytes(digest, "little")
            if id_ >= self._first_hidden and id_ not in ids:
                return id_
        raise RuntimeError("no free id for a node")  # pragma: no cover  a hash that gives known ids only

    def _add_link(self, genes: Genes, stream: Stream) -> Genes | None:
        """A link between two nodes that have none (the paper, section 3.1); without circles unless the network is recurrent."""
        ids = genes.nodes["id"].tolist()
        hidden, outputs = ids[self.outputs :], ids[: self.outputs]
        there = set(zip(genes.links["source"].tolist(), genes.links["target"].tolist(), strict=True))
        sources = [*range(1, self.inputs + 1), *hidden, *(outputs if self.settings.recurrent else [])]
        reached = {} if self.settings.recurrent else _reached(hidden, there)
        free = [
            (source, target)
            for source in sources
            for target in [*hidden, *outputs]
            if (source, target) not in there and (self.settings.recurrent or source not in reached.get(target, ()))
        ]
        if not free:
            return None
        source, target = free[stream.integer(len(free))]
        weight = float(stream.uniform(-1.0, 1.0, 1)[0]) * self.settings.weight_range
        links = np.concatenate([genes.links, np.array([(source, target, weight, 1)], LINK)])
        if self.settings.recurrent:
            return Genes(genes.nodes, links)
        order = _sorted(hidden, [(a, b) for a, b in [*there, (source, target)] if a in hidden and b in hidden])
        assert order is not None  # noqa: S101  such links are not free
        index = {id_: place for place, id_ in enumerate(ids)}
        return Genes(genes.nodes[[index[id_] for id_ in [*outputs, *order]]], links)


def _taken_apart(genome: bytes) -> Genes:
    if len(genome) < COUNTS.size:
        raise ValueError(f"a genome has {len(genome)} bytes; it begins with two counts, which take {COUNTS.size}")
    nodes, links = COUNTS.unpack_from(genome)
    behind = COUNTS.size + nodes * NODE.itemsize
    if nodes == 0 or len(genome) != behind + links * LINK.itemsize:
        raise ValueError(f"a genome has {len(genome)} bytes, which are not {nodes} nodes and {links} links")
    return Genes(np.frombuffer(genome, NODE, nodes, COUNTS.size), np.frombuffer(genome, LINK, links, behind))


def _firsts(nodes: np.ndarray) -> np.ndarray:
    """Of nodes with one id, the first."""
    ids = nodes["id"].tolist()
    if len(set(ids)) == len(ids):
        return nodes
    return nodes[[index for index, id_ in enumerate(ids) if id_ not in ids[:index]]]


def _innovations(links: np.ndarray) -> list[Innovation]:
    """What a link is: source, target, and which of equal ones, for genomes of FREVO may have the same link twice."""
    seen: dict[tuple[int, int], int] = {}
    found = []
    for pair in zip(links["source"].tolist(), links["target"].tolist(), strict=True):
        which = seen.get(pair, 0)
        seen[pair] = which + 1
        found.append((*pair, which))
    return found


def _tables(side: list[dict[Innovation, float]], columns: dict[Innovation, int]) -> tuple[np.ndarray, np.ndarray]:
    """(columns, genomes) float64 numbers, and bool where a genome has them; two genomes at least."""
    numbers = np.zeros((len(columns), max(2, len(side))))
    there = np.zeros(numbers.shape, bool)
    for genome, of in enumerate(side):
        places = [columns[key] for key in of]
        numbers[places, genome], there[places, genome] = list(of.values()), True
    return numbers, there


def _words(numbers: np.ndarray) -> np.ndarray:
    """(n, 3) float32, as ``load_double`` reads them."""
    bits = np.ascontiguousarray(numbers, "<f8").view(np.uint64)
    return np.stack([bits >> HIGH, (bits >> MIDDLE) & LOW, bits & LOW], axis=1).astype(np.float32)


def _pairs(sources: np.ndarray, targets: np.ndarray, hidden: int) -> list[tuple[int, int]]:
    """Links from hidden neuron to hidden neuron."""
    return [(a, b) for a, b in zip(sources.tolist(), targets.tolist(), strict=True) if 0 <= a < hidden and b < hidden]


def _sorted(nodes: Sequence[int], pairs: list[tuple[int, int]]) -> list[int] | None:
    """The nodes so that all pairs lead forward, otherwise as they are; None where pairs form a circle."""
    sources: dict[int, set[int]] = {node: set() for node in nodes}
    for source, target in pairs:
        sources[target].add(source)
    order: list[int] = []
    while sources:
        node = next((node for node, of in sources.items() if not of), None)
        if node is None:
            return None
        order.append(node)
        del sources[node]
        for of in sources.values():
            of.discard(node)
    return order


def _reached(hidden: list[int], pairs: set[tuple[int, int]]) -> dict[int, set[int]]:
    """Per hidden node those that links lead to from it, itself included."""
    following: dict[int, list[int]] = {node: [] for node in hidden}
    for source, target in pairs:
        if source in following and target in following:
            following[source].append(target)
    reached = {}
    for start in hidden:
        found, waiting = {start}, [start]
        while waiting:
            for node in following[waiting.pop()]:
                if node not in found:
                    found.add(node)
                    waiting.append(node)
        reached[start] = found
    return reached
