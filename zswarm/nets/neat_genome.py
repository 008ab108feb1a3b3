"""Genomes of NEAT: their layout, innovation numbers, and the order of their nodes.

Layout, little-endian: uint32 nodes, uint32 links; then the nodes without the inputs, outputs first;
then the links. Inputs have the ids 1..I, outputs I + 1..I + O.

Innovation numbers need no shared counter. That of a link is its source and target. That of a hidden
node is its id: a hash of the link that it split and of how often that link was split before in this
genome. So the same change has the same number everywhere. They have no age, so disjoint and excess
genes are not distinguished; NEAT treats both alike in its experiments.
"""

import hashlib
import struct
from collections.abc import Collection, Iterable
from itertools import count
from typing import NamedTuple

import numpy as np

COUNTS = struct.Struct("<II")
NODE = np.dtype([("id", "<u8"), ("bias", "<f8"), ("factor", "<f8")])
LINK = np.dtype(
    [("source", "<u8"), ("target", "<u8"), ("weight", "<f8"), ("enabled", "u1")]
)

Innovation = tuple[int, int, int]  # source, target, which of equal links


class Genes(NamedTuple):
    """A decoded genome."""

    nodes: np.ndarray  # (nodes,) NODE
    links: np.ndarray  # (links,) LINK

    @classmethod
    def decode(cls, genome: bytes) -> "Genes":
        """Return read-only arrays on a genome's bytes.

        Raises:
            ValueError: its length does not fit its counts.
        """
        length = len(genome)
        if length < COUNTS.size:
            text = f"it begins with two counts, which take {COUNTS.size}"
            raise ValueError(f"a genome has {length} bytes; {text}")
        nodes, links = COUNTS.unpack_from(genome)
        end = COUNTS.size + nodes * NODE.itemsize
        if nodes == 0 or length != end + links * LINK.itemsize:
            text = f"{length} bytes, which are not {nodes} nodes and {links} links"
            raise ValueError(f"a genome has {text}")
        arrays = (NODE, nodes, COUNTS.size), (LINK, links, end)
        return cls(*(np.frombuffer(genome, *array) for array in arrays))

    @classmethod
    def copied(cls, genome: bytes) -> "Genes":
        """Return arrays to change, without nodes whose id occurred before."""
        genes = cls.decode(genome)
        return cls(first_of_each_id(genes.nodes).copy(), genes.links.copy())

    def genome(self) -> bytes:
        """Encode the genes."""
        counts = COUNTS.pack(len(self.nodes), len(self.links))
        return counts + self.nodes.tobytes() + self.links.tobytes()

    def pairs(self) -> list[tuple[int, int]]:
        """Return source and target of each link."""
        return list(
            zip(self.links["source"].tolist(), self.links["target"].tolist(), strict=True)
        )

    def innovations(self) -> list[Innovation]:
        """Return an innovation number per link; FREVO's genomes may have the same link twice."""
        seen: dict[tuple[int, int], int] = {}
        found = []
        for pair in self.pairs():
            which = seen.get(pair, 0)
            seen[pair] = which + 1
            found.append((*pair, which))
        return found


def first_of_each_id(nodes: np.ndarray) -> np.ndarray:
    """Return the nodes without those whose id occurred before."""
    ids = nodes["id"].tolist()
    if len(set(ids)) == len(ids):
        return nodes
    return nodes[[index for index, id_ in enumerate(ids) if id_ not in ids[:index]]]


def new_id(source: int, target: int, least: int, used: Collection[int]) -> int:
    """Return the id of a node that splits a link: the first free hash from ``least`` up."""
    for times in count():
        link = struct.pack("<QQQ", source, target, times)
        id_ = int.from_bytes(hashlib.blake2b(link, digest_size=8).digest(), "little")
        if id_ >= least and id_ not in used:
            return id_
    raise AssertionError  # pragma: no cover  count never ends


def sorted_forward(
    nodes: Iterable[int], pairs: Iterable[tuple[int, int]]
) -> list[int] | None:
    """Return the nodes so that all pairs lead forward, or None if pairs form a circle.

    Args:
        nodes: keep their order where pairs leave it open.
        pairs: source and target; those with another node do not count.
    """
    sources: dict[int, set[int]] = {node: set() for node in nodes}
    for source, target in pairs:
        if source in sources and target in sources:
            sources[target].add(source)
    order: list[int] = []
    while sources:
        node = next((node for node, waiting in sources.items() if not waiting), None)
        if node is None:
            return None
        order.append(node)
        del sources[node]
        for waiting in sources.values():
            waiting.discard(node)
    return order


def reachable(
    nodes: Iterable[int], pairs: Iterable[tuple[int, int]]
) -> dict[int, set[int]]:
    """Return per node the nodes that pairs lead to from it, itself included."""
    following: dict[int, list[int]] = {node: [] for node in nodes}
    for source, target in pairs:
        if source in following and target in following:
            following[source].append(target)
    found = {}
    for start in following:
        found[start], waiting = {start}, [start]
        while waiting:
            for node in following[waiting.pop()]:
                if node not in found[start]:
                    found[start].add(node)
                    waiting.append(node)
    return found
