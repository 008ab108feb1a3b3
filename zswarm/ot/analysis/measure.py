"""One number for each run: best fitness in search, or what its champion does on held-out seeds.

``evaluate`` writes what a champion did in each held-out trial to a file in the run's folder.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.record.history_hash import digest
from zswarm.ot.record.reader import Run
from zswarm.system.files import write_whole
from zswarm.system.text import clean

FILE = "evaluated.json"  # in a run's folder
SEARCH, HELD_OUT, FITNESS = "search", "held-out", "fitness"
EACH = "mean per trial"


class Evaluated(NamedTuple):
    """What a champion did in the trials of ``evaluate``."""

    seed: int  # from which those of the trials are derived
    fitness: np.ndarray  # (trials,) float64
    metrics: dict[str, np.ndarray]  # each (trials,) float64

    def value(self, name: str) -> float:
        """Return the mean fitness of a trial, or the mean of a metric."""
        return float((self.fitness if name == FITNESS else self.metrics[name]).mean())


def save(run: Run, found: Evaluated) -> None:
    """Write what a champion did next to its run's record."""
    text = json.dumps(
        {
            "champion": _champion(run),
            "seed": found.seed,
            "fitness": _numbers(found.fitness),
            "metrics": {name: _numbers(column) for name, column in found.metrics.items()},
        }
    )
    write_whole(run.folder / FILE, text.encode())


def exists(run: Run) -> bool:
    """Return whether a champion of a run was evaluated, maybe an earlier one."""
    return (run.folder / FILE).exists()


def load(run: Run) -> Evaluated:
    """Return what a run's champion did.

    Raises:
        ConfigError: it was not evaluated, or another champion was.
    """
    again = f"run zswarm-ot evaluate {run.folder.parent} first"
    try:
        text = (run.folder / FILE).read_text(encoding="utf-8")
        found: dict[str, Any] = json.loads(text)
        metrics = {clean(name): _column(row) for name, row in found["metrics"].items()}
        evaluated = Evaluated(int(found["seed"]), _column(found["fitness"]), metrics)
        champion = found["champion"]
    except FileNotFoundError:
        raise ConfigError(
            f"{run.shown}: its champion was not evaluated: {again}"
        ) from None
    except (OSError, LookupError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{run.shown}/{FILE}: cannot be used: {error!r}") from None
    if champion != _champion(run):
        raise ConfigError(
            f"{run.shown}: it has another champion since it was evaluated: {again}"
        )
    return evaluated


def values(
    groups: Mapping[str, Sequence[Run]], name: str
) -> tuple[dict[str, np.ndarray], dict[str, list[Run]], list[str]]:
    """Return one number of each finished run by group, the runs, and notes on those left out.

    Args:
        name: ``held-out``, ``fitness`` or a metric of ``evaluate``.

    Raises:
        ConfigError: there is no such number.
    """
    numbers: dict[str, np.ndarray] = {}
    counted: dict[str, list[Run]] = {}
    notes = []
    for group, runs in groups.items():
        finished = [run for run in runs if run.finished]
        notes += [
            f"{run.name} is not finished, and omitted" for run in runs if not run.finished
        ]
        if finished:
            counted[group] = finished
            numbers[group] = np.array([_value(run, name) for run in finished])
    if not numbers:
        raise ConfigError("no run is finished: there is nothing to compare")
    return numbers, counted, notes


def usual(runs: Sequence[Run]) -> str:
    """Return ``held-out`` if every run is finished and its champion assessed, else ``search``."""
    whole = all(run.finished and _assessed(run) is not None for run in runs)
    return HELD_OUT if whole else SEARCH


def words(name: str) -> str:
    """Return what a number is, for people and the axes of figures."""
    if name == SEARCH:
        return f"best fitness in search, {EACH}"
    what = "fitness" if name in (HELD_OUT, FITNESS) else name
    return f"champion's {what} on held-out seeds, {EACH}"


def source(name: str) -> str:
    """Return which trials of the champions a number is from; "" for the search."""
    if name == SEARCH:
        return ""
    if name == HELD_OUT:
        return " (assessment at the end of each run)"
    return " (trials of zswarm-ot evaluate)"


def _assessed(run: Run) -> float | None:
    """Return the mean of a champion's assessment, a sum as fitness is; None: there is none."""
    return None if run.held_out is None else run.held_out.mean


def _value(run: Run, name: str) -> float:
    if name == HELD_OUT:
        mean = _assessed(run)
        if mean is None:
            raise ConfigError(
                f"{run.shown}: its champion was not assessed on held-out seeds; zswarm-ot "
                f"evaluate {run.folder.parent} plays all champions there, and --measure fitness "
                "compares them"
            )
        return mean / run.fitness_trials
    found = load(run)
    if name != FITNESS and name not in found.metrics:
        known = ", ".join([SEARCH, HELD_OUT, FITNESS, *found.metrics])
        raise ConfigError(f"measure {clean(name)}: unknown; known are: {known}")
    value = found.value(name)
    return -math.inf if math.isnan(value) else value


def _champion(run: Run) -> str:
    champion = run.champion()
    if champion is None:
        raise ConfigError(f"{run.shown}: it has no champion yet")
    return digest(champion.genome).hex()


def _numbers(column: np.ndarray) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in column.tolist()]


def _column(row: Sequence[float | None]) -> np.ndarray:
    return np.array([math.nan if value is None else value for value in row], np.float64)
