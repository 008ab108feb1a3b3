"""Particle swarm optimization (PSO): particles are drawn to the best positions found.

Source, with the numbers of the equations: Y. Shi, R. Eberhart, "A Modified Particle Swarm
Optimizer", ICEC 1998, after J. Kennedy, R. Eberhart, ICNN 1995. Maths, and what differs from
FREVO's ``PSO``: docs/optimizers.md.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, within
from zswarm.kernels.sums import mean
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.base import BaseOptimizer
from zswarm.ot.optimizers.breeding import Population
from zswarm.ot.optimizers.space import Bound, Positive, Space, spread

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

    With fresh seeds the best position of each particle is evaluated again.

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
        self._positions = self._velocities = np.empty((0, self._space.dimensions))
        self._best_positions = self._positions
        self._best_fitness = np.full(settings.population, -np.inf)

    def use_fresh_seeds(self) -> None:
        """See ``Optimizer``: the best position of each particle is evaluated again."""
        super().use_fresh_seeds()
        self.candidates = 2 * self.settings.population

    def _ask(self) -> list[bytes]:
        settings, count, space = self.settings, self.settings.population, self._space
        stream = self._stream("pso")
        if self.generation == 0:
            self._positions = self._best_positions = space.uniform(
                -1.0, 1.0, count, stream
            )
            self._velocities = space.uniform(-0.5, 0.5, count, stream)
            return space.genomes(self._positions)
        x, best = self._positions, self._best_positions
        leader = best[np.argmax(self._best_fitness)]  # the first of equals
        cognitive = settings.own * space.uniform(0.0, 1.0, count, stream) * (best - x)
        social = settings.social * space.uniform(0.0, 1.0, count, stream) * (leader - x)
        velocities = settings.inertia * self._velocities + cognitive + social  # eq. 1a
        self._velocities = np.clip(velocities, -settings.speed, settings.speed)
        # Eq. 1b.
        self._positions = np.clip(x + self._velocities, -settings.bound, settings.bound)
        asked = space.genomes(self._positions)
        return [*asked, *space.genomes(best)] if self.fresh else asked

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  unused
        count, everything = self.settings.population, fitness
        fitness, again = fitness[:count], fitness[count:]
        if len(again):
            self._best_fitness = np.where(np.isnan(again), -np.inf, again)
        better = fitness > self._best_fitness  # false for NaN
        self._best_fitness = np.where(better, fitness, self._best_fitness)
        self._best_positions = np.where(
            better[:, None], self._positions, self._best_positions
        )
        speed = mean(np.abs(self._velocities))
        self._count(everything, spread=spread(self._positions), speed=speed)
