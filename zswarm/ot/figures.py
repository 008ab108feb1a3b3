"""Learning curves as figures for papers: matplotlib's objects without pyplot, so that threads and notebooks are left alone.

Colours: Okabe and Ito, "Color Universal Design" (2008), without yellow; each group has a dash style of its own, too. The same
runs give the same bytes, with the same matplotlib.
"""

import importlib.util
import io
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np

from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.files import write_for_user
from zswarm.ot import comparison, curves
from zswarm.ot.comparison import Comparison
from zswarm.ot.curves import Axis, Curve, Series
from zswarm.ot.terminal import plural
from zswarm.protocol.codec import clean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from zswarm.ot.reading import Run

FORMATS = ("pdf", "svg", "png")
PICTURE = "fitness.png"  # in a run's folder
BAND = 3  # runs from which on quartiles say something
DPI = 300
GREATEST = 1e300  # fitness that is drawn as it is; matplotlib cannot tell ticks of what spans more than a float
POINT = 72  # of an inch
STEPS = (1, 2, 2.5, 5, 10)  # between ticks
FONT = "DejaVu Sans"  # comes with matplotlib
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)), (0, (2, 1)))
GREY, PALE = "#555555", "#DDDDDD"
MAX_GROUPS = len(COLOURS) * len(DASHES)
_drawing = threading.Lock()  # runs of a study end in threads; matplotlib's settings are global


class Look(NamedTuple):
    """How large a figure is."""

    width: float  # inches
    height: float
    font: float  # points
    line: float  # points


Size = Literal["column", "page", "slides", "screen"]
SIZES: dict[Size, Look] = {
    "column": Look(3.4, 2.3, 8.0, 1.2),  # of a paper with two columns
    "page": Look(7.0, 3.2, 9.0, 1.4),
    "slides": Look(10.0, 5.6, 18.0, 2.5),
    "screen": Look(5.0, 2.8, 9.0, 1.3),  # of a report, also on a telephone
}


class _Line(NamedTuple):
    label: str
    x: np.ndarray
    y: np.ndarray
    band: tuple[np.ndarray, np.ndarray] | None = None
    noisy: bool = False  # drawn thin, for dashes would be lost


def of_runs(
    groups: Mapping[str, Sequence["Run"]],
    axis: Axis = "generation",
    size: Size = "column",
    title: str = "",
    lowest: float | None = None,
) -> "Figure":
    """The learning curves of runs: of one its best and mean, of repeats the median and quartiles of their best.

    Args:
        lowest: fitness that is shown; None: all.

    Raises:
        ConfigError: no run finished a generation, there are too many groups, none reaches ``lowest``, or matplotlib is missing.
        ValueError: there is no such axis or size.
    """
    for name, value, known in (("x", axis, get_args(Axis)), ("size", size, tuple(SIZES))):
        if value not in known:
            raise ValueError(f"{name}: expected {', '.join(known[:-1])} or {known[-1]}, not {value!r}")
    return of_series(curves.load(groups)[0], axis, size, title, lowest)


def of_series(
    groups: Mapping[str, Sequence[Series]],
    axis: Axis = "generation",
    size: Size = "column",
    title: str = "",
    lowest: float | None = None,
) -> "Figure":
    """As ``of_runs``, of runs that are read already."""
    if len(groups) > MAX_GROUPS:
        raise ConfigError(f"{len(groups)} groups of runs are too many for one figure; at most {MAX_GROUPS} can be told apart")
    drawn = curves.curves(groups, axis)
    begun = [run for runs in groups.values() for run in runs if len(run.best)]
    if len(begun) == 1:
        lines, note = _of_one(begun[0], drawn[0], axis), ""
    else:
        lines = [_line(curve, alone=len(drawn) == 1) for curve in drawn]
        note = _note(groups, drawn, axis)
    with _drawing:
        return _draw(lines, axis, SIZES[size], title, note, lowest, _height(begun))


def save(figure: "Figure", path: Path) -> None:
    """Into a file whose ending says the format.

    Raises:
        ConfigError: another ending, or it cannot be written.
    """
    write_for_user(path, render(figure, format_of(path)))


def for_notebooks(figure: "Figure") -> "Figure":
    """The figure, which a notebook shows without pyplot, too."""
    figure._repr_svg_ = lambda: render(figure, "svg").decode()  # type: ignore[attr-defined]
    return figure


def format_of(path: Path) -> str:
    """The format that a file's ending names.

    Raises:
        ConfigError: it names none.
    """
    ending = path.suffix.lower().removeprefix(".")
    if ending not in FORMATS:
        raise ConfigError(f"{path}: expected a name that ends in .{', .'.join(FORMATS[:-1])} or .{FORMATS[-1]}")
    return ending


def render(figure: "Figure", as_format: str) -> bytes:
    """The file: fonts embedded as TrueType in PDF, letters as paths in SVG, no date in any."""
    matplotlib = need("matplotlib", "plot", "plot")
    content = io.BytesIO()
    dates = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    with _drawing:
        if as_format == "png":
            figure.savefig(content, format="png", dpi=DPI)
        else:  # what the bytes depend on is a setting of matplotlib's
            with matplotlib.rc_context({"pdf.fonttype": 42, "svg.fonttype": "path", "svg.hashsalt": "zswarm"}):
                figure.savefig(content, format=as_format, metadata=dates[as_format])
    return content.getvalue()


def plain_style() -> None:
    """For a program of ours: the user's own style of matplotlib changes no figure."""
    need("matplotlib", "plot", "plot").rcdefaults()


def leave(folder: Path, say: Callable[[str], None]) -> None:
    """Write ``fitness.png`` into the folder of a run or study; nothing before its first generation or without the extra ``plot``.

    Args:
        say: takes a line where it cannot be made; nothing fails for it.
    """
    from zswarm.ot import grouping, reading

    if importlib.util.find_spec("matplotlib") is None:
        return
    try:
        groups, _ = curves.load(grouping.groups(reading.runs_below([folder], [])))
        if any(len(run.best) for runs in groups.values() for run in runs):
            save(of_series(groups, title=folder.resolve().name), folder / PICTURE)
    except Exception as error:  # the run is over and safe: whatever drawing raises, or a folder that is gone, is no failure of it
        what = str(error) if isinstance(error, ConfigError) else f"{type(error).__name__}: {error}"
        say(f"no {PICTURE}: {clean(what)}")


def table(groups: Mapping[str, Sequence[Series]], axis: Axis) -> tuple[list[str], list[list[object]]]:
    """The numbers that a figure shows: names of the columns, and rows."""
    drawn = curves.curves(groups, axis)
    header = ["group", "runs", axis if axis != "time" else "seconds", "median", "q25", "q75"]
    rows: list[list[object]] = []
    for curve in drawn:
        for x, median, low, high in zip(*(v.tolist() for v in (curve.x, curve.median, curve.low, curve.high)), strict=True):
            place = x if axis == "time" else int(x) - (axis == "generation")  # as the record counts generations
            rows.append([curve.group, curve.runs, place, median, low, high])
    return header, rows


# ---- lines and words


def _of_one(run: Series, best: Curve, axis: Axis) -> list[_Line]:
    x, mean = curves.envelope(curves.positions(run, axis), run.mean)
    top = "best of the generation" if run.relative else "best so far"
    return [_Line(top, best.x, best.median), _Line("population mean", x, mean, noisy=True)]


def _height(runs: Sequence[Series]) -> str:
    """What the vertical axis shows."""
    if any(run.relative for run in runs):
        return "score in its generation"
    return "fitness" if len(runs) == 1 else "best fitness"


def _line(curve: Curve, *, alone: bool) -> _Line:
    label = f"median of {plural(curve.runs, 'run')}" if alone else curve.group
    return _Line(label, curve.x, curve.median, (curve.low, curve.high) if curve.runs >= BAND else None)


def _note(groups: Mapping[str, Sequence[Series]], drawn: Sequence[Curve], axis: Axis) -> str:
    """What the bands are, and the test."""
    counts = sorted({curve.runs for curve in drawn if curve.runs >= BAND})
    many = "" if not counts else f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    band = f"bands: quartiles of {many} runs" + (" each" if len(drawn) > 1 else "") if counts else ""
    try:
        test = tested(comparison.of_series(groups, "generations" if axis == "generation" else "evaluations"))
    except ConfigError:  # they have no number of evaluations in common: no test, but a figure
        test = ""
    return "\n".join(part for part in (band, test) if part)


def tested(found: Comparison) -> str:
    """The test's result as a note below a figure."""
    when = f"after {found.at:,.0f} {found.by if found.at != 1 else found.by.removesuffix('s')}"
    if found.kruskal_p is not None:
        return f"Kruskal-Wallis {when}: {comparison.p_value(found.kruskal_p)}"
    if len(found.pairs) == 1:
        pair = found.pairs[0]
        return f"Mann-Whitney U {when}: {comparison.p_value(pair.p)}, A12 = {max(pair.a12, 1 - pair.a12):.2f}"
    return ""


# ---- drawing


def _draw(lines: Sequence[_Line], axis: Axis, look: Look, title: str, note: str, lowest: float | None, height: str) -> "Figure":
    figure_module = need("matplotlib.figure", "plot", "plot")
    need("matplotlib.backends.backend_agg", "plot", "plot")
    labels = [_fitting(line.label, look.font, 0.8 * look.width * POINT) for line in lines]
    columns = _columns(labels, look)
    more = max(0, -(-len(lines) // columns) - 2) * 1.4 * look.font / POINT  # for a high legend the axes are not squeezed
    figure: Figure = figure_module.Figure((look.width, look.height + more), facecolor="white")
    figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02)  # inches
    axes = figure.add_subplot(facecolor="white")
    _frame(axes, look)
    scale, unit = _time_unit(lines) if axis == "time" else (1.0, "")
    handles = []
    lines = [_bounded(line) for line in lines]
    for number, line in enumerate(lines):
        colour, dash = COLOURS[number % len(COLOURS)], "-" if line.noisy else DASHES[number % len(DASHES)]
        x, y = line.x / scale, np.where(np.isfinite(line.y), line.y, np.nan)
        handles += axes.plot(
            x, y, color=colour, linestyle=dash, linewidth=look.line / 2 if line.noisy else look.line, zorder=3 + number,
            marker="o" if len(x) == 1 else None, markersize=3 * look.line,
        )  # fmt: skip
        if line.band is not None:
            low, high = (np.where(np.isfinite(edge), edge, np.nan) for edge in line.band)
            if len(x) == 1:
                axes.vlines(x, low, high, color=colour, linewidth=look.line, alpha=0.5)
            else:
                axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0, zorder=2)
    _limits(axes, [line.x / scale for line in lines])
    if lowest is not None:
        _cut_below(axes, lowest, lines)
    _numbers(axes, axis, lines)
    words: dict[str, Any] = {"fontfamily": FONT, "fontsize": look.font, "parse_math": False, "color": "black"}
    axes.set_xlabel(f"time ({unit})" if axis == "time" else axis, **words)
    axes.set_ylabel(height, **words)
    if not any(np.isfinite(line.y).any() for line in lines):
        axes.set_yticks([])
        axes.text(0.5, 0.5, "every candidate failed", transform=axes.transAxes, ha="center", va="center", **words)
    if title:
        figure.suptitle(
            _fitting(title, look.font, 0.9 * look.width * POINT), x=0.01, ha="left", **{**words, "fontweight": "bold"}
        )
    _legend(axes, handles, labels, columns, look)
    if note:
        axes.annotate(
            note, (1.0, 0.0), (0.0, -2.9 * look.font - 6.0), xycoords="axes fraction", textcoords="offset points",
            ha="right", va="top", **{**words, "fontsize": look.font * 0.85, "color": GREY},
        )  # fmt: skip
    return figure


def _bounded(line: _Line) -> _Line:
    """Without what is beyond all numbers that can be drawn; what is not finite stays so."""

    def bounded(values: np.ndarray) -> np.ndarray:
        found: np.ndarray = np.where(np.isfinite(values), values.clip(-GREATEST, GREATEST), values)
        return found

    band = None if line.band is None else (bounded(line.band[0]), bounded(line.band[1]))
    return line._replace(y=bounded(line.y), band=band)


def _frame(axes: Any, look: Look) -> None:
    for side, spine in axes.spines.items():
        spine.set(visible=side in ("left", "bottom"), color="black", linewidth=look.line / 2)
    axes.tick_params(
        which="both", direction="out", length=look.font / 3, width=look.line / 2, color="black", labelcolor="black",
        labelsize=look.font, labelfontfamily=FONT, top=False, right=False,
    )  # fmt: skip
    axes.grid(visible=True, axis="y", color=PALE, linewidth=look.line / 3, linestyle="-")
    axes.set_axisbelow(True)
    for which in (axes.xaxis, axes.yaxis):
        which.get_offset_text().set(fontsize=look.font, fontfamily=FONT)


def _limits(axes: Any, xs: Sequence[np.ndarray]) -> None:
    first, last = min(float(x[0]) for x in xs), max(float(x[-1]) for x in xs)
    if first == last:
        axes.set_xlim(first - 0.5, last + 0.5)
        axes.set_xticks([first])
    else:
        axes.set_xlim(min(0.0, first), last)


def _cut_below(axes: Any, lowest: float, lines: Sequence[_Line]) -> None:
    drawn = [edge[np.isfinite(edge)] for line in lines for edge in (line.y, *(line.band or ()))]
    greatest = max((float(edge.max()) for edge in drawn if len(edge)), default=-np.inf)
    if not -GREATEST <= lowest < greatest:
        raise ConfigError(f"lowest: expected a number below the greatest fitness, {greatest:.6g}, not {lowest:.6g}")
    axes.set_ylim(lowest, greatest + (greatest - lowest) / 20)


def _numbers(axes: Any, axis: Axis, lines: Sequence[_Line]) -> None:
    ticker = need("matplotlib.ticker", "plot", "plot")
    if len(axes.get_xticks()) > 1:
        axes.xaxis.set_major_locator(ticker.MaxNLocator(6, integer=axis != "time", steps=STEPS))
    axes.yaxis.set_major_locator(ticker.MaxNLocator(6, steps=STEPS))
    if axis == "evaluations" and max(float(line.x[-1]) for line in lines) >= 10_000:
        axes.xaxis.set_major_formatter(ticker.EngFormatter(sep=""))  # 20k, 1M


def _legend(axes: Any, handles: Sequence[Any], labels: Sequence[str], columns: int, look: Look) -> None:
    """Above the axes, where it hides nothing."""
    legend = axes.legend(
        handles, [f"{number}" for number in range(len(labels))], loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns,
        frameon=False, borderaxespad=0.2, borderpad=0.2, handlelength=2.4, columnspacing=1.2, labelspacing=0.3,
        prop={"family": FONT, "size": look.font}, labelcolor="black",
    )  # fmt: skip
    for shown, label in zip(legend.get_texts(), labels, strict=True):
        shown.set_parse_math(False)  # a label's dollar signs are no mathematics, and one that begins with _ is shown
        shown.set_text(label)


def _columns(labels: Sequence[str], look: Look) -> int:
    """Of the legend, so many as fit."""
    widest = max(_width(label, look.font) for label in labels) + 4.5 * look.font
    return max(1, min(len(labels), int(0.85 * look.width * POINT / widest)))


def _time_unit(lines: Sequence[_Line]) -> tuple[float, str]:
    longest = max(float(line.x[-1]) for line in lines)
    return (3600.0, "h") if longest > 3 * 3600 else (60.0, "min") if longest > 180 else (1.0, "s")


def _fitting(text: str, size: float, room: float) -> str:
    """A text of letters that the font has, cut to so many points."""
    charmap = _font().get_charmap()
    text = "".join(character if ord(character) in charmap else "\ufffd" for character in clean(text))
    if _width(text, size) <= room:
        return text
    while text and _width(f"{text}…", size) > room:
        text = text[:-1]
    return f"{text}…"


def _width(text: str, size: float) -> float:
    """Of a text in points."""
    font = _font()
    font.set_size(size, POINT)
    font.set_text(text, 0.0)
    return float(font.get_width_height()[0]) / 64


def _font() -> Any:
    manager = need("matplotlib.font_manager", "plot", "plot")
    return manager.get_font(manager.findfont(FONT))
