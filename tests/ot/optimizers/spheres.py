"""Define vectors of genes without a network, and functions that measure their optimizers."""

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from zswarm.config.decode import convert
from zswarm.kernels.random import Stream
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told

CENTRE = 0.7  # of the sphere, in ranges


class NoSettings(msgspec.Struct, frozen=True):
    """Define settings without keys."""


class Vector(Representation):
    """A vector of genes, each with its own range; without genes, genomes that are not vectors."""

    settings_type = NoSettings

    def __init__(self, genes: int | None) -> None:
        super().__init__(NoSettings(), 1, 1)
        self.genes = genes
        self.ranges = None if genes is None else 0.3 + np.arange(genes) % 5
        self.genome_bytes = None if genes is None else 4 * genes

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        return np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), -1)

    def random(self, count: int, stream: Stream) -> list[bytes]:
        assert self.genes is not None
        table = (
            stream.uniform(-1.0, 1.0, count * self.genes).reshape(count, self.genes)
            * self.ranges
        )
        return [row.tobytes() for row in table.astype("<f4")]

    def mutate(self, *_arguments: Any, **_more: Any) -> list[bytes]:
        raise NotImplementedError

    crossover = distances = mutate  # type: ignore[assignment]


def sphere(genomes: Sequence[bytes], vector: Vector) -> np.ndarray:
    """Return minus the squared distance from CENTRE, in ranges."""
    return -np.square(vector.parameters(genomes) / vector.ranges - CENTRE).sum(axis=1)


def make(
    kind: type[Optimizer], genes: int | None, seed: int = 1, **settings: Any
) -> Optimizer:
    return kind(convert(settings, kind.settings_type, "settings"), Vector(genes), seed)


def evolve(optimizer: Optimizer, generations: int) -> list[Told]:
    """Let an optimizer evolve on the sphere, with the first genes in ranges as measures."""
    vector = optimizer.representation
    assert isinstance(vector, Vector)
    told = []
    for _ in range(generations):
        genomes = optimizer.ask()
        measures = (vector.parameters(genomes) / vector.ranges)[
            :, : len(optimizer.measures)
        ]
        told.append(Told(genomes, sphere(genomes, vector), measures.astype(np.float64)))
        optimizer.tell(told[-1].fitness, told[-1].measures)
    return told


def best_of_random(genes: int, evaluations: int, seed: int) -> float:
    vector = Vector(genes)
    return float(sphere(vector.random(evaluations, Stream(seed)), vector).max())
