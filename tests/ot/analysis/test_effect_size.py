"""Intervals of effect sizes, and ranks of methods over problems."""

import math

import pytest

from zswarm.ot.analysis.effect_size import Z, a12_interval, friedman


@pytest.mark.parametrize(("a12", "m", "n"), [(0.9, 20, 20), (0.5, 5, 8), (0.7, 40, 10)])
def test_the_bounds_are_as_far_away_as_their_own_deviations(
    a12: float, m: int, n: int
) -> None:
    """Newcombe's equation 5, at the bounds."""
    for bound in a12_interval(a12, m, n):
        each = (m + n) / 2 - 1
        spread = (1 - bound) / (2 - bound) + bound / (1 + bound)
        variance = bound * (1 - bound) * (1 + each * spread) / (m * n)
        assert abs(bound - a12) == pytest.approx(Z * math.sqrt(variance), rel=1e-6)


def test_an_interval_is_symmetric_and_not_empty_at_the_ends() -> None:
    low, high = a12_interval(1.0, 5, 5)
    assert (round(low, 2), high) == (0.64, 1.0)
    assert a12_interval(0.0, 5, 5) == pytest.approx((0.0, 1 - low))
    narrow = a12_interval(1.0, 50, 50)[0]
    assert narrow > 0.95 > low


def test_methods_are_ranked_within_each_problem() -> None:
    """Demsar's rule: 1 is the best; scipy's statistic of the same ranks."""
    medians = {
        f"problem {number}": {"a": 3.0 + number, "b": 2.0 + number, "c": 1.0 + number}
        for number in range(4)
    }
    medians["another"] = {"a": 1.0, "b": 2.0}  # it lacks a method
    found = friedman(medians)
    assert found is not None
    assert found.ranks == {"a": 1.0, "b": 2.0, "c": 3.0}
    assert (found.problems, found.statistic) == (4, pytest.approx(8.0))
    assert found.p == pytest.approx(math.exp(-4), rel=1e-9)  # chi squared, 2 degrees


def test_two_methods_or_one_problem_are_not_ranked() -> None:
    assert friedman({"x": {"a": 1.0, "b": 2.0}, "y": {"a": 1.0, "b": 2.0}}) is None
    assert friedman({"x": {"a": 1.0, "b": 2.0, "c": 3.0}}) is None


def test_equal_methods_do_not_differ() -> None:
    same = {name: dict.fromkeys("abc", 1.0) for name in ("x", "y")}
    found = friedman(same)
    assert found is not None
    assert found.p == 1.0
