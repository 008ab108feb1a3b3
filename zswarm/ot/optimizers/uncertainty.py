"""Uncertainty handling: evaluate candidates as often as their order needs.

Source: N. Hansen, A. S. P. Niederberger, L. Guzzella, P. Koumoutsakos, "A Method for Handling
Uncertainty in Evolutionary Optimization With an Application to Feedback Control of Combustion",
IEEE Transactions on Evolutionary Computation 13(1), 2009 (UH-CMA-ES), with its constants. Some
candidates are evaluated again. If that changes their ranks by more than is acceptable, all are
evaluated more often in the next generation, else less often. Maths, and what differs:
docs/optimizers.md.

``effort`` is the number of evaluations of each candidate, not rounded.
"""

from typing import Annotated, NamedTuple

import numpy as np

from zswarm.config.meta import within
from zswarm.kernels.sums import mean, total

AGAIN, LEAST_AGAIN = 10, 2  # one in ten is evaluated again, two at least
MORE = 1.5  # factor of the effort
ACCEPTED = 0.2  # of the median rank change of candidates in random order

Evaluations = Annotated[
    int,
    within(
        1,
        1_000,
        "most evaluations of a candidate in a generation, each on further seeds: as many as noise "
        "needs ([optimizers.md](optimizers.md#noise)); 1: one, and noise is not measured",
    ),
]


class Judged(NamedTuple):
    """What a generation showed."""

    fitness: np.ndarray  # (candidates,) means; NaN: all evaluations failed
    noise: float  # above 0: ranks change more than is acceptable


def again(count: int) -> int:
    """Return how many of some candidates are evaluated again: the first ones."""
    return min(count, max(LEAST_AGAIN, count // AGAIN))


def rows(count: int, effort: float) -> np.ndarray:
    """Return which candidates are asked for, in their order: int64 indices below ``count``."""
    repeats = int(effort)
    return np.concatenate(
        [np.tile(np.arange(size), repeats) for size in (count, again(count))]
    )


def judge(fitness: np.ndarray, count: int, effort: float) -> Judged:
    """Return the mean of each candidate's evaluations, and how uncertain their order is.

    Args:
        fitness: of the candidates that ``rows`` names.
    """
    repeats, some = int(effort), again(count)
    first = fitness[: count * repeats].reshape(repeats, count)
    second = fitness[count * repeats :].reshape(repeats, some)
    old, new = _means(first), _means(second)
    means = old.copy()
    means[:some] = _means(np.concatenate([first[:, :some], second]))
    after = np.concatenate([new, old[some:]])
    return Judged(means, _noise(old, after, some))


def adapted(effort: float, noise: float, most: int) -> float:
    """Return the effort of the next generation."""
    return min(float(most), effort * MORE) if noise > 0.0 else max(1.0, effort / MORE)


def _means(fitness: np.ndarray) -> np.ndarray:
    """Return the mean of each column, (candidates,); failed evaluations do not count."""
    known = ~np.isnan(fitness)
    added, counts = total(np.where(known, fitness, 0.0)), np.count_nonzero(known, axis=0)
    means: np.ndarray = np.where(counts > 0, added / np.maximum(counts, 1), np.nan)
    return means


def _noise(old: np.ndarray, new: np.ndarray, some: int) -> float:
    """Return the mean excess of the rank changes of the first candidates over what is accepted."""
    both = np.concatenate([old, new])
    both[np.isnan(both)] = -np.inf
    ordered = np.sort(both)
    below, upto = (np.searchsorted(ordered, both, side) for side in ("left", "right"))
    before, after = ((below + upto + 1) / 2.0).reshape(2, -1)[:, :some]  # 1, 2, ...
    way = np.sign(after - before)
    changes = np.abs(after - before - way)  # how many are between
    limits = [
        _accepted(rank - above, len(both))
        for ranks, sign in ((after, way), (before, -way))
        for rank, above in zip(ranks, sign > 0, strict=True)
    ]
    return mean(2.0 * changes - total(np.array(limits).reshape(2, -1)))


def _accepted(rank: float, count: int) -> float:
    """Return the rank change that is accepted at a rank, of candidates and their repetitions."""
    changes = np.sort(np.abs(np.arange(1, count) - rank))
    return float(changes[int(ACCEPTED / 2 * (count - 2))])
