"""The confidence interval of a mean."""

import numpy as np
import pytest

from zswarm.ot.assessment.interval import of_mean, quantile


@pytest.mark.parametrize(
    ("freedom", "expected"), [(4, 2.7764), (9, 2.2622), (19, 2.0930), (99, 1.9842)]
)
def test_quantiles_are_those_of_tables(freedom: int, expected: float) -> None:
    assert quantile(freedom) == pytest.approx(expected, abs=1e-3)


def test_the_interval_has_the_mean_in_95_of_100_cases() -> None:
    draw = np.random.default_rng(1)
    ends = [of_mean(sample)[1:] for sample in draw.normal(3.0, 2.0, (2000, 10))]
    assert 0.94 < np.mean([low <= 3.0 <= high for low, high in ends]) < 0.96


def test_one_trial_has_a_mean_and_no_interval() -> None:
    mean, low, high = of_mean(np.array([2.5]))
    assert mean == 2.5
    assert np.isnan([low, high]).all()
