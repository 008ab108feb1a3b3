"""Groups of runs beside each other: medians and quartiles, and whether a difference may be chance.

Tests: Mann-Whitney U on the runs' best fitness (Mann and Whitney 1947), Kruskal-Wallis over all of more than two groups,
Holm's correction for many pairs (Holm 1979); the size of an effect is Vargha and Delaney's A12 (2000). scipy is needed for
the tests only.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.ot import curves
from zswarm.ot.curves import Series
from zswarm.ot.terminal import plural

if TYPE_CHECKING:
    from zswarm.ot.reading import Run

By = Literal["generations", "evaluations"]
LEVEL = 0.05  # of significance
PERMUTATIONS = 15_000  # at most, where ties forbid the exact distribution
MAX_PAIRS = 1000  # that are tested
EXACT = 100  # runs of a group up to which the distribution without ties is computed exactly
KRUSKAL = 5  # runs of each group from which on its distribution is near enough
UNEQUAL = 1.1  # groups whose evaluations differ more are no equals in effort
EFFECTS = ((0.56, "negligible"), (0.64, "small"), (0.71, "medium"))  # Vargha and Delaney; above: large
SCORES = (
    "candidates of these runs played each other: their fitness is a score, which compares within one generation only; zswarm-ot "
    "evaluate RUN --against RUN has two champions play each other"
)


class Row(NamedTuple):
    """A group. Fitness is the best of each run at the point that is compared; None: failed candidates only."""

    group: str
    runs: int
    median: float | None
    q25: float | None
    q75: float | None
    best: float | None
    worst: float | None
    evaluations: float  # of a run up to there, the median
    seconds: float  # of a run up to there, the median


class Pair(NamedTuple):
    """Two groups, tested."""

    first: str
    second: str
    u: float  # Mann-Whitney's U of the first
    p: float  # two-sided
    p_holm: float  # corrected for the number of pairs
    a12: float  # chance that a run of the first is better than one of the second, ties by half
    method: str  # exact, permutation or asymptotic


class Comparison(NamedTuple):
    """All of it."""

    by: By
    at: float  # generations or evaluations
    rows: list[Row]
    pairs: list[Pair]
    kruskal_p: float | None  # over all, of more than two groups that are large enough
    untested: str  # why there is no test, or ""
    notes: list[str]  # what a reader should know of the numbers


class _Sample(NamedTuple):
    best: np.ndarray  # (runs,)
    evaluations: np.ndarray
    seconds: np.ndarray


def summary(groups: Mapping[str, Sequence["Run"]], by: By = "generations") -> list[Row]:
    """A row per group, at the largest number of generations (or evaluations) that all runs have.

    Raises:
        ConfigError: no run finished a generation, or there is no such number.
    """
    return compare(groups, by, tests=False).rows


def compare(groups: Mapping[str, Sequence["Run"]], by: By = "generations", *, tests: bool = True) -> Comparison:
    """The groups beside each other, and the tests between them.

    Raises:
        ConfigError: no run finished a generation, there is no number of evaluations that all have, or fitness does not compare.
    """
    loaded, notes = curves.load(groups)
    return of_series(loaded, by, notes, tests=tests)


def of_series(groups: Mapping[str, Sequence[Series]], by: By, notes: Sequence[str] = (), *, tests: bool = True) -> Comparison:
    """As ``compare``, of runs that are read already."""
    begun = {group: [run for run in runs if len(run.best)] for group, runs in groups.items()}
    begun = {group: runs for group, runs in begun.items() if runs}
    if not begun:
        raise ConfigError("no run finished a generation yet: there is nothing to compare")
    everyone = [run for runs in begun.values() for run in runs]
    if any(run.relative for run in everyone):
        raise ConfigError(SCORES)
    ends = {float(len(run.best) if by == "generations" else run.evaluations[-1]) for run in everyone}
    at = min(ends)
    samples = {group: _sample(runs, by, at) for group, runs in begun.items()}
    rows = [_row(group, sample) for group, sample in samples.items()]
    told = list(notes)
    if by == "generations" and len(ends) > 1:
        told.append(f"runs are of unequal length: compared after {plural(int(at), 'generation')}, which all have")
    spent = [row.evaluations for row in rows]
    if by == "generations" and max(spent) > UNEQUAL * min(spent):
        told.append(
            "groups took different numbers of evaluations; zswarm-ot compare --by evaluations tells what each had after as many"
        )
    if any(np.isneginf(sample.best).any() for sample in samples.values()):
        told.append("runs in which every candidate failed count as the worst")
    pairs, kruskal_p, untested = _test({group: sample.best for group, sample in samples.items()}) if tests else ([], None, "")
    return Comparison(by, at, rows, pairs, kruskal_p, untested, told)


def effect(a12: float) -> str:
    """What the size of an effect is called."""
    size = max(a12, 1.0 - a12)
    return next((name for bound, name in EFFECTS if size < bound), "large")


def in_words(pair: Pair) -> str:
    """A tested pair for people who are no statisticians."""
    better, worse, chance = (pair.first, pair.second, pair.a12) if pair.a12 >= 0.5 else (pair.second, pair.first, 1.0 - pair.a12)
    if pair.p_holm < LEVEL:
        return (
            f"{better} is better than {worse}: a run of it wins with {100 * chance:.0f} % ({effect(chance)} effect); "
            f"were they equal, chance would give this much in {share(pair.p_holm)} of experiments"
        )
    return f"no difference between {pair.first} and {pair.second} is shown: it may be chance, or more runs are needed"


def reconciling(found: Comparison) -> str:
    """Where the test over all groups and those of pairs seem to disagree, what that means; else ""."""
    if found.kruskal_p is None or not found.pairs:
        return ""
    shown = any(pair.p_holm < LEVEL for pair in found.pairs)
    if found.kruskal_p < LEVEL and not shown:
        return (
            "That some group differs is shown, but not which: the test of each pair, corrected for their number, asks for more. "
            "More runs may tell."
        )
    return ""


def share(p: float) -> str:
    """A probability as a share."""
    return "less than 0.1 %" if p < 0.001 else f"{100 * p:.2g} %"


def p_value(p: float) -> str:
    """As papers print it: ``p = 0.012``, ``p < 0.001``."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}" if p >= 0.1 else f"p = {p:.3f}"


def runs_needed(pairs: int = 1) -> int:
    """Runs of each group with which a difference can be shown at all, with so many pairs."""
    return next(n for n in itertools.count(2) if pairs * _least_p(n, n) < LEVEL)


def _sample(runs: Sequence[Series], by: By, at: float) -> _Sample:
    found = []
    for run in runs:
        last = int(at) - 1 if by == "generations" else int(np.searchsorted(run.evaluations, at, side="right")) - 1
        if last < 0:
            raise ConfigError(
                f"no number of evaluations is common to all runs: one has {at:.0f} in all, another's first generation more"
            )
        found.append((run.best[last], run.evaluations[last], run.seconds[last]))
    return _Sample(*np.array(found).T)


def _row(group: str, sample: _Sample) -> Row:
    low, median, high = curves.quartiles(sample.best)
    return Row(
        group=group,
        runs=len(sample.best),
        median=_number(median),
        q25=_number(low),
        q75=_number(high),
        best=_number(sample.best.max()),
        worst=_number(sample.best.min()),
        evaluations=float(np.median(sample.evaluations)),
        seconds=float(np.median(sample.seconds)),
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _test(samples: Mapping[str, np.ndarray]) -> tuple[list[Pair], float | None, str]:
    """Pairs, p over all, and why there is no test."""
    if len(samples) < 2:
        return [], None, ""
    pairs = list(itertools.combinations(samples, 2))
    sizes = [len(sample) for sample in samples.values()]
    testable = any(_least_p(len(samples[a]), len(samples[b])) * len(pairs) < LEVEL for a, b in pairs)
    overall = len(samples) > 2 and min(sizes) >= KRUSKAL
    few = ""
    if len(pairs) > MAX_PAIRS:
        testable, few = (
            False,
            f"{len(samples)} groups make {len(pairs)} pairs; at most {MAX_PAIRS} are tested: compare fewer groups",
        )
    elif not testable:
        few = (
            f"a difference between two groups can be shown with {runs_needed(len(pairs))} or more runs of each; "
            f"the smallest here has {min(sizes)}"
        )
    if not testable and not overall:
        return [], None, few
    try:
        stats = need("scipy.stats", "plot", "the test between groups")
    except ConfigError as error:
        return [], None, str(error)
    tested = [_mann_whitney(stats, a, samples[a], b, samples[b]) for a, b in pairs] if testable else []
    corrected = _holm([pair.p for pair in tested])
    tested = [pair._replace(p_holm=p) for pair, p in zip(tested, corrected, strict=True)]
    return tested, _kruskal(stats, list(samples.values())) if overall else None, few


def _mann_whitney(stats: Any, first: str, a: np.ndarray, second: str, b: np.ndarray) -> Pair:
    everything = np.concatenate([a, b])
    ranks = stats.rankdata(everything)  # of -inf, too
    a, b = ranks[: len(a)], ranks[len(a) :]
    ties = len(np.unique(ranks)) < len(ranks)
    if len(np.unique(ranks)) == 1:
        return Pair(first, second, len(a) * len(b) / 2, 1.0, 1.0, 0.5, "exact")
    if not ties and max(len(a), len(b)) <= EXACT:
        name: str = "exact"
        method: Any = "exact"
    elif ties and math.comb(len(ranks), len(a)) <= PERMUTATIONS:
        name, method = "permutation", stats.PermutationMethod(n_resamples=PERMUTATIONS)  # so many: all there are
    else:
        name = method = "asymptotic"
    result = stats.mannwhitneyu(a, b, alternative="two-sided", method=method)
    u = float(result.statistic)
    return Pair(first, second, u, min(1.0, float(result.pvalue)), 1.0, u / (len(a) * len(b)), name)


def _kruskal(stats: Any, samples: Sequence[np.ndarray]) -> float:
    ranks = stats.rankdata(np.concatenate(samples))
    if len(np.unique(ranks)) == 1:
        return 1.0
    parts = np.split(ranks, np.cumsum([len(sample) for sample in samples])[:-1])
    return float(stats.kruskal(*parts).pvalue)


def _holm(p: Sequence[float]) -> list[float]:
    """Holm's step-down: the k-th smallest of m is multiplied by m - k + 1; none becomes smaller than one before it."""
    corrected, least = [0.0] * len(p), 0.0
    for place, index in enumerate(sorted(range(len(p)), key=lambda index: p[index])):
        least = max(least, min(1.0, (len(p) - place) * p[index]))
        corrected[index] = least
    return corrected


def _least_p(m: int, n: int) -> float:
    """The smallest two-sided p that so many runs can give: all of one are better than all of the other."""
    return 2 / math.comb(m + n, m)
