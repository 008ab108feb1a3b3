"""Draw the archive of a quality-diversity run: the best candidate of each cell, as a heat map.

It follows from the recorded candidates, so it needs no optimizer.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis import drawing
from zswarm.ot.analysis.drawing import FigureStyle
from zswarm.ot.analysis.measure import EACH
from zswarm.ot.record.reader import Run
from zswarm.system.text import clean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAP = "viridis"  # brightness rises with fitness, also without colour


class Archive(NamedTuple):
    """The elites of a run."""

    fitness: (
        np.ndarray
    )  # (cells of the first measure, of the second) mean of a trial; NaN: empty
    names: tuple[str, str]  # of the measures
    ends: tuple[tuple[float, float], tuple[float, float]]

    @property
    def coverage(self) -> float:
        """The share of the cells that have an elite."""
        return float(np.isfinite(self.fitness).mean())


def of_run(run: Run) -> Archive:
    """Return the best fitness of each cell.

    Raises:
        ConfigError: the run has no archive of two measures.
    """
    settings = run.experiment.optimizer.settings
    measures, cells = settings.get("measures", []), settings.get("cells", [])
    if len(measures) != 2 or len(cells) != 2:
        raise ConfigError(
            f"{run.shown}: expected a run with two measures, such as one of map-elites, not "
            f"{run.experiment.optimizer.kind} with {len(measures)}"
        )
    low, high = (np.array(settings[key], np.float64) for key in ("lows", "highs"))
    best = np.full(cells, -np.inf)
    for generation in range(run.generations()):
        told = [row for row in run.candidates(generation) if row["fitness"] is not None]
        if not told:
            continue
        found = np.array([row["measures"] for row in told], np.float64).reshape(-1, 2)
        fitness = np.array([row["fitness"] for row in told])
        whole = np.isfinite(found).all(axis=1)
        places = ((found[whole] - low) / (high - low) * cells).astype(np.int64)
        places = places.clip(0, np.array(cells) - 1)
        np.maximum.at(best, tuple(places.T), fitness[whole])
    trials = run.fitness_trials
    names = (clean(measures[0]), clean(measures[1]))
    ends = ((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))
    return Archive(np.where(np.isfinite(best), best / trials, np.nan), names, ends)


def of_runs(runs: Sequence[Run]) -> Archive:
    """Return the archive of the only run; raise ConfigError if there are several."""
    if len(runs) != 1:
        raise ConfigError(f"an archive is that of one run, not of {len(runs)}")
    return of_run(runs[0])


def draw(found: Archive, size: FigureStyle, title: str = "") -> "Figure":
    """Return a figure of an archive."""
    with drawing.styled(size):
        figure, axes = drawing.axes_of(size)
        axes.grid(visible=False)
        image: Any = axes.imshow(
            found.fitness.T,
            origin="lower",
            aspect="auto",
            cmap=MAP,
            extent=(*found.ends[0], *found.ends[1]),
            interpolation="nearest",
        )
        axes.set_xlabel(found.names[0])
        axes.set_ylabel(drawing.upright(found.names[1], size))
        bar = figure.colorbar(image, ax=axes)
        bar.set_label(f"fitness, {EACH}")
        coverage = f"{100 * found.coverage:.0f} % of the cells"
        text = f"{clean(title)}: {coverage}" if title else coverage
        axes.set_title(text, loc="left", fontsize=size.font)
    return figure
