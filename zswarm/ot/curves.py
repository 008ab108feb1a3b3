"""Runs as curves: how the best fitness rose, over generations, evaluations or time, of one run or of repeats together."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.terminal import plural
from zswarm.protocol.codec import clean

if TYPE_CHECKING:
    from zswarm.ot.reading import Run

Axis = Literal["generation", "evaluations", "time"]
POINTS = 1000  # of a drawn curve: more than a printed one shows


class Series(NamedTuple):
    """A run's numbers after each finished generation, (generations,) float64."""

    best: np.ndarray  # of the run so far; -inf where every candidate failed
    mean: np.ndarray  # of the generation's population; NaN where every candidate failed
    evaluations: np.ndarray  # of the run so far
    seconds: np.ndarray  # since the run's start, as it was computed
    relative: bool = False  # numbers are scores, which compare candidates of one generation only; best is of the generation


class Curve(NamedTuple):
    """A group of runs, at the points of ``x`` that all of them reached."""

    group: str
    runs: int
    x: np.ndarray  # (points,)
    median: np.ndarray  # (points,) of the runs' best fitness; of one run its best
    low: np.ndarray  # (points,) lower quartile
    high: np.ndarray  # (points,) upper quartile


def series(run: "Run") -> Series:
    """The numbers of a run that finished at least one generation; of another they are empty."""
    history = run.history()

    def column(key: str, missing: float) -> np.ndarray:
        return np.array([missing if row[key] is None else row[key] for row in history], np.float64)

    best = column("best", -np.inf)
    best = np.where(np.isfinite(best), best, -np.inf)
    seconds = np.nan_to_num(column("seconds", 0.0), posinf=0.0).clip(0.0)  # the clock of the wall may have been set back
    evaluations = np.maximum.accumulate(column("evaluations", 0.0))
    return Series(best, column("mean", np.nan), evaluations, np.cumsum(seconds), run.relative)


def load(groups: Mapping[str, Sequence["Run"]]) -> tuple[dict[str, list[Series]], list[str]]:
    """The numbers of all runs, each read once; and what a reader should know of them.

    That is: who is left out or not finished, and whether they have different problems.
    """
    loaded, notes = {}, problems(run for runs in groups.values() for run in runs)
    for group, runs in groups.items():
        counted, left_out = distinct(runs)
        loaded[group] = [series(run) for run in counted]
        notes += [*left_out, *unfinished(counted, loaded[group])]
    return loaded, notes


def distinct(runs: Iterable["Run"]) -> tuple[list["Run"], list[str]]:
    """The runs that a comparison counts, and why it leaves out the others.

    A run that is named twice, or that did the same as another bit by bit, is no second sample.
    """
    kept: dict[str, Run] = {}
    left_out = []
    for run in runs:
        key = run.history_hash or str(run.folder.resolve())
        if key in kept:
            if kept[key].folder.resolve() != run.folder.resolve():
                left_out.append(
                    f"{clean(str(run.folder))} is left out: its history is that of {clean(str(kept[key].folder))}, bit by bit"
                )
            continue
        kept[key] = run
    return list(kept.values()), left_out


def problems(runs: Iterable["Run"]) -> list[str]:
    """A line where the runs have different problems."""
    found = {json.dumps(_judged_by(run), sort_keys=True, default=str): _judged_by(run) for run in runs}
    simulators = sorted({clean(problem["simulator"]) for problem in found.values()})
    if len(simulators) > 1:
        return [f"runs of different problems ({', '.join(simulators)}): their fitness does not compare"]
    if len(found) > 1:
        keys = {key for problem in found.values() for key in problem}
        differing = sorted(key for key in keys if len({repr(problem.get(key)) for problem in found.values()}) > 1)
        return [f"runs whose problems differ in {clean(', '.join(differing))}: their fitness may not compare"]
    return []


def _judged_by(run: "Run") -> dict[str, Any]:
    problem = run.experiment.problem
    return {"simulator": problem.simulator, "trials": problem.trials, **problem.settings}


def unfinished(runs: Sequence["Run"], read: Sequence[Series]) -> list[str]:
    """A line for each run that is not at its last generation."""
    lines = []
    for run, numbers in zip(runs, read, strict=True):
        if not run.finished:
            done = f"{len(numbers.best)} of {plural(run.experiment.generations, 'generation')}"
            lines.append(f"{run.name} {'goes on' if run.going_on else 'is not finished'}: {done}")
    return lines


def curve(group: str, runs: Sequence[Series], axis: Axis) -> Curve:
    """Median and quartiles of the runs' best fitness, as far as all of them go.

    Raises:
        ConfigError: they have no point in common.
    """
    ends = [positions(run, axis) for run in runs]
    begin, end = max(p[0] for p in ends), min(p[-1] for p in ends)
    if begin > end:
        raise ConfigError(f"{group}: its runs have no {axis} in common: one ends before another's first generation did")
    x = np.unique(np.concatenate(ends))
    x = thinned(x[(x >= begin) & (x <= end)])
    values = np.stack([at(run.best, where, x) for run, where in zip(runs, ends, strict=True)])
    low, median, high = quartiles(values)
    return Curve(group, len(runs), x, median, low, high)


def curves(groups: Mapping[str, Sequence[Series]], axis: Axis) -> list[Curve]:
    """A curve for each group that has runs with a finished generation.

    Raises:
        ConfigError: none has.
    """
    begun = {group: [run for run in runs if len(run.best)] for group, runs in groups.items()}
    found = [curve(group, runs, axis) for group, runs in begun.items() if runs]
    if not found:
        raise ConfigError("no run finished a generation yet: there is nothing to show")
    return found


def cut(groups: Mapping[str, Sequence[Series]], axis: Axis) -> list[str]:
    """A line for each group whose curve ends before its longest run does."""
    lines = []
    for group, runs in groups.items():
        ends = [float(positions(run, axis)[-1]) for run in runs if len(run.best)]
        if ends and min(ends) < max(ends):
            least, most = (f"{end:,.1f} s" if axis == "time" else f"{axis} {end:,.0f}" for end in (min(ends), max(ends)))
            lines.append(f"{group}: the curve ends at {least}, which all of its runs reached; the longest went to {most}")
    return lines


def at(values: np.ndarray, where: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The values that held at each x: those of the last position that is not beyond it."""
    found: np.ndarray = values[np.searchsorted(where, x, side="right") - 1]
    return found


def quartiles(values: np.ndarray) -> np.ndarray:
    """(3, ...) lower quartile, median, upper quartile over the first axis; -inf, a failed run, is below every number.

    Where a quartile lies between a number and a failed run it is that failed run's.
    """
    ordered = np.sort(values, axis=0)
    places = np.array([0.25, 0.5, 0.75]) * (len(ordered) - 1)
    below, above = ordered[np.floor(places).astype(int)], ordered[np.ceil(places).astype(int)]
    part = (places - np.floor(places)).reshape(3, *[1] * (values.ndim - 1))
    with np.errstate(invalid="ignore"):
        between = below + part * (above - below)
    found: np.ndarray = np.where(np.isneginf(below) | (below == above), below, between)
    return found


def thinned(x: np.ndarray) -> np.ndarray:
    """So many of them that a curve can be drawn, the first and the last among them."""
    if len(x) <= POINTS:
        return x
    kept: np.ndarray = x[np.unique(np.linspace(0, len(x) - 1, POINTS).round().astype(int))]
    return kept


def envelope(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A noisy curve that can be drawn: of each stretch the least and the greatest value, in their order."""
    if len(x) <= POINTS:
        return x, y
    kept = []
    for part in np.array_split(np.arange(len(x)), POINTS // 2):
        finite = part[np.isfinite(y[part])]
        kept += sorted({finite[y[finite].argmin()], finite[y[finite].argmax()]}) if len(finite) else [part[0]]
    return x[kept], y[kept]


def positions(run: Series, axis: Axis) -> np.ndarray:
    """Where on the axis each generation ended."""
    match axis:
        case "generation":
            return np.arange(1.0, len(run.best) + 1)
        case "evaluations":
            return run.evaluations
        case "time":
            return run.seconds
