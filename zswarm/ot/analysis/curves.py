"""Learning curves of runs and of groups, over generations, evaluations or time."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis import grouping
from zswarm.ot.record.epochs import epochs, mark
from zswarm.system.format import plural
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.ot.record.reader import Run

Axis = Literal["generation", "evaluations", "simulations", "time"]
POINTS = 1000  # of a drawn curve: more than a printed one shows


class Series(NamedTuple):
    """A run's numbers after each finished generation, (generations,) float64.

    Fitness is the mean of a candidate's trials; the record has the sum.
    """

    best: np.ndarray  # of the run so far; -inf if every candidate failed
    mean: np.ndarray  # of the generation; NaN if every candidate failed
    evaluations: np.ndarray  # of the run so far
    seconds: np.ndarray  # of computing since the run's start
    # Mean of the champion on held-out seeds, and its 95 % interval.
    held_out: tuple[float, float, float] | None = None
    relative: bool = False  # fitness is a score, and best is that of the generation
    # (tracked, 4): generation, and mean of its best on held-out seeds with its 95 % interval.
    track: np.ndarray = np.empty((0, 4))
    trials: int = 1  # of an evaluation
    problem: str = ""  # as ``grouping.problems`` names it


Groups = Mapping[str, Sequence[Series]]
LUCKY = {"trials": "numbers of trials", "seeds": "seeds (fixed or fresh)"}


class Curve(NamedTuple):
    """Quartiles of a group's best fitness, at points ``x`` that all runs reached, (points,)."""

    group: str
    runs: int
    x: np.ndarray
    median: np.ndarray
    low: np.ndarray
    high: np.ndarray


def series(run: "Run") -> Series:
    """Return the numbers of a run; they are empty before its first generation."""
    history = run.history()

    def column(key: str, missing: float) -> np.ndarray:
        return np.array(
            [missing if row[key] is None else row[key] for row in history], np.float64
        )

    trials = run.fitness_trials
    best = column("best", -np.inf)
    best = np.where(np.isfinite(best), best, -np.inf)
    # Negative where the clock was set back.
    seconds = np.nan_to_num(column("seconds", 0.0), posinf=0.0).clip(0.0)
    evaluations = np.maximum.accumulate(column("evaluations", 0.0))
    found, held_out = run.held_out, None
    if found is not None and found.mean is not None:
        low, high = (
            found.mean if end is None else end for end in (found.low, found.high)
        )
        held_out = found.mean / trials, low / trials, high / trials
    return Series(
        best / trials,
        column("mean", np.nan) / trials,
        evaluations,
        np.cumsum(seconds),
        held_out,
        run.relative,
        _track(run, len(history), trials),
        run.experiment.problem.trials,
    )


def _track(run: "Run", generations: int, trials: int) -> np.ndarray:
    """Return the tracked generations whose best did not fail, with a known interval: (n, 4)."""
    found = [
        (one.generation, one.held_out.mean, one.held_out.low, one.held_out.high)
        for one in run.track
        if 0 <= one.generation < generations
    ]
    known = [row for row in found if None not in row]
    return np.array(known, np.float64).reshape(-1, 4) / [1, trials, trials, trials]


def load(
    groups: Mapping[str, Sequence["Run"]], *, search: bool = True
) -> tuple[dict[str, list[Series]], list[str]]:
    """Read each run once; return notes on omitted and unfinished runs and on problems, too.

    Args:
        search: whether fitness in search is looked at.
    """
    every = [run for runs in groups.values() for run in runs]
    loaded, notes = {}, problems(every, search=search)
    names = grouping.problems([runs[0] for runs in groups.values()])
    for (group, runs), problem in zip(groups.items(), names, strict=True):
        counted, omitted = distinct(runs)
        loaded[group] = [series(run)._replace(problem=problem) for run in counted]
        notes += [*omitted, *unfinished(counted), *mixed(counted)]
    return loaded, notes


def started(groups: Groups) -> dict[str, list[Series]]:
    """Return the runs with a finished generation; groups without any are dropped."""
    found = {
        group: [run for run in runs if len(run.best)] for group, runs in groups.items()
    }
    return {group: runs for group, runs in found.items() if runs}


def distinct(runs: Iterable["Run"]) -> tuple[list["Run"], list[str]]:
    """Drop runs that repeat another bit by bit; return a note on each."""
    unique: dict[str, Run] = {}
    notes = []
    for run in runs:
        other = unique.setdefault(run.history_hash or str(run.folder.resolve()), run)
        if other.folder.resolve() != run.folder.resolve():
            why = f"its history is that of {other.shown}, bit by bit"
            notes.append(f"{run.shown} is omitted: {why}")
    return list(unique.values()), notes


def mixed(runs: Iterable["Run"]) -> list[str]:
    """Return a note on each run that several versions of the code computed."""
    marks = {run.shown: mark(epochs(run), run.generations()) for run in runs}
    return [f"{name} was {text}" for name, text in marks.items() if text]


def _differing(problems: list[dict[str, Any]]) -> list[str]:
    keys = sorted({key for problem in problems for key in problem})
    return [
        key for key in keys if len({repr(problem.get(key)) for problem in problems}) > 1
    ]


def problems(runs: Iterable["Run"], *, search: bool = True) -> list[str]:
    """Return notes if the runs have different problems, or candidates with different trials."""

    def judged_by(run: "Run") -> dict[str, Any]:
        problem = run.experiment.problem
        return {
            "simulator": problem.simulator,
            "trials": problem.trials,
            "seeds": problem.seeds,
            **problem.settings,
        }

    found = [judged_by(run) for run in runs]
    simulators = sorted({clean(problem["simulator"]) for problem in found})
    if len(simulators) > 1:
        names = ", ".join(simulators)
        return [f"runs of different problems ({names}): their fitness does not compare"]
    differing = _differing(found)
    notes = []
    if search and (lucky := [LUCKY[key] for key in differing if key in LUCKY]):
        notes.append(
            f"the runs' candidates have different {' and '.join(lucky)}: with fresh seeds or fewer "
            "trials, the best fitness in search owes more to luck"
        )
    if names := clean(", ".join(key for key in differing if key not in LUCKY)):
        notes.append(
            f"runs whose problems differ in {names}: their fitness may not compare"
        )
    return notes


def unfinished(runs: Sequence["Run"]) -> list[str]:
    """Return a note on each run that is not at its last generation."""
    notes = []
    for run in runs:
        if not run.finished:
            state = "is still running" if run.going_on else "is not finished"
            stop, done = run.experiment.stop, run.generations()
            if stop.evaluations or stop.simulations:
                so_far = f"{plural(done, 'generation')} so far"
            else:
                so_far = f"{done} of {plural(run.experiment.generations, 'generation')}"
            notes.append(f"{run.name} {state}: {so_far}")
    return notes


def curve(group: str, runs: Sequence[Series], axis: Axis) -> Curve:
    """Return median and quartiles of the runs' best fitness, as far as all of them go.

    Raises:
        ConfigError: they have no point in common.
    """
    ends = [positions(run, axis) for run in runs]
    begin, end = max(p[0] for p in ends), min(p[-1] for p in ends)
    if begin > end:
        why = "one ends before another's first generation did"
        raise ConfigError(f"{group}: its runs have no {axis} in common: {why}")
    x = np.unique(np.concatenate(ends))
    x = thinned(x[(x >= begin) & (x <= end)])
    values = np.stack([run.best[last_before(run, axis, x)] for run in runs])
    low, median, high = quartiles(values)
    return Curve(group, len(runs), x, median, low, high)


def curves(groups: Groups, axis: Axis) -> list[Curve]:
    """Return a curve for each group that has runs with a finished generation.

    Raises:
        ConfigError: none has.
    """
    found = [curve(group, runs, axis) for group, runs in started(groups).items()]
    if not found:
        raise ConfigError("no run finished a generation yet: there is nothing to show")
    return found


def cut(groups: Groups, axis: Axis) -> list[str]:
    """Return a note on each group whose curve ends before its longest run does."""

    def place(end: float) -> str:
        return f"{end:,.1f} s" if axis == "time" else f"{axis} {end:,.0f}"

    notes = []
    for group, runs in started(groups).items():
        ends = [float(positions(run, axis)[-1]) for run in runs]
        if min(ends) < max(ends):
            least, most = place(min(ends)), place(max(ends))
            notes.append(
                f"{group}: the curve ends at {least}, which all of its runs reached; the longest "
                f"went to {most}"
            )
    return notes


def quartiles(values: np.ndarray) -> np.ndarray:
    """Return (3, ...) lower quartile, median and upper quartile over the first axis.

    Failed runs, -inf, are below every number; a quartile between one and a number is -inf.
    """
    ordered = np.sort(values, axis=0)
    places = np.array([0.25, 0.5, 0.75]) * (len(ordered) - 1)
    below = ordered[np.floor(places).astype(int)]
    above = ordered[np.ceil(places).astype(int)]
    part = (places - np.floor(places)).reshape(3, *[1] * (values.ndim - 1))
    with np.errstate(invalid="ignore"):
        between = below + part * (above - below)
    found: np.ndarray = np.where(np.isneginf(below) | (below == above), below, between)
    return found


class Spread(NamedTuple):
    """The best fitness of a group's runs; None where every candidate failed."""

    median: float | None
    q25: float | None
    q75: float | None
    best: float | None
    worst: float | None


def spread(best: np.ndarray) -> Spread:
    """Summarize the best fitness of runs, (runs,) float64; there may be no runs."""
    if not len(best):
        return Spread(None, None, None, None, None)
    q25, median, q75 = quartiles(best)
    numbers = (median, q25, q75, best.max(), best.min())
    return Spread(*(float(number) if np.isfinite(number) else None for number in numbers))


def thinned(x: np.ndarray) -> np.ndarray:
    """Return at most ``POINTS`` of the values, the first and the last among them."""
    if len(x) <= POINTS:
        return x
    some: np.ndarray = x[
        np.unique(np.linspace(0, len(x) - 1, POINTS).round().astype(int))
    ]
    return some


def envelope(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thin out a noisy curve: return the extremes of each stretch, in their order."""
    if len(x) <= POINTS:
        return x, y
    some: list[int] = []
    for part in np.array_split(np.arange(len(x)), POINTS // 2):
        finite = part[np.isfinite(y[part])]
        if len(finite):
            some += sorted({finite[y[finite].argmin()], finite[y[finite].argmax()]})
        else:
            some.append(part[0])
    return x[some], y[some]


def last_before(run: Series, axis: Axis, x: float | np.ndarray) -> Any:
    """Return the index of the last generation that had ended at ``x``; -1: none had."""
    return np.searchsorted(positions(run, axis), x, side="right") - 1


def positions(run: Series, axis: Axis) -> np.ndarray:
    """Return where on the axis each generation ended."""
    match axis:
        case "generation":
            return np.arange(1.0, len(run.best) + 1)
        case "evaluations":
            return run.evaluations
        case "simulations":
            return run.evaluations * run.trials
        case "time":
            return run.seconds
