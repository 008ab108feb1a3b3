"""The figure of runs as ``plot`` draws it unless asked otherwise, also in the folder of a run."""

import contextlib
import importlib.util
from collections.abc import Sequence
from pathlib import Path

from zswarm.errors import ConfigError
from zswarm.ot.analysis import compared, curves, figures, grouping
from zswarm.ot.analysis.curves import Axis
from zswarm.ot.record.reader import Run
from zswarm.ot.record.runs import runs_below

PICTURE = "fitness.png"  # in a run's folder


def usual_axis(runs: Sequence[Run]) -> Axis:
    """Return the axis of what ``compare`` compares by."""
    by = compared.usual(runs)
    return "generation" if by == "generations" else by


def save_picture(folder: Path) -> None:
    """Write ``fitness.png`` into the folder of a run or study, in a program of its own.

    Before the first generation, or without the extra ``plot``, no picture is written. If it
    cannot be drawn, there is none: the run is recorded, and ``plot`` reports the reason.
    """
    if importlib.util.find_spec("matplotlib") is None:
        return
    with contextlib.suppress(ConfigError):
        runs = runs_below([folder], [])
        groups, _ = curves.load(grouping.groups(runs))
        if curves.started(groups):
            title = folder.resolve().name
            figure = figures.of_series(groups, usual_axis(runs), title=title)
            figures.save(figure, folder / PICTURE)
