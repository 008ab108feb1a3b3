"""Optimal computing budget allocation (OCBA): whom to simulate more to find the best.

Source: C.-H. Chen, J. Lin, E. Yuecesan, S. E. Chick, "Simulation Budget Allocation for Further
Enhancing the Efficiency of Ordinal Optimization", Discrete Event Dynamic Systems 10, 2000,
theorem 1. Rounded, and never below what is spent, as in the authors' program.
"""

import numpy as np

from zswarm.kernels.sums import total

# Of the greatest one: without a variance or a difference the ratios would be infinite.
LEAST = 1e-9


def allocate(
    means: np.ndarray, variances: np.ndarray, spent: np.ndarray, budget: int
) -> np.ndarray:
    """Return how many more trials each candidate gets: (n,) int64, ``budget`` in all.

    Args:
        means: (n,) float64, at least two, finite; higher is better.
        variances: (n,) float64 of one trial, not all 0.
        spent: (n,) trials that they were estimated from.
    """
    whole = int(spent.sum()) + budget
    best = int(np.argmax(means))  # the first of equals
    ratios = _ratios(means, np.maximum(variances, LEAST * variances.max()), best)
    wanted, grow = spent.copy(), np.ones(len(means), bool)
    while True:  # who has more than its share keeps that, and the others share the rest
        left = whole - int(spent[~grow].sum())
        wanted[grow] = left * (ratios[grow] / total(ratios[grow]))  # rounds down
        over = grow & (wanted < spent)
        if not over.any():
            break
        wanted[over], grow[over] = spent[over], False
    wanted[best if grow[best] else np.argmax(grow)] += whole - int(wanted.sum())
    added: np.ndarray = wanted - spent
    return added


def _ratios(means: np.ndarray, variances: np.ndarray, best: int) -> np.ndarray:
    """Return the shares of trials, (n,) float64, in units of the second best's."""
    others = np.arange(len(means)) != best
    difference = means[best] - means
    difference = np.maximum(difference, LEAST * max(difference.max(), LEAST))
    second = int(np.argmin(np.where(others, difference, np.inf)))
    signal = difference[second] / difference
    ratios: np.ndarray = signal * signal * (variances / variances[second])
    squares = ratios[others] * ratios[others] / variances[others]
    ratios[best] = np.sqrt(variances[best] * total(squares))
    return ratios
