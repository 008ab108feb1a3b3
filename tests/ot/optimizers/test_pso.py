"""PSO moves particles by the equations of its sources, and mends what is wrong in FREVO's."""

import numpy as np
import pytest

from zswarm.kernels.random import Stream, derive_seed
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.ot.optimizers.pso import PSO, PsoSettings

NETWORK = FullyMeshed(FullyMeshedSettings(weight_range=3.0), 2, 1)
GENES = NETWORK.genes or 0


def places(genomes: list[bytes]) -> np.ndarray:
    """Return the genes of genomes in units of their ranges, shape (genomes, genes)."""
    return (
        np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), -1).astype(float)
        / NETWORK.ranges
    )


def told(optimizer: PSO, fitness: list[float]) -> None:
    optimizer.tell(np.array(fitness))


@pytest.mark.parametrize(
    "settings",
    [
        PsoSettings(population=4),
        PsoSettings(population=4, inertia=0.2, speed=0.3, bound=0.9),
    ],
)
def test_particles_move_by_the_equations(settings: PsoSettings) -> None:
    """Number by number, in plain Python: Shi and Eberhart's (1a) and (1b), cut at the limits."""
    optimizer = PSO(settings, NETWORK, 3)
    x = places(optimizer.ask())
    stream = Stream(derive_seed(3, "pso", 0))
    stream.words(x.size)
    v = stream.uniform(-0.5, 0.5, x.size).reshape(x.shape)
    told(optimizer, [1.0, 4.0, 2.0, 3.0])
    p, best = x.copy(), 1
    for generation in range(1, 4):
        stream = Stream(derive_seed(3, "pso", generation))
        own, social = (
            stream.uniform(0.0, 1.0, x.size).reshape(x.shape) for _ in range(2)
        )
        for i in range(4):
            for d in range(GENES):
                pull = settings.own * own[i, d] * (
                    p[i, d] - x[i, d]
                ) + settings.social * social[i, d] * (p[best, d] - x[i, d])
                v[i, d] = min(
                    max(settings.inertia * v[i, d] + pull, -settings.speed),
                    settings.speed,
                )
        x = np.clip(x + v, -settings.bound, settings.bound)
        assert np.abs(places(optimizer.ask()) - x).max() < 1e-5
        # One finds a better place each time, the others none.
        told(optimizer, [0.0, 0.0, 9.0 + generation, 0.0])
        p[2], best = x[2], 2


def test_new_particles_are_new_genomes_and_fly_both_ways() -> None:
    optimizer = PSO(PsoSettings(population=400), NETWORK, 1)
    first = places(optimizer.ask())
    assert np.histogram(first, 4, (-1, 1))[0] / first.size == pytest.approx(
        [0.25] * 4, abs=0.02
    )
    assert abs(optimizer._velocities.mean()) < 0.02
    assert np.abs(optimizer._velocities).max() <= 0.5


def test_a_particle_remembers_its_best_position() -> None:
    """FREVO stores the particle itself as its best position."""
    optimizer = PSO(PsoSettings(population=3), NETWORK, 1)
    first = places(optimizer.ask())
    told(optimizer, [-5.0, -6.0, -7.0])
    optimizer.ask()
    told(optimizer, [-9.0, -9.0, -1.0])
    assert np.abs(optimizer._best_positions[:2] - first[:2]).max() < 1e-6
    assert optimizer._best_fitness.tolist() == [-5.0, -6.0, -1.0]


def test_positions_and_velocities_stay_within_their_limits() -> None:
    optimizer = PSO(
        PsoSettings(population=20, speed=0.25, bound=1.5, own=50.0), NETWORK, 1
    )
    widest = 0.0
    for generation in range(20):
        here = places(optimizer.ask())
        widest = max(widest, float(np.abs(here).max()))
        assert np.abs(optimizer._velocities).max() <= (0.25 if generation else 0.5)
        optimizer.tell(here[:, 0])
    assert widest == pytest.approx(1.5)


def test_a_failed_particle_attracts_no_other() -> None:
    nan = float("nan")
    optimizer = PSO(PsoSettings(population=3), NETWORK, 1)
    optimizer.ask()
    told(optimizer, [nan, nan, nan])
    genomes = optimizer.ask()
    told(optimizer, [nan, -3.0, nan])
    assert optimizer.best() == (genomes[1], -3.0)
    assert np.isfinite(places(optimizer.ask())).all()


def test_a_swarm_at_one_position_without_inertia_stands_still() -> None:
    """Statistics tell it: spread and speed are 0."""
    optimizer = PSO(
        PsoSettings(population=5, inertia=0.0, own=0.0, social=1.0), NETWORK, 1
    )
    for _ in range(80):
        optimizer.tell(-np.abs(places(optimizer.ask())).sum(axis=1))
    assert optimizer.statistics()["spread"] < 1e-3
    assert optimizer.statistics()["speed"] < 1e-2
