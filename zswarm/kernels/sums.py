"""Sums and means with the same bits everywhere; numpy's own promise no order of additions."""

from collections.abc import Iterable

import numpy as np


def total(numbers: np.ndarray) -> np.ndarray:
    """Return the sum along the first axis, added in order."""
    added: np.ndarray = np.cumsum(numbers, axis=0)[-1]
    return added


def mean_of(parts: Iterable[np.ndarray]) -> float:
    """Return the ``mean`` of the numbers of all parts, of which one is held at a time."""
    added, count = np.zeros(()), 0
    for part in parts:
        known = part[~np.isnan(part)].astype(np.float64, copy=False)
        added = total(np.concatenate(([added], known)))
        count += known.size
    return float(added) / count if count else float("nan")


def mean(numbers: np.ndarray) -> float:
    """Return the mean of all numbers but NaN, added in order; NaN if there are none."""
    known = numbers[~np.isnan(numbers)]
    return float(total(known)) / known.size if known.size else float("nan")
