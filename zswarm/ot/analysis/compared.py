"""Compare groups of recorded runs by what the user names."""

from collections.abc import Mapping, Sequence

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis import comparison, curves, effect_size, importance, measure
from zswarm.ot.analysis.comparison import By, Comparison
from zswarm.ot.analysis.effect_size import Friedman
from zswarm.ot.analysis.figures import EACH
from zswarm.ot.analysis.grouping import flat
from zswarm.ot.analysis.measure import SEARCH
from zswarm.ot.record.reader import Run

PROBLEM = "problem."
UNASSESSED = (
    "no champion was assessed on held-out seeds: where trials differ by seed, zswarm-ot evaluate "
    "FOLDER plays all champions on the same seeds, and compare --measure fitness compares them"
)


def compare(groups: Mapping[str, Sequence[Run]], by: By | None, of: str) -> Comparison:
    """Compare groups.

    Args:
        by: None: what all runs have a budget of, else generations.
        of: ``search``, ``held-out``, ``fitness`` or a metric.

    Raises:
        ConfigError: runs cannot be compared, or have no such number.
    """
    settings = {group: flat(members[0].experiment) for group, members in groups.items()}
    runs = [run for members in groups.values() for run in members]
    if of == SEARCH:
        loaded, notes = curves.load(groups)
        found = comparison.of_series(loaded, by or usual(runs), notes, settings)
        finished = [run for run in runs if run.finished]
        if finished and all(run.held_out is None for run in finished):
            found = found._replace(notes=[*found.notes, UNASSESSED])
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
    return comparison.of_values(values, loaded, measure.words(of), notes, settings)


def usual(runs: Sequence[Run]) -> By:
    """Return what all runs have a budget of, else generations."""
    limits = [run.experiment.stop for run in runs]
    if all(stop.simulations for stop in limits):
        return "simulations"
    return "evaluations" if all(stop.evaluations for stop in limits) else "generations"


def numbers(
    groups: Mapping[str, Sequence[Run]], of: str
) -> tuple[dict[str, np.ndarray], str, list[str]]:
    """Return one number of each run by group, what it is, and notes on omitted runs."""
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
        f"best fitness, {EACH}",
        notes,
    )


def over_problems(
    groups: Mapping[str, Sequence[Run]], found: Comparison
) -> Friedman | None:
    """Rank methods over the problems of a comparison; None if there are too few."""
    medians: dict[str, dict[str, float]] = {}
    rows = {row.group: row for row in found.rows}
    names: dict[str, str] = {}
    for group, members in groups.items():
        if group not in rows:
            continue
        values = flat(members[0].experiment)
        problem = {key: value for key, value in values.items() if key.startswith(PROBLEM)}
        method = repr(
            sorted((key, value) for key, value in values.items() if key not in problem)
        )
        names.setdefault(method, group)
        median = rows[group].median
        row = medians.setdefault(repr(sorted(problem.items())), {})
        row[method] = -np.inf if median is None else median
    ranked = effect_size.friedman(medians)
    if ranked is None:
        return None
    return ranked._replace(ranks={names[key]: rank for key, rank in ranked.ranks.items()})
