"""Compare groups of runs: medians and quartiles, and whether a difference may be chance.

Tests: Mann-Whitney U on the best fitness of runs (Mann and Whitney 1947), Kruskal-Wallis over more
than two groups, Holm's correction for many pairs (Holm 1979). The size of an effect is Vargha and
Delaney's A12 (2000). Only the tests need scipy.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis import curves
from zswarm.ot.analysis.curves import Groups, Series
from zswarm.ot.analysis.effect_size import a12_interval
from zswarm.ot.analysis.importance import Importance, of_groups
from zswarm.system.extras import need
from zswarm.system.format import plural

By = Literal["generations", "evaluations", "simulations"]
LEVEL = 0.05  # of significance
SEARCH = "best fitness in search"
PERMUTATIONS = 15_000  # at most, if ties forbid the exact distribution
MAX_PAIRS = 1000
EXACT = 100  # runs of a group up to which the exact distribution is computed
KRUSKAL = 5  # runs of each group from which on its asymptotic distribution is accurate
UNEQUAL = 1.1  # ratio of evaluations from which on a note warns
# By A12; above, an effect is large.
EFFECTS = ((0.56, "negligible"), (0.64, "small"), (0.71, "medium"))
SCORES = (
    "candidates of these runs played each other: their fitness is a score, which compares within "
    "one generation only; zswarm-ot evaluate RUN --against RUN has two champions play each other"
)


class Row(NamedTuple):
    """A group: the best fitness of each run at the compared point. None: every candidate failed."""

    group: str
    runs: int
    median: float | None
    q25: float | None
    q75: float | None
    best: float | None
    worst: float | None
    evaluations: float  # per run up to that point, the median
    seconds: float  # likewise
    # Median of the champions' means on held-out seeds; None: no run was assessed.
    held_out: float | None
    simulations: float  # likewise


class Pair(NamedTuple):
    """Two groups, tested."""

    first: str
    second: str
    u: float  # Mann-Whitney's U of the first
    p: float  # two-sided
    p_holm: float  # corrected for the number of pairs
    a12: float  # probability that a run of the first beats one of the second, ties count half
    method: str  # exact, permutation or asymptotic
    a12_low: float = 0.0  # 95 % interval
    a12_high: float = 1.0

    @property
    def delta(self) -> float:
        """Cliff's delta."""
        return 2 * self.a12 - 1

    def as_object(self) -> dict[str, Any]:
        """Return what is reported to programs."""
        return {**self._asdict(), "delta": self.delta, "effect": effect(self.a12)}


class Comparison(NamedTuple):
    """All groups and pairs."""

    by: By
    at: float  # generations, evaluations or simulations
    rows: list[Row]
    pairs: list[Pair]
    # Over all groups, if there are more than two and large enough.
    kruskal_p: float | None
    untested: str  # why there is no test, or ""
    notes: list[str]  # for the reader of the numbers
    of: str = SEARCH  # what is compared
    importance: Importance | None = None  # of settings, if there are several groups


class _Sample(NamedTuple):
    best: np.ndarray  # (runs,)
    evaluations: np.ndarray
    simulations: np.ndarray
    seconds: np.ndarray


def of_series(
    groups: Groups,
    by: By,
    notes: Sequence[str] = (),
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> Comparison:
    """Compare groups at the largest number of generations, or of ``by``, that all runs have.

    Args:
        notes: of ``curves.load``, which return among those of the comparison.
        settings: of each group, by keys, for their importance.

    Raises:
        ConfigError: no run finished a generation, there is no such number, or fitness is relative.
    """
    started = curves.started(groups)
    if not started:
        raise ConfigError("no run finished a generation yet: there is nothing to compare")
    runs = [run for members in started.values() for run in members]
    if any(run.relative for run in runs):
        raise ConfigError(SCORES)
    axis: curves.Axis = "generation" if by == "generations" else by
    ends = {float(curves.positions(run, axis)[-1]) for run in runs}
    at = min(ends)
    samples = {group: _sample(members, axis, at) for group, members in started.items()}
    rows = [_row(group, sample, started[group]) for group, sample in samples.items()]
    values = {name: sample.best for name, sample in samples.items()}
    pairs, kruskal_p, untested = _test(values)
    notes = [*notes, *_notes(samples, rows, by, ends)]
    explained = of_groups(settings, values) if settings and len(values) > 1 else None
    return Comparison(
        by, at, rows, pairs, kruskal_p, untested, notes, importance=explained
    )


def of_values(
    values: Mapping[str, np.ndarray],
    groups: Groups,
    of: str,
    notes: Sequence[str] = (),
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> Comparison:
    """Compare groups by one number of each run, at the ends of the runs.

    Args:
        values: by group, (runs,) float64, higher is better.
        groups: with the same names, for the effort.
        of: what the numbers are.
        settings: of each group, by keys, for their importance.
    """
    samples = {}
    for group, numbers in values.items():
        ends = [_effort(run, -1) for run in groups[group]]
        samples[group] = _Sample(numbers, *np.array(ends, np.float64).reshape(-1, 3).T)
    rows = [_row(group, sample, groups[group]) for group, sample in samples.items()]
    pairs, kruskal_p, untested = _test(values)
    at = float(max(len(run.best) for runs in groups.values() for run in runs))
    explained = of_groups(settings, values) if settings and len(values) > 1 else None
    return Comparison(
        "generations", at, rows, pairs, kruskal_p, untested, list(notes), of, explained
    )


def effect(a12: float) -> str:
    """Name the size of an effect."""
    size = max(a12, 1.0 - a12)
    return next((name for bound, name in EFFECTS if size < bound), "large")


def describe(pair: Pair) -> str:
    """Describe the result of a test in plain words."""
    better, worse, chance = pair.first, pair.second, pair.a12
    if chance < 0.5:
        better, worse, chance = pair.second, pair.first, 1.0 - pair.a12
    if pair.p_holm < LEVEL:
        return (
            f"{better} is better than {worse}: A12 = {chance:.2f} ({effect(chance)} effect), "
            f"{p_values(pair)}"
        )
    return (
        f"{pair.first} vs. {pair.second}: no significant difference ({p_values(pair)}); it may be "
        "chance, or more runs are needed"
    )


def p_values(pair: Pair) -> str:
    """Format the p-value of a pair, and the one corrected for several pairs if it differs."""
    text, adjusted = p_value(pair.p), p_value(pair.p_holm)
    return text if pair.p == pair.p_holm else f"{text}, Holm-adjusted {adjusted}"


def disagreement(found: Comparison) -> str:
    """Explain a significant test over all groups without a significant pair; else return ""."""
    pairs_show = any(pair.p_holm < LEVEL for pair in found.pairs)
    if (
        found.kruskal_p is None
        or found.kruskal_p >= LEVEL
        or not found.pairs
        or pairs_show
    ):
        return ""
    return (
        "That some group differs is shown, but not which: the test of each pair, corrected for "
        "their number, is stricter. More runs may show it."
    )


def p_value(p: float) -> str:
    """Format a probability as papers print it: ``p = 0.012``, ``p < 0.001``."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}" if p >= 0.1 else f"p = {p:.3f}"


def runs_needed(pairs: int = 1) -> int:
    """Return how many runs per group a significant difference takes at least."""
    return next(n for n in itertools.count(2) if pairs * _least_p(n, n) < LEVEL)


def _sample(runs: Sequence[Series], axis: curves.Axis, at: float) -> _Sample:
    found = []
    for run in runs:
        last = curves.last_before(run, axis, at)
        if last < 0:
            raise ConfigError(
                f"no number of {axis} is common to all runs: one has {at:.0f} in all, "
                "another's first generation more"
            )
        found.append((run.best[last], *_effort(run, last)))
    return _Sample(*np.array(found).T)


def _effort(run: Series, last: int) -> tuple[float, float, float]:
    """Return evaluations, simulations and seconds up to the end of a generation."""
    evaluations = float(run.evaluations[last])
    return evaluations, evaluations * run.trials, float(run.seconds[last])


def _row(group: str, sample: _Sample, runs: Sequence[Series]) -> Row:
    spent = float(np.median(sample.evaluations)), float(np.median(sample.seconds))
    means = [run.held_out[0] for run in runs if run.held_out is not None]
    held_out = float(np.median(means)) if means else None
    simulations = float(np.median(sample.simulations))
    best = curves.spread(sample.best)
    return Row(group, len(sample.best), *best, *spent, held_out, simulations)


def effort_unit(rows: Sequence[Row]) -> Literal["evaluations", "simulations"]:
    """Return what the groups' effort is counted in: simulations if evaluations differ in trials."""
    trials = {round(row.simulations / row.evaluations) for row in rows if row.evaluations}
    return "simulations" if len(trials) > 1 else "evaluations"


def _notes(
    samples: Mapping[str, _Sample], rows: Sequence[Row], by: By, ends: set[float]
) -> list[str]:
    notes, unit = [], effort_unit(rows)
    spent = [getattr(row, unit) for row in rows]
    if by == "generations" and len(ends) > 1:
        least = plural(int(min(ends)), "generation")
        notes.append(
            f"runs are of unequal length: compared after {least}, which all have"
        )
    if by != unit and max(spent) > UNEQUAL * min(spent):
        notes.append(
            f"the groups used different numbers of {unit}; compare --by {unit} gives a "
            "comparison at equal effort"
        )
    if any(np.isneginf(sample.best).any() for sample in samples.values()):
        notes.append("runs in which every candidate failed count as the worst")
    return notes


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
    a, b = ranks[: len(a)], ranks[len(a) :]
    distinct = len(np.unique(ranks))
    if distinct == 1:
        half = len(a) * len(b) / 2
        interval = a12_interval(0.5, len(a), len(b))
        return Pair(first, second, half, 1.0, 1.0, 0.5, "exact", *interval)
    name = method = "asymptotic"
    if distinct == len(ranks) and max(len(a), len(b)) <= EXACT:
        name = method = "exact"
    elif distinct < len(ranks) and math.comb(len(ranks), len(a)) <= PERMUTATIONS:
        name, method = "permutation", stats.PermutationMethod(n_resamples=PERMUTATIONS)
    result = stats.mannwhitneyu(a, b, alternative="two-sided", method=method)
    u = float(result.statistic)
    a12, p = u / (len(a) * len(b)), min(1.0, float(result.pvalue))
    interval = a12_interval(a12, len(a), len(b))
    return Pair(first, second, u, p, 1.0, a12, name, *interval)


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
