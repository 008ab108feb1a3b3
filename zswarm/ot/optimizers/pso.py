"""Particle swarm optimization (PSO): particles are drawn to the best positions found.

Source, with the numbers of the equations: Y. Shi, R. Eberhart, "A Modified Particle Swarm
Optimizer", ICEC 1998, after J. Kennedy, R. Eberhart, ICNN 1995. Maths, and what differs from
FREVO's ``PSO``: docs/optimizers.md.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, within
from zswarm.kernels.sums import mean_of
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.base import BaseOptimizer
from zswarm.ot.optimizers.breeding import Population
from zswarm.ot.optimizers.space import Bound, Positive, Space, spread

PART = 4_000_000  # numbers of particles that are moved at once

Pull = Annotated[float, Meta(ge=0, le=100)]


class PsoSettings(PartSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "pso"``."""

    population: Annotated[Population, about("particles")] = 100
    inertia: Annotated[
        float, within(0, 10, "share of its velocity that a particle keeps")
    ] = 0.7
    own: Annotated[Pull, about("cognitive coefficient: pull of its best position")] = 2.4
    social: Annotated[
        Pull, about("social coefficient: pull of the best position of all")
    ] = 2.1
    speed: Annotated[Positive, about("limit of a velocity per generation, in ranges")] = (
        1.0
    )
    bound: Bound = 1.0


class PSO(BaseOptimizer):
    """Particle swarm optimization: particles drawn to the best positions found. For vectors.

    Statistics: best, mean, evaluations; ``spread``, the mean distance of a particle's number from
    the swarm's mean, and ``speed``, its mean change in a generation, both in ranges of new genomes.
    """

    settings_type = PsoSettings
    stored = ("positions", "velocities", "best_positions", "best_fitness")
    settings: PsoSettings

    def __init__(
        self, settings: PsoSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.population
        self._space = Space(representation)
        # A particle is where its genome is, so the record has all positions; genomes may be large.
        self._positions: list[bytes] = []
        self._velocities: list[bytes] = []  # float32
        self._best_positions: list[bytes] = []
        self._best_fitness = np.full(settings.population, -np.inf)

    def _ask(self) -> list[bytes]:
        positions: list[bytes] = []
        velocities: list[bytes] = []
        for some in self._blocks():
            x, v = self._moved(some)
            positions += self._space.genomes(x)
            velocities += [row.tobytes() for row in v]
        self._positions, self._velocities = positions, velocities
        if self.generation == 0:
            self._best_positions = positions
        return positions

    def _moved(self, some: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return the next positions and velocities of some particles."""
        settings, points = self.settings, self._space.points
        if self.generation == 0:
            x = self._drawn(-1.0, 1.0, 0, some)
            return x, self._drawn(-0.5, 0.5, 1, some).astype("<f4")
        x, best = points(self._positions[some]), points(self._best_positions[some])
        # The first of equals.
        leader = points([self._best_positions[int(np.argmax(self._best_fitness))]])
        velocities = _floats(self._velocities[some]).reshape(x.shape)
        cognitive = settings.own * self._drawn(0.0, 1.0, 0, some) * (best - x)
        social = settings.social * self._drawn(0.0, 1.0, 1, some) * (leader - x)
        v = settings.inertia * velocities + cognitive + social  # eq. 1a
        v = np.clip(v, -settings.speed, settings.speed).astype("<f4")
        # Eq. 1b.
        return np.clip(x + v, -settings.bound, settings.bound), v

    def _drawn(self, low: float, high: float, table: int, some: slice) -> np.ndarray:
        """Return rows of one of two tables of random numbers, a row for each particle."""
        stream, count = self._stream("pso"), self.settings.population
        stream.position = (table * count + some.start) * self._space.dimensions
        rows = min(some.stop, count) - some.start
        return self._space.uniform(low, high, rows, stream)

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  unused
        better = fitness > self._best_fitness  # false for NaN
        self._best_fitness = np.where(better, fitness, self._best_fitness)
        both = zip(better, self._positions, self._best_positions, strict=True)
        self._best_positions = [here if new else best for new, here, best in both]
        some = self._blocks()
        speeds = (np.abs(_floats(self._velocities[block])) for block in some)
        distance = spread(
            lambda: (self._space.points(self._positions[block]) for block in some)
        )
        self._count(fitness, spread=distance, speed=mean_of(speeds))

    def _blocks(self) -> list[slice]:
        """Return particles that are moved at once."""
        count = max(1, PART // self._space.dimensions)
        firsts = range(0, self.settings.population, count)
        return [slice(first, first + count) for first in firsts]


def _floats(rows: Sequence[bytes]) -> np.ndarray:
    return np.frombuffer(b"".join(rows), "<f4").astype(np.float64)
