"""OCBA: the published example, and what holds for any numbers."""

import numpy as np
import pytest

from zswarm.ot.assessment.ocba import allocate


def test_the_published_example_is_reproduced() -> None:
    """Chen's program, and R's package SPOT; there the lowest mean is the best."""
    means = -np.array([1.2, 2.1, 3.4, 4.87, 6.05])
    variances, spent = np.array([3.3, 2, 4.5, 5.3, 6.9]), np.array([12, 6, 5, 5, 4])
    assert allocate(means, variances, spent, 100).tolist() == [48, 38, 11, 2, 1]


@pytest.mark.parametrize("seed", range(20))
def test_all_of_the_budget_is_allocated_and_nothing_is_taken_back(seed: int) -> None:
    draw = np.random.default_rng(seed)
    count, budget = int(draw.integers(2, 30)), int(draw.integers(1, 500))
    means = draw.normal(size=count).round(int(draw.integers(0, 3)))  # equal ones, too
    variances = draw.uniform(0, 2, count) * draw.integers(0, 2, count)
    variances[0] = 1.0
    more = allocate(means, variances, draw.integers(2, 100, count), budget)
    assert more.sum() == budget
    assert (more >= 0).all()


def test_candidates_that_may_be_the_best_get_the_trials() -> None:
    means, variances = np.array([0.0, 9.9, 5.0, 10.0]), np.full(4, 4.0)
    more = allocate(means, variances, np.full(4, 10), 100)
    assert more[[0, 2]].tolist() == [0, 0]
    assert abs(more[1] - more[3]) <= 2  # what rounding leaves goes to the best
