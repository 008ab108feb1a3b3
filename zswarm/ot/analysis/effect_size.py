"""The interval of an effect size, and ranks of methods over several problems.

The interval of A12 is Newcombe's fifth method (2006, Statistics in Medicine 25, 559-573): Hanley
and McNeil's variance at the bound itself, so that it holds for few runs and for A12 of 0 or 1.
Friedman's test ranks methods within each problem (Demsar 2006, JMLR 7, 1-30).
"""

import itertools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from zswarm.system.extras import need

Z = 1.959963984540054  # of 95 %
STEPS = 60  # of a bisection
LEVEL = 0.05  # of significance
UNCLEAR = "unclear"
# By A12; above, an effect is large.
EFFECTS = ((0.56, "negligible"), (0.64, "small"), (0.71, "medium"))


class Friedman(NamedTuple):
    """Methods, ranked within each of several problems."""

    problems: int
    ranks: dict[str, float]  # mean rank of each method; 1 is the best
    statistic: float  # chi squared
    p: float
    needed: int  # problems from which on a difference can be significant


def a12_interval(a12: float, m: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of an A12 of ``m`` and ``n`` runs."""
    low = _bound(a12, m, n, 0.0) if a12 > 0.0 else 0.0
    high = _bound(a12, m, n, 1.0) if a12 < 1.0 else 1.0
    return low, high


def effect(a12: float, low: float, high: float) -> str:
    """Name the size of an effect; ``UNCLEAR`` if it may be one in either direction.

    Args:
        a12: of the effect.
        low: of its interval.
        high: of its interval.
    """
    if low <= 0.5 <= high and max(1.0 - low, high) >= EFFECTS[0][0]:
        return UNCLEAR
    size = max(a12, 1.0 - a12)
    return next((name for bound, name in EFFECTS if size < bound), "large")


def friedman(medians: Mapping[str, Mapping[str, float]]) -> Friedman | None:
    """Rank methods over problems; None with fewer than three methods or two whole problems.

    Args:
        medians: by problem, then by method. Problems in which a method is missing do not count.
    """
    methods = sorted({method for row in medians.values() for method in row})
    whole = [row for row in medians.values() if len(row) == len(methods)]
    if len(methods) < 3 or len(whole) < 2:
        return None
    stats = need("scipy.stats", "plot", "the test over problems")
    table = np.array([[row[method] for method in methods] for row in whole])
    ranks = np.stack([stats.rankdata(-row) for row in table])
    means = dict(zip(methods, ranks.mean(axis=0).tolist(), strict=True))
    freedom = len(methods) - 1
    needed = next(  # chi squared of problems that all rank the methods alike
        count
        for count in itertools.count(2)
        if stats.chi2.sf(count * freedom, freedom) < LEVEL
    )
    if (ranks == ranks[:, :1]).all():
        return Friedman(len(whole), means, 0.0, 1.0, needed)
    found = stats.friedmanchisquare(*ranks.T)
    numbers = float(found.statistic), float(found.pvalue)
    return Friedman(len(whole), means, *numbers, needed)


def _bound(a12: float, m: int, n: int, outer: float) -> float:
    """Find the A12 between the given one and ``outer`` that is Z deviations away."""
    inside, outside = a12, outer
    for _ in range(STEPS):
        middle = (inside + outside) / 2
        if abs(middle - a12) <= Z * _deviation(middle, m, n):
            inside = middle
        else:
            outside = middle
    return inside


def _deviation(a12: float, m: int, n: int) -> float:
    spread = (1 - a12) / (2 - a12) + a12 / (1 + a12)
    each = (m + n) / 2 - 1
    return math.sqrt(a12 * (1 - a12) * (1 + each * spread) / (m * n))
