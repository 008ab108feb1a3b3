"""The judgement of the soak test: it finds a leak under noise, and does not cry wolf."""

import sys
from types import ModuleType

import numpy as np
import pytest

from tests.repository import REPOSITORY

BENCHMARKS = REPOSITORY / "benchmarks"


@pytest.fixture(scope="module")
def soak() -> ModuleType:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import soak
    finally:
        sys.path.remove(str(BENCHMARKS))
    return soak


def samples(soak: ModuleType, rss_mb: np.ndarray, **others: np.ndarray) -> list:
    plain = {
        "descriptors": np.full(len(rss_mb), 20),
        "threads": np.full(len(rss_mb), 9),
        "shm": np.ones(len(rss_mb)),
    } | others
    return [
        (
            2.0 * i,
            soak.Usage(
                rss_mb[i],
                int(plain["descriptors"][i]),
                int(plain["threads"][i]),
                int(plain["shm"][i]),
            ),
        )
        for i in range(len(rss_mb))
    ]


def noisy(slope_mb: float, seed: int) -> np.ndarray:
    """Five minutes, a sample every 2 s, with noise of 1 MB."""
    return (
        60.0
        + slope_mb * np.arange(150) / 30
        + np.random.default_rng(seed).normal(0.0, 1.0, 150)
    )


def test_a_few_outliers_do_not_change_the_fitted_slope(soak: ModuleType) -> None:
    times = np.arange(50) * 2.0
    values = 3.0 + 0.25 * times
    values[::7] += 1000.0
    assert soak.theil_sen(times, values) == pytest.approx(0.25)


@pytest.mark.parametrize("seed", range(20))
def test_a_leak_of_one_mb_a_minute_is_found_and_noise_is_not_reported(
    soak: ModuleType, seed: int
) -> None:
    """The limit is 0.5; noise of 1 MB moves the slope by 0.1 or so."""
    leaking, steady = (
        soak.judge("x", samples(soak, noisy(slope, seed))) for slope in (1.0, 0.0)
    )
    assert abs(steady.slope) < 0.3
    assert abs(leaking.slope - 1.0) < 0.3
    assert steady.complaints == []
    assert len(leaking.complaints) == 1
    assert "memory" in leaking.complaints[0]


def test_fluctuating_threads_files_and_shared_memory_are_not_a_leak(
    soak: ModuleType,
) -> None:
    busy = 20 + np.random.default_rng(1).integers(0, 5, 150)
    assert (
        soak.judge(
            "x", samples(soak, noisy(0.0, 1), descriptors=busy, threads=busy)
        ).complaints
        == []
    )


@pytest.mark.parametrize("what", ["descriptors", "threads", "shm"])
def test_a_steady_growth_of_files_or_threads_is_a_leak(
    soak: ModuleType, what: str
) -> None:
    busy = np.random.default_rng(1).integers(0, 5, 150)
    growing = 20 + busy + np.arange(150) // 10
    complaints = soak.judge(
        "x", samples(soak, noisy(0.0, 1), **{what: growing})
    ).complaints
    assert len(complaints) == 1
    assert what in complaints[0]
