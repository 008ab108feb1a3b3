"""Compare groups of runs: medians and quartiles, and test differences for significance.

The size of an effect is Vargha and Delaney's A12 (2000).
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis import curves
from zswarm.ot.analysis.curves import Groups, Series
from zswarm.ot.analysis.effect_size import LEVEL, UNCLEAR
from zswarm.ot.analysis.grouping import in_problem
from zswarm.ot.analysis.importance import Importance, of_groups
from zswarm.ot.analysis.measure import FITNESS, HELD_OUT, SEARCH, source, words
from zswarm.ot.analysis.significance import Family, Pair, p_values, within
from zswarm.system.format import plural

By = Literal["generations", "evaluations", "simulations"]
UNEQUAL = 1.1  # ratio of evaluations from which on a note warns
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
    problem: str = ""  # as in ``Family``


class Comparison(NamedTuple):
    """All groups, and the pairs of each problem."""

    by: By | None  # that all runs of a problem have, compared there; None: whole runs are
    rows: list[Row]
    pairs: list[Pair]
    families: list[Family]  # one for each problem
    notes: list[str]  # for the reader of the numbers
    measure: str = SEARCH
    importance: Importance | None = None  # of settings, if there are several groups

    @property
    def of(self) -> str:
        """Return what is compared."""
        return f"{words(self.measure)}{source(self.measure)}"

    @property
    def of_search(self) -> bool:
        """Return whether fitness in search is compared, next to which held-out fitness is shown."""
        return self.measure == SEARCH

    @property
    def untested(self) -> list[tuple[str, str]]:
        """Return problems whose pairs are not tested, such as " (foraging)" or "", and why."""
        return [
            (in_problem(family.problem), family.untested)
            for family in self.families
            if family.untested
        ]


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
    """Compare groups at the largest number of ``by`` that all runs of a problem have.

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
    ends: dict[str, set[float]] = {}
    for run in runs:
        last = float(curves.positions(run, axis)[-1])
        ends.setdefault(run.problem, set()).add(last)
    at = {problem: min(found) for problem, found in ends.items()}
    samples = {
        group: _sample(members, axis, at[members[0].problem])
        for group, members in started.items()
    }
    rows = [_row(group, sample, started[group]) for group, sample in samples.items()]
    values = {name: sample.best for name, sample in samples.items()}
    notes = [*notes, *_notes(samples, rows, by, ends)]
    found = _compared(by, rows, values, notes, SEARCH, settings)
    families = [family._replace(at=at[family.problem]) for family in found.families]
    return found._replace(families=families)


def of_values(
    values: Mapping[str, np.ndarray],
    groups: Groups,
    measure: str,
    notes: Sequence[str] = (),
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> Comparison:
    """Compare groups by one number of each run, at the ends of the runs.

    Args:
        values: by group, (runs,) float64, higher is better.
        groups: with the same names, for the effort.
        measure: what the numbers are: ``held-out``, ``fitness`` or a metric.
        settings: of each group, by keys, for their importance.
    """
    samples = {}
    for group, numbers in values.items():
        ends = [_effort(run, -1) for run in groups[group]]
        samples[group] = _Sample(numbers, *np.array(ends, np.float64).reshape(-1, 3).T)
    rows = [_row(group, sample, groups[group]) for group, sample in samples.items()]
    notes = [*notes, *_notes(samples, rows, None, {})]
    return _compared(None, rows, values, notes, measure, settings)


def explanation(found: Comparison) -> str:
    """Return what the numbers of the groups are."""
    unit = effort_unit(found.rows)
    what = f"Compared: {found.of}"
    costs = f"{unit} and time are the medians of its runs."
    if found.by is not None:
        points = {one.problem: after(found, one.problem) for one in found.families}
        if len(set(points.values())) > 1:
            points = {name: text + in_problem(name) for name, text in points.items()}
        what += f", of each run{','.join(dict.fromkeys(points.values()))}"
        costs = (
            "Held-out is what the champions of finished runs do on seeds that search did not use; "
            f"it, {costs}"
        )
    else:
        costs = costs.capitalize()
    better = "; higher is better" if found.measure in (SEARCH, HELD_OUT, FITNESS) else ""
    return (
        f"{what}{better}. Half of a group's runs are above the median, and half lie between the "
        f"quartiles. {costs}"
    )


def after(found: Comparison, problem: str) -> str:
    """Return where the runs of a problem are compared: `` after 60 generations``, or ""."""
    at = next(family.at for family in found.families if family.problem == problem)
    if found.by is None or at is None:
        return ""
    return f" after {at:,.0f} {found.by if at != 1 else found.by.removesuffix('s')}"


def describe(pair: Pair, measure: str) -> str:
    """Describe the result of a test in plain words."""
    better, worse, chance = ordered(pair)
    if pair.p_holm >= LEVEL:
        return (
            f"{pair.first} vs. {pair.second}: no significant difference ({p_values(pair)}); it may "
            "be chance, or more runs are needed"
        )
    verb = f"has a higher mean of {measure} than"
    if measure == SEARCH:  # which luck is a part of
        verb = "has a higher best fitness in search than"
    elif measure in (HELD_OUT, FITNESS):
        verb = "is better than"
    known = f" ({pair.effect} effect)" if pair.effect != UNCLEAR else ""
    size = f"A12 = {chance:.2f}{known}"
    return f"{better} {verb} {worse}: {size}, {p_values(pair)}"


def ordered(pair: Pair) -> tuple[str, str, float]:
    """Return the group with the higher numbers, the other, and A12 of the first of them."""
    if pair.a12 < 0.5:
        return pair.second, pair.first, 1.0 - pair.a12
    return pair.first, pair.second, pair.a12


def _compared(
    by: By | None,
    rows: list[Row],
    values: Mapping[str, np.ndarray],
    notes: list[str],
    measure: str,
    settings: Mapping[str, Mapping[str, Any]] | None,
) -> Comparison:
    """Add the tests and the importance of settings."""
    pairs, families = within({row.group: row.problem for row in rows}, values)
    explained = of_groups(settings, values) if settings and len(values) > 1 else None
    return Comparison(by, rows, pairs, families, notes, measure, explained)


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
    problem = runs[0].problem
    return Row(group, len(sample.best), *best, *spent, held_out, simulations, problem)


def effort_unit(rows: Sequence[Row]) -> Literal["evaluations", "simulations"]:
    """Return what the groups' effort is counted in: simulations if evaluations differ in trials."""
    trials = {round(row.simulations / row.evaluations) for row in rows if row.evaluations}
    return "simulations" if len(trials) > 1 else "evaluations"


def _notes(
    samples: Mapping[str, _Sample],
    rows: Sequence[Row],
    by: By | None,
    ends: Mapping[str, set[float]],
) -> list[str]:
    """Return notes on the effort and on failures.

    Args:
        by: None: whole runs are compared.
        ends: of the runs of each problem.
    """
    notes, unit = [], effort_unit(rows)
    for problem, lengths in ends.items() if by == "generations" else ():
        if len(lengths) > 1:
            least = plural(int(min(lengths)), "generation")
            notes.append(
                f"runs{in_problem(problem)} are of unequal length: compared after {least}, which "
                "all have"
            )
    if by != unit and _unequal(rows, unit):
        what = "gives a comparison" if by else "compares the best fitness in search"
        notes.append(
            f"the groups used different numbers of {unit}; compare --by {unit} {what} at equal "
            "effort"
        )
    if any(np.isneginf(sample.best).any() for sample in samples.values()):
        notes.append("runs in which every candidate failed count as the worst")
    return notes


def _unequal(rows: Sequence[Row], unit: str) -> bool:
    """Return whether groups of the same problem used different numbers of these."""
    spent: dict[str, list[float]] = {}
    for row in rows:
        spent.setdefault(row.problem, []).append(getattr(row, unit))
    return any(max(found) > UNEQUAL * min(found) for found in spent.values())
