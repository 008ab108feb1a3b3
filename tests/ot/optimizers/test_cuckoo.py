"""Cuckoo search flies as Levy does, and lays eggs by the equations of its sources."""

import math

import numpy as np
import pytest

from zswarm.kernels.random import Stream
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.ot.optimizers.cuckoo import (
    DEVIATION,
    CuckooSearch,
    CuckooSettings,
    _two_thirds,
)

NETWORK = FullyMeshed(FullyMeshedSettings(), 2, 2)


def places(genomes: list[bytes]) -> np.ndarray:
    return (
        np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), -1).astype(float)
        / NETWORK.ranges
    )


def sphere(genomes: list[bytes]) -> np.ndarray:
    return -(places(genomes) ** 2).sum(axis=1)


def test_the_power_two_thirds_is_accurate_to_the_last_bits() -> None:
    numbers = np.concatenate(
        [Stream(1).normal(0.0, 1.0, 20_000), 2.0 ** np.arange(-50.0, 5.0)]
    )
    # Some C libraries' cbrt is off by 2 bits.
    exact = np.cbrt(np.longdouble(numbers * numbers))
    assert np.abs(_two_thirds(numbers) / exact - 1.0).max() < 5e-16


def test_the_deviation_is_mantegnas() -> None:
    b = 1.5
    above = math.gamma(1 + b) * math.sin(math.pi * b / 2)
    assert (
        pytest.approx(
            (above / (math.gamma((1 + b) / 2) * b * 2 ** ((b - 1) / 2))) ** (1 / b),
            rel=1e-15,
        )
        == DEVIATION
    )


def test_long_flights_are_as_rare_as_levys() -> None:
    """Beyond x there are as many as x to the power -3/2 says: an eighth of them beyond 4 x."""
    stream = Stream(2)
    flights = np.abs(
        DEVIATION
        * stream.normal(0, 1, 400_000)
        / _two_thirds(stream.normal(0, 1, 400_000))
    )
    for x in (5.0, 20.0):
        assert (flights > 4 * x).sum() / (flights > x).sum() == pytest.approx(
            1 / 8, rel=0.15
        )


def test_flights_from_all_nests_and_discovery_of_some_take_turns() -> None:
    optimizer = CuckooSearch(CuckooSettings(), NETWORK, 1)
    asked = []
    for _ in range(101):
        genomes = optimizer.ask()
        asked.append(len(genomes))
        optimizer.tell(sphere(genomes))
    assert set(asked[1::2]) == {50} == {asked[0]}
    assert np.mean(asked[2::2]) == pytest.approx(0.75 * 50, rel=0.05)


def test_an_egg_takes_the_place_of_its_own_nest_where_it_is_better() -> None:
    optimizer = CuckooSearch(CuckooSettings(population=6), NETWORK, 1)
    first = optimizer.ask()
    optimizer.tell(np.array([1.0, 2.0, np.nan, 4.0, 5.0, 6.0]))
    eggs = optimizer.ask()
    optimizer.tell(np.array([0.5, 2.5, -1.0, np.nan, 5.0, 7.0]))
    nests = optimizer._space.genomes(optimizer._nests)
    assert nests == [first[0], eggs[1], eggs[2], first[3], first[4], eggs[5]]
    assert optimizer._fitness.tolist() == [1.0, 2.5, -1.0, 4.0, 5.0, 7.0]
    assert optimizer.best() == (eggs[5], 7.0)
    assert optimizer.statistics()["success"] == 0.5


def test_flights_leave_the_best_nest_where_it_is() -> None:
    """Equation (2) scales with the distance to it."""
    optimizer = CuckooSearch(CuckooSettings(population=6), NETWORK, 1)
    first = optimizer.ask()
    optimizer.tell(np.array([1.0, 2.0, 9.0, 4.0, 5.0, 6.0]))
    eggs = optimizer.ask()
    assert [egg == nest for egg, nest in zip(eggs, first, strict=True)] == [
        False,
        False,
        True,
        False,
        False,
        False,
    ]


def test_a_discovered_nest_moves_by_a_share_of_the_difference_of_two_nests() -> None:
    optimizer = CuckooSearch(
        CuckooSettings(population=5, discovery=1.0, bound=100.0), NETWORK, 1
    )
    for _ in range(2):
        genomes = optimizer.ask()
        optimizer.tell(sphere(genomes))
    nests = optimizer._nests.copy()
    moved = places(optimizer.ask()) - nests
    differences = [nests[i] - nests[j] for i in range(5) for j in range(5) if i != j]
    for step in moved[np.abs(moved).max(axis=1) > 1e-6]:
        shares = [
            (step * difference).sum() / (difference**2).sum()
            for difference in differences
        ]
        rests = [
            np.abs(step - share * difference).max()
            for share, difference in zip(shares, differences, strict=True)
        ]
        assert min(rests) < 1e-6
        assert (
            0.0
            < max(shares[index] for index in np.flatnonzero(np.array(rests) < 1e-6))
            < 1.0
        )


def test_discovery_proposes_at_least_one_nest() -> None:
    optimizer = CuckooSearch(CuckooSettings(population=3, discovery=1e-9), NETWORK, 1)
    for _ in range(6):
        genomes = optimizer.ask()
        optimizer.tell(sphere(genomes))
    assert len(genomes) == 3
    assert len(optimizer.ask()) == 1


def test_eggs_stay_within_the_bound() -> None:
    optimizer = CuckooSearch(
        CuckooSettings(population=10, step=50.0, bound=1.25), NETWORK, 1
    )
    for _ in range(10):
        genomes = optimizer.ask()
        assert np.abs(places(genomes)).max() <= 1.2500001
        optimizer.tell(sphere(genomes))
