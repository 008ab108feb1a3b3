"""Random search keeps the best, and nothing else."""

import numpy as np

from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.ot.optimizers.random_search import RandomSearch, RandomSearchSettings

NETWORK = FullyMeshed(FullyMeshedSettings(), 2, 1)


def test_the_best_is_one_of_the_population_and_not_evaluated_again() -> None:
    optimizer = RandomSearch(RandomSearchSettings(population=10), NETWORK, 1)
    first = optimizer.ask()
    optimizer.tell(np.arange(10.0))
    second = optimizer.ask()
    assert (len(first), len(second)) == (10, 9)
    optimizer.tell(np.zeros(9))
    assert optimizer.best() == (first[9], 9.0)
    assert len({*first, *second, *optimizer.ask()}) == 28


def test_relative_fitness_makes_the_best_compete_again() -> None:
    optimizer = RandomSearch(RandomSearchSettings(population=10), NETWORK, 1)
    optimizer.relative = True
    first = optimizer.ask()
    optimizer.tell(np.arange(10.0))
    second = optimizer.ask()
    assert len(second) == 10
    assert second[0] == first[9]
    optimizer.tell(np.array([-1.0, *range(-10, -1)]))
    assert optimizer.best() == (first[9], -1.0)
    optimizer.ask()
    optimizer.tell(np.full(10, np.nan))
    assert optimizer.best()[0] == b""
    assert len(optimizer.ask()) == 10
