"""The confidence interval of a mean, by Student's t."""

import numpy as np

from zswarm.kernels.sums import mean

# The 0.975 quantile of the normal distribution; only products follow, so bits are equal everywhere.
Z = 1.959963984540054
Z2 = Z * Z
TERMS = (
    Z * (Z2 + 1) / 4,
    Z * ((5 * Z2 + 16) * Z2 + 3) / 96,
    Z * (((3 * Z2 + 19) * Z2 + 17) * Z2 - 15) / 384,
    Z * ((((79 * Z2 + 776) * Z2 + 1482) * Z2 - 1920) * Z2 - 945) / 92160,
)


def of_mean(values: np.ndarray) -> tuple[float, float, float]:
    """Return mean, and lower and upper end of its 95 % interval; NaN where they are unknown."""
    middle, count = mean(values), len(values)
    if count < 2:
        return middle, float("nan"), float("nan")
    half = quantile(count - 1) * float(np.sqrt(variance(values) / count))
    return middle, middle - half, middle + half


def variance(values: np.ndarray) -> float:
    """Return the unbiased estimate of the variance, added in order."""
    deviations = values - mean(values)
    return mean(deviations * deviations) * (len(values) / (len(values) - 1))


def quantile(freedom: int) -> float:
    """Return the two-sided 95 % quantile of Student's t.

    By its expansion around the normal distribution (Abramowitz and Stegun 26.7.5), whose error is
    below 0.001 from 4 degrees of freedom on.
    """
    found = Z
    for power, term in enumerate(TERMS, 1):
        found += term / freedom**power
    return found
