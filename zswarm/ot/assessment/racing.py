"""Stop trials of candidates that are unlikely to be among the best of a generation.

All candidates play the same seeds, in rounds. After a round, the mean of each is compared with that
of the last one that may survive. A candidate that is worse by more than a standard error of the
difference of two means plays no further round. The error is that of a two-way layout, candidates
by seeds, pooled over the candidates (O. Maron, A. Moore, "The Racing Algorithm", Artificial
Intelligence Review 11, 1997; M. Birattari and others, "A Racing Algorithm for Configuring
Metaheuristics", GECCO 2002).
"""

import numpy as np

from zswarm.kernels.sums import total

ROUNDS = 5  # at most
FIRST = 2  # trials of each in the first round: fewer show no noise
LEAST = FIRST + 1  # trials of a candidate: with fewer there is nothing to save


def rounds(trials: int) -> list[int]:
    """Return after how many trials each round ends."""
    ends = {trials * number // ROUNDS for number in range(1, ROUNDS + 1)}
    return sorted({max(FIRST, end) for end in ends})


def remaining(fitness: np.ndarray, survivors: int) -> np.ndarray:
    """Return which candidates play on: (candidates,) bool.

    Args:
        fitness: (candidates, trials) float64 of all that they played; NaN: failed.
        survivors: how many candidates may survive.
    """
    count = fitness.shape[1]
    means = total(fitness.T) / count
    plays: np.ndarray = ~np.isnan(means)
    if np.count_nonzero(plays) <= survivors:
        return plays
    fitness, means = fitness[plays], means[plays]
    others = len(means) - 1
    seeds = total(fitness) / len(means)
    residuals = fitness - means[:, None] - seeds + total(seeds) / count
    variance = total((residuals * residuals).ravel()) / (others * (count - 1))
    bar = np.sort(means)[-survivors]
    plays[plays] = bar - means <= np.sqrt(2.0 * variance / count)
    return plays


def totals(fitness: np.ndarray, played: np.ndarray) -> np.ndarray:
    """Return the sum over all trials of each candidate, (candidates,) float64; NaN: failed.

    For those that were stopped it is an estimate: they stay as far behind the mean of those that
    played all trials as on the trials that they played. It is never above that of one of these.

    Args:
        fitness: (candidates, trials) float64.
        played: (candidates,) how many of these each has played, at least one.
    """
    trials = fitness.shape[1]
    sums = np.cumsum(fitness, axis=1)
    found = sums[np.arange(len(sums)), played - 1]
    stopped, whole = played < trials, (played == trials) & ~np.isnan(found)
    if whole.any():
        level = total(sums[whole]) / np.count_nonzero(whole)
        behind = (found - level[played - 1]) * (trials / played)
        estimate = np.minimum(level[-1] + behind, found[whole].min())
    else:
        estimate = found * (trials / played)
    whole_sums: np.ndarray = np.where(stopped, estimate, found)
    return whole_sums + 0.0  # SQLite drops the sign of -0.0
