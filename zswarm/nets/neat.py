"""NEAT's networks, whose structure evolves, too. They decide exactly as those of FREVO.

Sources: K. O. Stanley, R. Miikkulainen, "Evolving Neural Networks through Augmenting Topologies",
Evolutionary Computation 10(2), 2002 (*the paper*), for genomes and operators; ``NEAT`` of FREVO 1.5
(github.com/smartgrids-aau/Frevo) for decisions. Details, and what differs from FREVO:
docs/representations.md. A network whose links all lead forward has its values after one sweep.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, within
from zswarm.kernels.random import Stream
from zswarm.nets.graph import Edge, Graph, numbered
from zswarm.nets.neat_distance import Numbers, distances
from zswarm.nets.neat_genome import (
    LINK,
    NODE,
    Genes,
    first_of_each_id,
    new_id,
    reachable,
    sorted_forward,
)
from zswarm.nets.neat_kernel import HEADER, PER_LINK, PER_NEURON, step, words
from zswarm.nets.representation import Representation, stacked
from zswarm.nets.vector import Iterations, WeightRange

Chance = Annotated[float, Meta(ge=0, le=1)]
Coefficient = Annotated[float, Meta(ge=0, le=1e6)]


class NeatNetworkSettings(PartSettings, frozen=True):
    """Settings of ``[representation]`` with ``kind = "neat"``; the paper's numbers where given."""

    recurrent: Annotated[
        bool, about("links may form cycles and start at outputs: a memory")
    ] = False
    max_hidden: Annotated[int, within(0, 1000, "maximum of hidden neurons")] = 32
    iterations: Annotated[
        Iterations, about("updates of all neurons in a decision; 3 in FREVO")
    ] = 3
    weight_range: Annotated[
        WeightRange, about("new weights are uniform in ± this; `severity` scales with it")
    ] = 2.0
    bias_range: Annotated[Coefficient, about("the same for biases")] = 2.0
    factor: Annotated[float, within(-1e3, 1e3, "factor of a new output's sigmoid")] = -4.9
    factor_range: Annotated[
        float, within(0, 1e3, "deviation of new factors from `factor`")
    ] = 0.0
    add_node: Annotated[
        Chance, about("chance that mutation method 1 splits a link by a node")
    ] = 0.03
    add_link: Annotated[Chance, about("chance to add a link if no node is added")] = 0.05
    replace: Annotated[Chance, about("chance to redraw a number that changes")] = 0.1
    keep_disabled: Annotated[
        Chance, about("chance to keep a link disabled in one parent")
    ] = 0.75
    unmatched_coefficient: Annotated[
        Coefficient, about("c1 and c2 of the distance: links that only one genome has")
    ] = 1.0
    weight_coefficient: Annotated[
        Coefficient, about("c3 of the distance: mean difference of numbers")
    ] = 0.4
    synchronous: Annotated[
        bool, about("NEAT 1.2.1's decisions: all neurons at once, hidden ones sigmoid")
    ] = False


class Neat(Representation):
    """Networks whose structure evolves: NEAT's genomes, FREVO's decisions.

    ``mutate``: ``probability`` is that of each number to change, ``severity`` how far, in ranges.
    Method 1 may change the structure instead, with the chances of the settings; method 2 changes
    numbers only. ``crossover`` takes the mother as the fitter parent.
    """

    settings_type = NeatNetworkSettings
    step = staticmethod(step)
    settings: NeatNetworkSettings
    genome_bytes = None

    def __init__(self, settings: NeatNetworkSettings, inputs: int, outputs: int) -> None:
        super().__init__(settings, inputs, outputs)
        self.state_size = 3 * (settings.max_hidden + outputs)
        if settings.synchronous:  # old values, then new ones
            self.state_size *= 2
        self._first_hidden = inputs + outputs + 1  # ids below it are inputs and outputs

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return rows as described at ``HEADER``; rows of shorter genomes end in zeros."""
        return stacked([self._row(genome) for genome in genomes], HEADER)

    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Return networks of links from all inputs to all outputs (section 3.4)."""
        settings = self.settings
        nodes = np.zeros(self.outputs, NODE)
        nodes["id"] = np.arange(self.inputs + 1, self._first_hidden)
        links = np.zeros(self.inputs * self.outputs, LINK)
        links["source"] = np.tile(np.arange(1, self.inputs + 1), self.outputs)
        links["target"] = np.repeat(nodes["id"], self.inputs)
        links["enabled"] = 1
        ends = np.add.accumulate([len(links), len(nodes)])
        genomes = []
        for _ in range(count):
            draws = stream.uniform(-1.0, 1.0, len(links) + 2 * len(nodes))
            weights, biases, factors = np.split(draws, ends)
            links["weight"] = weights * settings.weight_range
            nodes["bias"] = biases * settings.bias_range
            nodes["factor"] = settings.factor + factors * settings.factor_range
            genomes.append(Genes(nodes, links).genome())
        return genomes

    def mutate(
        self,
        genomes: Sequence[bytes],
        stream: Stream,
        *,
        method: int,
        severity: float,
        probability: float,
    ) -> list[bytes]:
        """Return mutants with one new node, one new link, or new numbers (sections 3.1 and 4.1)."""
        mutants = []
        for genome in genomes:
            genes = Genes.copied(genome)
            node, link = stream.uniform(0.0, 1.0, 2)
            changed = None
            if method == 1 and node < self.settings.add_node:
                changed = self._add_node(genes, stream)
            if changed is None and method == 1 and link < self.settings.add_link:
                changed = self._add_link(genes, stream)
            if changed is None:
                self._change_numbers(genes, stream, severity, probability)
            mutants.append((changed or genes).genome())
        return mutants

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """Return the mother's structure with shared genes of either (section 3.2, figure 4)."""
        hers, his = Genes.copied(mother), Genes.copied(father)
        found = {id_: index for index, id_ in enumerate(his.nodes["id"].tolist())}
        chosen = stream.uniform(0.0, 1.0, len(hers.nodes)) < 0.5
        for index, id_ in enumerate(hers.nodes["id"].tolist()):
            if chosen[index] and id_ in found:
                hers.nodes[index] = his.nodes[found[id_]]
        matching = {key: index for index, key in enumerate(his.innovations())}
        chosen, draws = stream.uniform(0.0, 1.0, 2 * len(hers.links)).reshape(2, -1)
        for index, key in enumerate(hers.innovations()):
            if key in matching:
                link, other = hers.links[index], his.links[matching[key]]
                if chosen[index] < 0.5:
                    link["weight"] = other["weight"]
                if not (link["enabled"] and other["enabled"]):
                    link["enabled"] = draws[index] >= self.settings.keep_disabled
        return hers.genome()

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Return the distances of the paper's equation 1: weights, biases and factors count."""
        a, b = ([self._numbers(genome) for genome in side] for side in (left, right))
        settings = self.settings
        return distances(
            a, b, settings.unmatched_coefficient, settings.weight_coefficient
        )

    def structure(self, genome: bytes) -> tuple[int, int]:
        """Count hidden neurons and enabled links."""
        genes = Genes.copied(genome)
        return len(genes.nodes) - self.outputs, int(
            np.count_nonzero(genes.links["enabled"])
        )

    def graph(self, genome: bytes) -> Graph:
        """Return the network without disabled links."""
        self.parameters([genome])  # checks the genome
        genes = Genes.copied(genome)
        outputs, hidden = np.split(genes.nodes, [self.outputs])
        nodes = numbered(
            self.inputs,
            [f"bias {bias:.4g}" for _, bias, _ in hidden.tolist()],
            [
                f"bias {bias:.4g}, factor {factor:.4g}"
                for _, bias, factor in outputs.tolist()
            ],
        )
        index = self._indices(np.concatenate([hidden, outputs]))
        links = genes.links[genes.links["enabled"] == 1].tolist()
        edges = [
            Edge(index[source], index[target], weight)
            for source, target, weight, _ in links
        ]
        return Graph(nodes, edges)

    # ---- genomes

    def _indices(self, nodes: np.ndarray) -> dict[int, int]:
        """Return the index of each id among inputs and these nodes."""
        ids = [*range(1, self.inputs + 1), *nodes["id"].tolist()]
        return {id_: index for index, id_ in enumerate(ids)}

    def _row(self, genome: bytes) -> np.ndarray:
        nodes, links = Genes.decode(genome)
        numbers = np.concatenate([nodes["bias"], nodes["factor"], links["weight"]])
        if not np.isfinite(numbers).all():
            raise ValueError("a genome holds a number that is not finite")
        if (links["enabled"] > 1).any():
            raise ValueError(
                "a genome has a link that is neither enabled (1) nor disabled (0)"
            )
        nodes = self._checked_nodes(nodes)
        hidden = len(nodes) - self.outputs
        # Outputs last.
        nodes = nodes[[*range(self.outputs, len(nodes)), *range(self.outputs)]]
        sources, targets = self._ends(links, nodes)
        self._check_recurrence(sources, targets, hidden)
        enabled = links["enabled"] == 1
        sources = sources[enabled]
        targets = targets[enabled]
        weights = links["weight"][enabled]
        sweeps = (
            1 if (sources - self.inputs < targets).all() else self.settings.iterations
        )
        if self.settings.synchronous:
            sweeps = 0
        by_target = np.argsort(targets, kind="stable")
        table = np.empty((len(nodes), PER_NEURON), np.float32)
        table[:, 0] = np.bincount(targets, minlength=len(nodes))
        table[:, 1:4], table[:, 4:] = words(nodes["bias"]), words(nodes["factor"])
        arriving = np.empty((len(sources), PER_LINK), np.float32)
        arriving[:, 0], arriving[:, 1:] = sources[by_target], words(weights[by_target])
        header = np.array([sweeps, hidden, len(nodes), 0], np.float32)
        return np.concatenate([header, table.ravel(), arriving.ravel()])

    def _checked_nodes(self, nodes: np.ndarray) -> np.ndarray:
        """Return the first node of each id."""
        ids = nodes["id"].tolist()
        first, end, most = self.inputs + 1, self._first_hidden, self.settings.max_hidden
        if ids[: self.outputs] != list(range(first, end)):
            raise ValueError(
                f"a genome's nodes must begin with the outputs, {first} to {end - 1}"
            )
        if min(ids) < first:
            raise ValueError("a genome has a gene for an input")
        unique = first_of_each_id(nodes)
        hidden = len(unique) - self.outputs
        if hidden > most:
            raise ValueError(
                f"a genome has {hidden} hidden neurons; max_hidden is {most}"
            )
        return unique

    def _ends(
        self, links: np.ndarray, nodes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return per link its source, counted from the inputs, and its target, from the neurons."""
        index = self._indices(nodes)
        try:
            sources = np.array([index[id_] for id_ in links["source"].tolist()], int)
            targets = np.array([index[id_] for id_ in links["target"].tolist()], int)
        except KeyError as error:
            raise ValueError(
                f"a genome has a link of node {error}, which is missing"
            ) from None
        targets -= self.inputs
        if (targets < 0).any():
            raise ValueError("a genome has a link that ends at an input")
        return sources, targets

    def _check_recurrence(
        self, sources: np.ndarray, targets: np.ndarray, hidden: int
    ) -> None:
        """Refuse links from outputs and circles unless they are allowed."""
        if self.settings.recurrent:
            return
        neurons = sources - self.inputs
        allow = "that takes recurrent = true"
        if (neurons >= hidden).any():
            raise ValueError(f"a genome has a link that starts at an output; {allow}")
        if (neurons < targets).all():
            return
        pairs = zip(neurons.tolist(), targets.tolist(), strict=True)
        if sorted_forward(range(hidden), pairs) is None:
            raise ValueError(f"a genome has links in a circle; {allow}")

    def _numbers(self, genome: bytes) -> Numbers:
        """Return all numbers of a genome, as ``distances`` compares them."""
        genes = Genes.copied(genome)
        weights = genes.links["weight"].tolist()
        numbers = dict(zip(genes.innovations(), weights, strict=True))
        for id_, bias, factor in genes.nodes.tolist():
            numbers[0, id_, 0] = bias
            if id_ < self._first_hidden:
                numbers[0, id_, 1] = factor
        return numbers

    # ---- mutations

    def _change_numbers(
        self, genes: Genes, stream: Stream, severity: float, probability: float
    ) -> None:
        """Move numbers by up to severity times their range, or redraw them."""
        settings, (nodes, links) = self.settings, genes
        factors = nodes["factor"][: self.outputs if settings.factor_range else 0]
        groups = (links["weight"], nodes["bias"], factors)
        ranges = settings.weight_range, settings.bias_range, settings.factor_range
        middles = 0.0, 0.0, settings.factor
        ends = np.add.accumulate([len(group) for group in groups])
        chances = np.split(
            stream.uniform(0.0, 1.0, 3 * ends[-1]).reshape(3, -1), ends[:-1], axis=1
        )
        for old, reach, middle, drawn in zip(
            groups, ranges, middles, chances, strict=True
        ):
            hit, redraw, draws = drawn
            steps = (2.0 * draws - 1.0) * reach
            new = np.where(
                redraw < settings.replace, middle + steps, old + severity * steps
            )
            old[:] = np.where(hit < probability, new, old)

    def _add_node(self, genes: Genes, stream: Stream) -> Genes | None:
        """Split an enabled link: weight 1 into the node, the old weight out of it (section 3.1)."""
        enabled = np.flatnonzero(genes.links["enabled"])
        if (
            not len(enabled)
            or len(genes.nodes) - self.outputs >= self.settings.max_hidden
        ):
            return None
        link = genes.links[enabled[stream.integer(len(enabled))]]
        link["enabled"] = 0
        source, target, weight, _ = link.tolist()
        ids = genes.nodes["id"].tolist()
        id_ = new_id(source, target, self._first_hidden, ids)
        # Before its target, so that links lead forward.
        at = ids.index(target) if target >= self._first_hidden else len(ids)
        factor = self.settings.factor if self.settings.synchronous else 0.0
        nodes = np.insert(genes.nodes, at, np.array((id_, 0.0, factor), NODE))
        links = np.array([(source, id_, 1.0, 1), (id_, target, weight, 1)], LINK)
        return Genes(nodes, np.concatenate([genes.links, links]))

    def _add_link(self, genes: Genes, stream: Stream) -> Genes | None:
        """Link two nodes (section 3.1), without a circle unless the network is recurrent."""
        free = self._free_pairs(genes)
        if not free:
            return None
        source, target = free[stream.integer(len(free))]
        weight = float(stream.uniform(-1.0, 1.0, 1)[0]) * self.settings.weight_range
        links = np.concatenate(
            [genes.links, np.array([(source, target, weight, 1)], LINK)]
        )
        linked = Genes(genes.nodes, links)
        if self.settings.recurrent:
            return linked
        ids = genes.nodes["id"].tolist()
        order = sorted_forward(ids[self.outputs :], linked.pairs())
        assert order is not None  # noqa: S101  such links are not free
        rows = [ids.index(id_) for id_ in [*ids[: self.outputs], *order]]
        return Genes(genes.nodes[rows], links)

    def _free_pairs(self, genes: Genes) -> list[tuple[int, int]]:
        """Return sources and targets of links that may be added."""
        ids = genes.nodes["id"].tolist()
        outputs, hidden = ids[: self.outputs], ids[self.outputs :]
        sources, taken = [*range(1, self.inputs + 1), *hidden], set(genes.pairs())
        # Per target the sources that would close a circle.
        closing: dict[int, set[int]] = {}
        if self.settings.recurrent:
            sources += outputs
        else:
            closing = reachable(hidden, taken)
        return [
            (source, target)
            for source in sources
            for target in [*hidden, *outputs]
            if (source, target) not in taken and source not in closing.get(target, ())
        ]
