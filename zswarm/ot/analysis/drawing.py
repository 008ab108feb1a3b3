"""Draw learning curves with matplotlib.

Colours: Okabe and Ito, "Color Universal Design" (2008), without yellow; each group has its own dash
style, too.
"""

import contextlib
import threading
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis.curves import Axis
from zswarm.system.extras import need
from zswarm.system.text import clean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Fitness is clipped there; matplotlib cannot place ticks over a float's range.
GREATEST = 1e300
POINT = 72  # per inch
UPRIGHT = 0.6  # of a figure's height that a line of text along its side may take
STEPS = (1, 2, 2.5, 5, 10)  # between ticks
FONT = "DejaVu Sans"  # comes with matplotlib
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES: tuple[Any, ...] = (
    "-",
    (0, (4, 1.5)),
    (0, (1, 1)),
    (0, (6, 1.5, 1, 1.5)),
    (0, (2, 1)),
)
GREY, PALE = "#555555", "#DDDDDD"
MAX_GROUPS = len(COLOURS) * len(DASHES)
# Matplotlib's settings are global, and runs of a study end in threads.
LOCK = threading.Lock()


class FigureStyle(NamedTuple):
    """The size of a figure."""

    width: float  # inches
    height: float
    font: float  # points
    line: float  # points
    file: str = ""  # a style of matplotlib's, which comes after ours


Size = Literal["column", "page", "slides", "screen"]
SIZES: dict[Size, FigureStyle] = {
    "column": FigureStyle(3.4, 2.3, 8.0, 1.2),  # of a paper with two columns
    "page": FigureStyle(7.0, 3.2, 9.0, 1.4),
    "slides": FigureStyle(10.0, 5.6, 18.0, 2.5),
    "screen": FigureStyle(5.0, 2.8, 9.0, 1.3),  # of a report, also on a telephone
}


class CurveLine(NamedTuple):
    """A curve."""

    label: str
    x: np.ndarray
    y: np.ndarray
    band: tuple[np.ndarray, np.ndarray] | None = None
    noisy: bool = False  # drawn thin and solid: dashes would be lost


class Plot(NamedTuple):
    """Curves and the words around them."""

    lines: list[CurveLine]
    axis: Axis
    height: str  # name of the vertical axis
    title: str = ""
    note: str = ""  # below
    lowest: float | None = None  # where the vertical axis begins


def draw(plot: Plot, style: FigureStyle) -> "Figure":
    """Return a figure.

    Raises:
        ConfigError: no curve reaches ``lowest``, or matplotlib is missing.
    """
    with styled(style):
        return _draw(plot._replace(lines=[_drawable(line) for line in plot.lines]), style)


@contextlib.contextmanager
def styled(style: FigureStyle) -> Iterator[None]:
    """Draw with our settings, and those of the user's file.

    Raises:
        ConfigError: the file is no style, or matplotlib is missing.
    """
    settings = {
        "font.family": FONT,
        "font.size": style.font,
        "text.parse_math": False,
        "axes.axisbelow": True,
        "axes.linewidth": style.line / 2,
        "axes.spines.top": False,
        "axes.spines.right": False,
    }
    styles = need("matplotlib.style", "plot", "plot")
    with LOCK, contextlib.ExitStack() as context:
        context.enter_context(styles.context(["default", settings]))
        if style.file:
            try:
                context.enter_context(styles.context(style.file))
            except OSError as error:
                why = str(error).partition("\n")[0]
                raise ConfigError(
                    f"--style {style.file}: no style: {clean(why)}"
                ) from None
        yield


def axes_of(style: FigureStyle) -> tuple["Figure", Any]:
    """Return an empty figure and its axes; within ``styled``."""
    figures = need("matplotlib.figure", "plot", "plot")
    need("matplotlib.backends.backend_agg", "plot", "plot")
    figure: Figure = figures.Figure((style.width, style.height))
    figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02)  # inches
    axes = figure.add_subplot()
    _frame(axes, style)
    return figure, axes


def _draw(plot: Plot, style: FigureStyle) -> "Figure":
    lines, room = plot.lines, style.width * POINT
    labels = [_fitting(line.label, style.font, 0.8 * room) for line in lines]
    columns = _columns(labels, style)
    # A high legend does not squeeze the axes.
    more = max(0, -(-len(lines) // columns) - 2) * 1.4 * style.font / POINT
    figure, axes = axes_of(style._replace(height=style.height + more))
    scale, unit = _time_unit(lines) if plot.axis == "time" else (1.0, "")
    lines = [line._replace(x=line.x / scale) for line in lines]
    handles = []
    for number, line in enumerate(lines):
        handles += _draw_line(axes, line, number, style)
    _limits(axes, [line.x for line in lines])
    if plot.lowest is not None:
        _cut_below(axes, plot.lowest, lines)
    _ticks(axes, plot.axis, max(float(line.x[-1]) for line in lines))
    axes.set_xlabel(f"time ({unit})" if unit else plot.axis)
    axes.set_ylabel(upright(plot.height, style))
    if not any(np.isfinite(line.y).any() for line in lines):
        axes.set_yticks([])
        place: dict[str, Any] = {
            "transform": axes.transAxes,
            "ha": "center",
            "va": "center",
        }
        axes.text(0.5, 0.5, "every candidate failed", **place)
    if plot.title:
        title = _fitting(plot.title, style.font, 0.9 * room)
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize=style.font)
    _legend(axes, handles, labels, columns)
    if plot.note:
        small = 0.85 * style.font
        axes.annotate(
            "\n".join(
                _fitting(line, small, 0.95 * room) for line in plot.note.splitlines()
            ),
            (1.0, 0.0),
            (0.0, -2.9 * style.font - 6.0),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=small,
            color=GREY,
        )
    return figure


def _draw_line(axes: Any, line: CurveLine, number: int, style: FigureStyle) -> list[Any]:
    """Draw a curve and its band; return its handles for the legend."""
    colour = COLOURS[number % len(COLOURS)]
    dash = "-" if line.noisy else DASHES[number % len(DASHES)]
    width = style.line / 2 if line.noisy else style.line
    alone = len(line.x) == 1
    handles: list[Any] = axes.plot(
        line.x,
        line.y,
        color=colour,
        linestyle=dash,
        linewidth=width,
        zorder=3 + number,
        marker="o" if alone else None,
        markersize=3 * style.line,
    )
    if line.band is not None:
        low, high = line.band
        if alone:
            axes.vlines(line.x, low, high, color=colour, linewidth=style.line, alpha=0.5)
        else:
            axes.fill_between(
                line.x, low, high, color=colour, alpha=0.2, linewidth=0, zorder=2
            )
    return handles


def _drawable(line: CurveLine) -> CurveLine:
    """Clip values to the range that can be drawn; NaN, infinity too, leaves a gap."""

    def drawable(values: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(values), values.clip(-GREATEST, GREATEST), np.nan)

    band = line.band and (drawable(line.band[0]), drawable(line.band[1]))
    return line._replace(y=drawable(line.y), band=band)


def _frame(axes: Any, style: FigureStyle) -> None:
    # Set here because ticks are made when the figure is drawn, then in the user's own style.
    axes.tick_params(
        which="both",
        direction="out",
        length=style.font / 3,
        width=style.line / 2,
        color="black",
        labelcolor="black",
        **({} if style.file else {"labelsize": style.font, "labelfontfamily": FONT}),
        top=False,
        right=False,
    )
    axes.grid(visible=True, axis="y", color=PALE, linewidth=style.line / 3, linestyle="-")


def _limits(axes: Any, xs: Sequence[np.ndarray]) -> None:
    first, last = min(float(x[0]) for x in xs), max(float(x[-1]) for x in xs)
    if first == last:
        axes.set_xlim(first - 0.5, last + 0.5)
        axes.set_xticks([first])
    else:
        axes.set_xlim(min(0.0, first), last)


def _cut_below(axes: Any, lowest: float, lines: Sequence[CurveLine]) -> None:
    drawn = [
        edge[np.isfinite(edge)] for line in lines for edge in (line.y, *(line.band or ()))
    ]
    greatest = max((float(edge.max()) for edge in drawn if len(edge)), default=-np.inf)
    if not -GREATEST <= lowest < greatest:
        expected = f"a number below the greatest fitness, {greatest:.6g}"
        raise ConfigError(f"lowest: expected {expected}, not {lowest:.6g}")
    axes.set_ylim(lowest, greatest + (greatest - lowest) / 20)


def _ticks(axes: Any, axis: Axis, last: float) -> None:
    ticker = need("matplotlib.ticker", "plot", "plot")
    if len(axes.get_xticks()) > 1:
        axes.xaxis.set_major_locator(
            ticker.MaxNLocator(6, integer=axis != "time", steps=STEPS)
        )
    axes.yaxis.set_major_locator(ticker.MaxNLocator(6, steps=STEPS))
    if axis in ("evaluations", "simulations") and last >= 10_000:
        axes.xaxis.set_major_formatter(ticker.EngFormatter(sep=""))  # 20k, 1M


def _legend(
    axes: Any, handles: Sequence[Any], labels: Sequence[str], columns: int
) -> None:
    """Draw the legend above the axes, where it hides nothing."""
    legend = axes.legend(
        handles,
        list(map(str, range(len(labels)))),
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        frameon=False,
        borderaxespad=0.2,
        borderpad=0.2,
        handlelength=2.4,
        columnspacing=1.2,
        labelspacing=0.3,
    )
    for shown, label in zip(legend.get_texts(), labels, strict=True):
        # Set later: otherwise labels that begin with _ are not shown.
        shown.set_text(label)


def _columns(labels: Sequence[str], style: FigureStyle) -> int:
    """Return how many columns of the legend fit."""
    widest = max(_width(label, style.font) for label in labels) + 4.5 * style.font
    return max(1, min(len(labels), int(0.85 * style.width * POINT / widest)))


def _time_unit(lines: Sequence[CurveLine]) -> tuple[float, str]:
    longest = max(float(line.x[-1]) for line in lines)
    return (
        (3600.0, "h")
        if longest > 3 * 3600
        else (60.0, "min")
        if longest > 180
        else (1.0, "s")
    )


def upright(text: str, style: FigureStyle) -> str:
    """Return the name of a vertical axis in as many lines as the height of a figure needs."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and _width(longer, style.font) <= UPRIGHT * style.height * POINT:
            lines[-1] = longer
        else:
            lines.append(word)
    return "\n".join(lines)


def _fitting(text: str, size: float, room: float) -> str:
    """Return a text of letters that the font has, cut to a width in points."""
    charmap = _font().get_charmap()
    text = "".join(
        letter if ord(letter) in charmap else "\ufffd" for letter in clean(text)
    )
    if _width(text, size) <= room:
        return text
    while text and _width(f"{text}…", size) > room:
        text = text[:-1]
    return f"{text}…"


def _width(text: str, size: float) -> float:
    """Return the width of a text in points."""
    font = _font()
    font.set_size(size, POINT)
    font.set_text(text, 0.0)
    return float(font.get_width_height()[0]) / 64


def _font() -> Any:
    manager = need("matplotlib.font_manager", "plot", "plot")
    return manager.get_font(manager.findfont(FONT))
