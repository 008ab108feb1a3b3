"""Particle swarm optimization (PSO): particles fly through the space of genomes, drawn to the best places found.

Equations: J. Kennedy, R. Eberhart, "Particle Swarm Optimization", ICNN 1995, with the inertia of Y. Shi, R. Eberhart, "A
Modified Particle Swarm Optimizer", ICEC 1998, numbered as there. As in FREVO's ``PSO`` (github.com/smartgrids-aau/Frevo, version
1.5): the swarm has one best place that draws all, each number of a genome draws its own two random factors, speed and place are
cut at the range of new genomes.
Mended:
- a particle remembers its own best place (there it is the same object as the particle, so that nothing draws it back);
- fitness may be negative (there the best starts at 0.0, and a swarm below that stands still with an error);
- the first velocities have both signs (there none is negative).
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.ot.optimizers.space import Space, spread
from zswarm.ot.optimizers.tally import Tally, mean


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "pso"``."""

    population: Annotated[int, Meta(ge=2, le=1_000_000, description="particles")] = 100
    inertia: Annotated[float, Meta(ge=0, le=10, description="share of its velocity that a particle keeps")] = 0.7
    own: Annotated[float, Meta(ge=0, le=100, description="pull of the best place that the particle found itself")] = 2.4
    social: Annotated[float, Meta(ge=0, le=100, description="pull of the best place that any found")] = 2.1
    speed: Annotated[float, Meta(gt=0, le=1e6, description="limit of a velocity per generation, in ranges of new genomes")] = 1.0
    bound: Annotated[float, Meta(gt=0, le=1e6, description="limit of a genome's numbers, in ranges of new genomes")] = 1.0


class PSO(Optimizer):
    """Particle swarm optimization: particles drawn to the best places that they and others found. For vectors of numbers.

    Statistics: best, mean, evaluations; ``spread``, how far a particle's number is from the swarm's mean, and ``speed``, how much
    it changes in a generation, both on average and in ranges of new genomes.
    """

    settings_type = Settings
    portable = True
    settings: Settings

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.population
        self._space = Space(representation)
        self._tally = Tally()
        self._places = self._velocities = self._best_places = np.empty((0, self._space.dimensions))
        self._best_fitness = np.full(settings.population, -np.inf)

    def _ask(self) -> list[bytes]:
        settings, count = self.settings, self.settings.population
        stream = Stream(derive_seed(self.seed, "pso", self.generation))
        if self.generation == 0:
            self._places = self._best_places = self._space.uniform(-1.0, 1.0, count, stream)
            self._velocities = self._space.uniform(-0.5, 0.5, count, stream)
        else:
            x = self._places
            leader = self._best_places[np.argmax(self._best_fitness)]  # the first of equals
            own = settings.own * self._space.uniform(0.0, 1.0, count, stream) * (self._best_places - x)
            social = settings.social * self._space.uniform(0.0, 1.0, count, stream) * (leader - x)
            velocities = settings.inertia * self._velocities + own + social  # Shi, Eberhart: (1a)
            self._velocities = np.clip(velocities, -settings.speed, settings.speed)
            self._places = np.clip(x + self._velocities, -settings.bound, settings.bound)  # (1b)
        return self._space.genomes(self._places)

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  it wants none
        better = fitness > self._best_fitness  # NaN is not
        self._best_fitness = np.where(better, fitness, self._best_fitness)
        self._best_places = np.where(better[:, None], self._places, self._best_places)
        numbers = {"spread": spread(self._places), "speed": mean(np.abs(self._velocities))}
        self._tally.add(self._space.genomes(self._places), fitness, numbers)

    def state(self) -> dict[str, Any]:
        """See ``Optimizer.state``."""
        return {
            "generation": self.generation,
            "tally": self._tally.state(),
            "places": self._places.tobytes(),
            "velocities": self._velocities.tobytes(),
            "best_places": self._best_places.tobytes(),
            "best_fitness": self._best_fitness.tolist(),
        }

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:  # noqa: ARG002  the state is all
        """See ``Optimizer.restore``."""
        self.generation = state["generation"]
        self._tally = Tally(**state["tally"])
        self._places, self._velocities, self._best_places = (
            self._space.points(state[name]) for name in ("places", "velocities", "best_places")
        )
        self._best_fitness = np.array(state["best_fitness"])

    def best(self) -> tuple[bytes, float]:
        """See ``Optimizer.best``."""
        return self._tally.best()

    def statistics(self) -> dict[str, float]:
        """See the class."""
        return dict(self._tally.statistics)
