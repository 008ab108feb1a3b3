"""Learning curves as figures for papers, without pyplot: threads and notebooks are not affected.

The same runs and the same matplotlib give the same bytes.
"""

import contextlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis import comparison, curves, drawing
from zswarm.ot.analysis.comparison import Comparison
from zswarm.ot.analysis.curves import Axis, Curve, Groups, Series
from zswarm.ot.analysis.drawing import MAX_GROUPS, SIZES, CurveLine, Plot, Size
from zswarm.ot.analysis.measure import EACH
from zswarm.ot.analysis.significance import p_value
from zswarm.system.extras import need
from zswarm.system.files import write_for_user
from zswarm.system.format import plural

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("pdf", "svg", "png")
BAND = 3  # runs from which on quartiles are drawn
DPI = 300


def of_series(
    groups: Groups,
    axis: Axis = "generation",
    size: Size = "column",
    title: str = "",
    lowest: float | None = None,
    style: str = "",
    *,
    noted: bool = True,
) -> "Figure":
    """Draw learning curves: of one run best and mean, of repeats median and quartiles of the best.

    Args:
        lowest: fitness at the bottom of the vertical axis; None: all are shown.
        style: a file of matplotlib's settings, or the name of a style.
        noted: write below what the bands are, and the result of the test.

    Raises:
        ConfigError: no run finished a generation, there are too many groups, none reaches
            ``lowest``, or matplotlib is missing.
        ValueError: there is no such axis or size.
    """
    for name, value, known in (("x", axis, get_args(Axis)), ("size", size, tuple(SIZES))):
        if value not in known:
            raise ValueError(f"{name}: expected {_either(known)}, not {value!r}")
    if len(groups) > MAX_GROUPS:
        raise ConfigError(
            f"{len(groups)} groups of runs are too many for one figure; at most {MAX_GROUPS} can "
            "be distinguished"
        )
    drawn = curves.curves(groups, axis)
    runs = [run for members in groups.values() for run in members if len(run.best)]
    if len(runs) == 1:
        lines, note, height = _of_one(runs[0], drawn[0], axis), "", f"fitness, {EACH}"
    else:
        alone = len(drawn) == 1
        lines = [_line(curve, alone=alone) for curve in drawn]
        if 2 * len(drawn) <= MAX_GROUPS:
            for curve in drawn:
                lines += _tracked(curve.group, groups[curve.group], axis, alone=alone)
        note = _note(groups, drawn, axis) if noted else ""
        height = f"best fitness in search, {EACH}"
        if len(lines) > len(drawn):
            height = f"best fitness, {EACH}"
    if any(run.relative for run in runs):
        height = "score in its generation"
    chosen = SIZES[size]._replace(file=style)
    return drawing.draw(Plot(lines, axis, height, title, note, lowest), chosen)


def save(figure: "Figure", path: Path) -> None:
    """Write a figure into a file in the format that its ending names.

    Raises:
        ConfigError: another ending, or it cannot be written.
    """
    write_for_user(path, render(figure, format_of(path)))


def for_notebooks(figure: "Figure") -> "Figure":
    """Return the figure, which notebooks can now show without pyplot."""
    figure._repr_svg_ = lambda: render(figure, "svg").decode()  # type: ignore[attr-defined]
    return figure


def format_of(path: Path) -> str:
    """Return the format that a file's ending names; raise ConfigError if it names none."""
    ending = path.suffix.lower().removeprefix(".")
    if ending not in FORMATS:
        endings = _either([f".{known}" for known in FORMATS])
        raise ConfigError(f"{path}: expected a name that ends in {endings}")
    return ending


def render(figure: "Figure", as_format: str) -> bytes:
    """Return a file: fonts as TrueType in PDF, letters as paths in SVG, no dates."""
    matplotlib = need("matplotlib", "plot", "plot")
    content = io.BytesIO()
    dates = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": None}
    settings = {"pdf.fonttype": 42, "svg.fonttype": "path", "svg.hashsalt": "zswarm"}
    with drawing.LOCK, matplotlib.rc_context(settings):
        figure.savefig(content, format=as_format, dpi=DPI, metadata=dates[as_format])
    return content.getvalue()


def plain_style() -> None:
    """Ignore the user's own style of matplotlib; for programs of ours only."""
    need("matplotlib", "plot", "plot").rcdefaults()


def table(groups: Groups, axis: Axis) -> tuple[list[str], list[list[object]]]:
    """Return the numbers that a figure shows: names of the columns, and rows."""
    header = [
        "group",
        "runs",
        axis if axis != "time" else "seconds",
        "median",
        "q25",
        "q75",
    ]
    rows: list[list[object]] = []
    for curve in curves.curves(groups, axis):
        columns = (curve.x, curve.median, curve.low, curve.high)
        for x, *values in zip(*(column.tolist() for column in columns), strict=True):
            # The record counts generations from 0.
            place = x if axis == "time" else int(x) - (axis == "generation")
            rows.append([curve.group, curve.runs, place, *values])
    return header, rows


def tested(found: Comparison) -> str:
    """Return the results of the tests as a note below a figure, a line or two for each problem."""
    lines = []
    for problem, kruskal_p, _, _ in found.families:
        when = comparison.after(found, problem)
        where = f"{problem}: " if problem else ""
        if kruskal_p is not None:
            lines.append(f"{where}Kruskal-Wallis{when}: {p_value(kruskal_p)}")
            continue
        pairs = [pair for pair in found.pairs if pair.problem == problem]
        if len(pairs) == 1:
            higher, lower, a12 = comparison.ordered(pairs[0])
            lines.append(f"{where}Mann-Whitney U{when}: {p_value(pairs[0].p)}")
            lines.append(f"A12 = {a12:.2f} of {higher} over {lower}")
    return "\n".join(lines)


def _either(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"


def _of_one(run: Series, best: Curve, axis: Axis) -> list[CurveLine]:
    x, mean = curves.envelope(curves.positions(run, axis), run.mean)
    top = "best of the generation" if run.relative else "best in search"
    lines = [
        CurveLine(top, best.x, best.median),
        CurveLine("population mean", x, mean, noisy=True),
    ]
    if len(run.track):
        numbers, middle, low, high = run.track.T
        at = curves.positions(run, axis)[numbers.astype(int)]
        lines.append(CurveLine("best, held-out", at, middle, (low, high)))
    if run.held_out is not None and len(best.x):
        ends = best.x[[0, -1]]
        level, low, high = (np.full(2, value) for value in run.held_out)
        lines.append(CurveLine("champion, held-out", ends, level, (low, high)))
    return lines


def _line(curve: Curve, *, alone: bool) -> CurveLine:
    label = f"median of {plural(curve.runs, 'run')}" if alone else curve.group
    band = (curve.low, curve.high) if curve.runs >= BAND else None
    return CurveLine(label, curve.x, curve.median, band)


def _tracked(
    group: str, members: Sequence[Series], axis: Axis, *, alone: bool
) -> list[CurveLine]:
    """Return the median of the best of tracked generations on held-out seeds, at most one line.

    There is none if the runs of a group have not tracked the same generations.
    """
    runs = [run for run in members if len(run.best)]
    numbers = runs[0].track[:, 0]
    if not len(numbers):
        return []
    if not all(np.array_equal(run.track[:, 0], numbers) for run in runs):
        return []
    at = [curves.positions(run, axis)[numbers.astype(int)] for run in runs]
    low, median, high = curves.quartiles(np.stack([run.track[:, 1] for run in runs]))
    label = "the same, held-out" if alone else f"{group}, held-out"
    band = (low, high) if len(runs) >= BAND else None
    return [CurveLine(label, np.median(at, axis=0), median, band)]


def _note(groups: Groups, drawn: Sequence[Curve], axis: Axis) -> str:
    """Return what the bands are, and the result of the test."""
    parts = []
    if counts := [curve.runs for curve in drawn if curve.runs >= BAND]:
        least, most = min(counts), max(counts)
        many = f"{least}" if least == most else f"{least} to {most}"
        parts.append(
            f"bands: quartiles of {many} runs{' each' if len(drawn) > 1 else ''}"
        )
    by: comparison.By = axis if axis in ("evaluations", "simulations") else "generations"
    with contextlib.suppress(ConfigError):  # no number of evaluations in common: no test
        parts.append(tested(comparison.of_series(groups, by)))
    return "\n".join(filter(None, parts))
