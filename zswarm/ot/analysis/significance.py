"""Whether a difference between groups of runs may be chance.

Tests: Mann-Whitney U on one number of each run (Mann and Whitney 1947), Kruskal-Wallis over more
than two groups, Holm's correction for many pairs (Holm 1979). Groups are tested within each problem
only: fitness of different problems does not compare. Only the tests need scipy.
"""

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis.effect_size import LEVEL, a12_interval, effect
from zswarm.system.extras import need

MAX_PAIRS = 1000  # of a problem
EXACT = 50  # runs of a group up to which the exact distribution is computed
KRUSKAL = 5  # runs of each group from which on its asymptotic distribution is accurate


class Pair(NamedTuple):
    """Two groups, tested."""

    first: str
    second: str
    u: float  # Mann-Whitney's U of the first
    p: float  # two-sided
    p_holm: float  # corrected for the number of pairs of the problem
    a12: float  # probability that a run of the first beats one of the second, ties count half
    method: str  # exact or asymptotic
    a12_low: float = 0.0  # 95 % interval
    a12_high: float = 1.0
    problem: str = ""  # as in ``Family``

    @property
    def delta(self) -> float:
        """Cliff's delta."""
        return 2 * self.a12 - 1

    @property
    def effect(self) -> str:
        """The size of the effect in a word."""
        return effect(self.a12, self.a12_low, self.a12_high)

    def as_object(self) -> dict[str, Any]:
        """Return what is reported to programs."""
        return {**self._asdict(), "delta": self.delta, "effect": self.effect}


class Family(NamedTuple):
    """The groups of a problem, whose pairs are tested and corrected together."""

    problem: str  # "": there is only one
    kruskal_p: float | None  # over more than two groups, if they are large enough
    untested: str  # why no pair is tested, or ""
    at: float | None = None  # where runs are compared, as in ``Comparison.by``


def within(
    problems: Mapping[str, str], samples: Mapping[str, np.ndarray]
) -> tuple[list[Pair], list[Family]]:
    """Test the groups of each problem with each other.

    Args:
        problems: by group; all "" if there is only one.
        samples: by group, (runs,) float64, higher is better.
    """
    pairs, families = [], []
    for problem in dict.fromkeys(problems[group] for group in samples):
        together = {
            group: sample
            for group, sample in samples.items()
            if problems[group] == problem
        }
        tested, kruskal_p, untested = _test(together)
        if problem and len(together) == 1:
            untested = "it is the only group of its problem"
        pairs += [pair._replace(problem=problem) for pair in tested]
        families.append(Family(problem, kruskal_p, untested))
    return pairs, families


def runs_needed(pairs: int = 1) -> int:
    """Return how many runs per group a significant difference takes at least."""
    return next(n for n in itertools.count(2) if pairs * _least_p(n, n) < LEVEL)


def p_value(p: float) -> str:
    """Format a probability as papers print it: ``p = 0.012``, ``p < 0.001``."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}" if p >= 0.1 else f"p = {p:.3f}"


def p_values(pair: Pair) -> str:
    """Format the p-value of a pair, and the one corrected for several pairs if it differs."""
    text, adjusted = p_value(pair.p), p_value(pair.p_holm)
    return text if pair.p == pair.p_holm else f"{text}, Holm-adjusted {adjusted}"


def disagreement(family: Family, pairs: Sequence[Pair]) -> str:
    """Explain a significant test over all groups without a significant pair; else return "".

    Args:
        pairs: of all problems.
    """
    tested = [pair for pair in pairs if pair.problem == family.problem]
    if (
        family.kruskal_p is None
        or family.kruskal_p >= LEVEL
        or not tested
        or any(pair.p_holm < LEVEL for pair in tested)
    ):
        return ""
    return (
        "That some group differs is shown, but not which: the test of each pair, corrected for "
        "their number, is stricter. More runs may show it."
    )


def _test(samples: Mapping[str, np.ndarray]) -> tuple[list[Pair], float | None, str]:
    """Return the pairs, p over all groups, and why there is no test."""
    if len(samples) < 2:
        return [], None, ""
    pairs = list(itertools.combinations(samples, 2))
    sizes = {group: len(sample) for group, sample in samples.items()}
    smallest, count = min(sizes.values()), len(pairs)
    untested = ""
    if count > MAX_PAIRS:
        untested = (
            f"{len(samples)} groups make {count} pairs; at most {MAX_PAIRS} are tested: "
            "compare fewer groups"
        )
    elif all(count * _least_p(sizes[a], sizes[b]) >= LEVEL for a, b in pairs):
        untested = (
            f"a difference between two groups can be shown with {runs_needed(count)} or more runs "
            f"of each; the smallest here has {smallest}"
        )
    overall = len(samples) > 2 and smallest >= KRUSKAL
    if untested and not overall:
        return [], None, untested
    try:
        stats = need("scipy.stats", "plot", "the test between groups")
    except ConfigError as error:
        return [], None, str(error)
    tested = []
    if not untested:
        tested = [_mann_whitney(stats, a, samples[a], b, samples[b]) for a, b in pairs]
    corrected = _holm([pair.p for pair in tested])
    tested = [pair._replace(p_holm=p) for pair, p in zip(tested, corrected, strict=True)]
    return tested, _kruskal(stats, list(samples.values())) if overall else None, untested


def _mann_whitney(
    stats: Any, first: str, a: np.ndarray, second: str, b: np.ndarray
) -> Pair:
    ranks = stats.rankdata(np.concatenate([a, b]))  # scipy's test does not take -inf
    m, n = len(a), len(b)
    u = float(ranks[:m].sum()) - m * (m + 1) / 2
    a12 = u / (m * n)
    if max(m, n) <= EXACT or len(np.unique(ranks)) == 1:
        method, p = "exact", _exact_p(ranks, m)
    else:
        method = "asymptotic"
        found = stats.mannwhitneyu(
            ranks[:m], ranks[m:], alternative="two-sided", method=method
        )
        p = min(1.0, float(found.pvalue))
    return Pair(first, second, u, p, 1.0, a12, method, *a12_interval(a12, m, n))


def _exact_p(ranks: np.ndarray, m: int) -> float:
    """Return the two-sided p of the first ``m`` ranks' sum, over all ways to choose ``m``."""
    if len(np.unique(ranks)) == 1:
        return 1.0
    whole = np.rint(2 * ranks).astype(int)  # the ranks of ties are halves
    some = whole[:m] if 2 * m <= len(whole) else whole[m:]
    ways, seen = _ways(tuple(sorted(whole.tolist())), len(some)), int(some.sum())
    tail = min(float(ways[: seen + 1].sum()), float(ways[seen:].sum()))
    return min(1.0, 2 * tail / float(ways.sum()))


@functools.lru_cache(maxsize=8)
def _ways(ranks: tuple[int, ...], count: int) -> np.ndarray:
    """Return by their sum in how many ways ``count`` of the ranks can be chosen."""
    most = sum(ranks[-count:])
    ways = np.zeros((count + 1, most + 1))
    ways[0, 0] = 1.0
    for rank in ranks:
        ways[1:, rank:] += ways[:-1, : most + 1 - rank].copy()
    chosen: np.ndarray = ways[count]
    return chosen


def _kruskal(stats: Any, samples: Sequence[np.ndarray]) -> float:
    ranks = stats.rankdata(np.concatenate(samples))
    if len(np.unique(ranks)) == 1:
        return 1.0
    parts = np.split(ranks, np.cumsum([len(sample) for sample in samples])[:-1])
    return float(stats.kruskal(*parts).pvalue)


def _holm(p: Sequence[float]) -> list[float]:
    """Multiply the k-th smallest of m by m - k + 1; the results never decrease."""
    corrected, least = [0.0] * len(p), 0.0
    for place, index in enumerate(sorted(range(len(p)), key=lambda index: p[index])):
        least = max(least, min(1.0, (len(p) - place) * p[index]))
        corrected[index] = least
    return corrected


def _least_p(m: int, n: int) -> float:
    """Return the smallest two-sided p: all runs of one group beat all of the other."""
    return 2 / math.comb(m + n, m)
