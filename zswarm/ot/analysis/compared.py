"""Compare groups of recorded runs by what the user names."""

from collections.abc import Mapping, Sequence

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis import comparison, curves, effect_size, importance, measure
from zswarm.ot.analysis.comparison import By, Comparison
from zswarm.ot.analysis.effect_size import Friedman
from zswarm.ot.analysis.grouping import flat, in_problem, method
from zswarm.ot.analysis.measure import HELD_OUT, SEARCH
from zswarm.ot.record.reader import Run

LUCK = "the best fitness in search is partly luck: "
ASSESSED = (
    f"{LUCK}compare --measure held-out compares what the champions do on other seeds"
)
UNASSESSED = (
    f"{LUCK}where trials differ by seed, zswarm-ot evaluate FOLDER plays all champions on the same "
    "held-out seeds, and compare --measure fitness compares them"
)


def compare(
    groups: Mapping[str, Sequence[Run]], by: By | None = None, of: str | None = None
) -> Comparison:
    """Compare groups; the tests are within each problem.

    Args:
        by: None: what all runs have a budget of, else generations.
        of: ``search``, ``held-out``, ``fitness`` or a metric; None: ``search`` with ``by``, else
            as ``measure.usual``.

    Raises:
        ConfigError: runs cannot be compared, or have no such number.
    """
    settings = {group: flat(members[0].experiment) for group, members in groups.items()}
    runs = [run for members in groups.values() for run in members]
    if of is None:
        of = SEARCH if by else measure.usual(runs)
    if of == SEARCH:
        loaded, notes = curves.load(groups)
        found = comparison.of_series(loaded, by or usual(runs), notes, settings)
        finished = [run for run in runs if run.finished]
        if finished:
            assessed = measure.usual(finished) == HELD_OUT
            hint = ASSESSED if assessed else UNASSESSED
            found = found._replace(notes=[*found.notes, hint])
        if len(finished) == len(runs):
            return found
        why = "not all of the runs are finished"
        return found._replace(
            importance=found.importance and importance.without(len(runs), why)
        )
    if by is not None:
        raise ConfigError(
            f"--by {by} compares the fitness in search; --measure {of} is of whole runs"
        )
    values, counted, left_out = measure.values(groups, of)
    loaded, notes = curves.load(counted, search=False)
    if any(len(loaded[group]) != len(members) for group, members in counted.items()):
        counted = {
            group: curves.distinct(members)[0] for group, members in counted.items()
        }
        values, _, _ = measure.values(counted, of)
    notes = [*left_out, *notes]
    return comparison.of_values(values, loaded, of, notes, settings)


def usual(runs: Sequence[Run]) -> By:
    """Return what all runs have a budget of, else generations."""
    limits = [run.experiment.stop for run in runs]
    if all(stop.simulations for stop in limits):
        return "simulations"
    return "evaluations" if all(stop.evaluations for stop in limits) else "generations"


def numbers(
    groups: Mapping[str, Sequence[Run]], of: str | None
) -> tuple[dict[str, np.ndarray], str, list[str]]:
    """Return one number of each run by group, what it is, and notes on omitted runs.

    Args:
        of: as for ``compare``.
    """
    of = of or measure.usual([run for members in groups.values() for run in members])
    if of != SEARCH:
        values, _, left_out = measure.values(groups, of)
        return values, measure.words(of), left_out
    loaded, notes = curves.load(groups)
    started = curves.started(loaded)
    return (
        {
            name: np.array([run.best[-1] for run in runs])
            for name, runs in started.items()
        },
        measure.words(of),
        notes,
    )


def over_problems(
    groups: Mapping[str, Sequence[Run]], found: Comparison
) -> Friedman | None:
    """Rank methods over the problems of a comparison; None if there are too few."""
    medians: dict[str, dict[str, float]] = {}
    names: dict[str, str] = {}
    for row in found.rows:
        key = repr(sorted(method(groups[row.group][0]).items()))
        names.setdefault(key, row.group.removesuffix(in_problem(row.problem)))
        median = -np.inf if row.median is None else row.median
        medians.setdefault(row.problem, {})[key] = median
    ranked = effect_size.friedman(medians)
    if ranked is None:
        return None
    return ranked._replace(ranks={names[key]: rank for key, rank in ranked.ranks.items()})
