"""Draw one number of each run as boxes or violins, a column for each group."""

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis import drawing
from zswarm.ot.analysis.drawing import COLOURS, GREY, FigureStyle
from zswarm.system.text import clean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST = 24  # groups
FEW = 5  # runs of a group below which it has no quartiles and no density, only dots
LETTER = 0.8  # width of a letter with its share of the margins, per size of the font
POINTS = 72  # in an inch
BOX, SPREAD = 0.5, 0.12  # width of a box, and how far dots are from the middle, in groups
Shape = Literal["box", "violin"]
DOTS = "dots: runs; black lines: medians"
NOTES: dict[Shape, tuple[str, ...]] = {
    "box": (
        "boxes: quartiles; whiskers: the farthest runs",
        "within 1.5 times the boxes' height",
    ),
    "violin": ("violins: densities; grey bars: quartiles",),
}
Drawn = tuple[Any, np.ndarray, str]  # place, numbers and colour of a group


def draw(
    values: Mapping[str, np.ndarray],
    height: str,
    shape: Shape,
    size: FigureStyle,
    title: str = "",
    *,
    noted: bool = True,
) -> "Figure":
    """Return a figure: quartiles or densities, and every run as a dot.

    A group of few runs has its median and the dots only. Where groups have few runs, or not the
    same number, it is written below their names.

    Args:
        values: by group, (runs,) float64; -inf, where every candidate failed, is left out.
        height: name of the vertical axis.
        noted: write below what is drawn.

    Raises:
        ConfigError: there are too many groups, or no finite number.
    """
    if len(values) > MOST:
        raise ConfigError(
            f"{len(values)} groups are too many for one figure; at most {MOST}"
        )
    finite = {group: numbers[np.isfinite(numbers)] for group, numbers in values.items()}
    finite = {group: numbers for group, numbers in finite.items() if len(numbers)}
    if not finite:
        raise ConfigError("no run has a number to draw: every candidate failed")
    with drawing.styled(size):
        figure, axes = drawing.axes_of(size)
        if noted:
            _note(figure, size, shape, finite)
        places = np.arange(1, len(finite) + 1)
        columns = list(finite.values())
        colours = _colours(len(columns))
        drawn = list(zip(places, columns, colours, strict=True))
        large = [one for one in drawn if len(one[1]) >= FEW]
        if shape == "box":
            _boxes(axes, large, size)
        else:
            _violins(axes, large, size)
        for one in drawn:
            in_box = shape == "box" and len(one[1]) >= FEW
            _dots(axes, one, size, half=BOX / 2 if in_box else SPREAD)
        labels, turned = _labels(finite, size)
        look: dict[str, Any] = {"rotation": 35, "ha": "right"} if turned else {}
        axes.set_xticks(places, labels, **look)
        axes.set_xlim(0.4, len(finite) + 0.6)
        axes.set_ylabel(drawing.upright(height, size))
        if title:
            axes.set_title(
                clean(title), loc="left", fontweight="bold", fontsize=size.font
            )
    return figure


def _note(
    figure: "Figure", size: FigureStyle, shape: Shape, groups: Mapping[str, np.ndarray]
) -> None:
    """Write below what is drawn, in lines by which the figure becomes higher."""
    large = any(len(numbers) >= FEW for numbers in groups.values())
    lines, small = [DOTS, *(NOTES[shape] if large else ())], 0.85 * size.font
    text = "\n".join(lines)
    figure.supxlabel(text, x=0.99, ha="right", fontsize=small, color=GREY)
    figure.set_figheight(size.height + len(lines) * 1.2 * small / POINTS)


def _dots(axes: Any, drawn: Drawn, size: FigureStyle, *, half: float) -> None:
    """Draw every run of a group, and their median as a line to both sides of the middle."""
    place, numbers, colour = drawn
    spread = np.linspace(-SPREAD, SPREAD, len(numbers)) if len(numbers) > 1 else 0.0
    axes.plot(
        place + spread,
        np.sort(numbers),
        "o",
        color=colour,
        markersize=2.2 * size.line,
        alpha=0.6,
        markeredgewidth=0,
        zorder=6,  # also that of the median
    )
    middle = np.median(numbers)
    axes.hlines(
        *(middle, place - half, place + half),
        color="black",
        linewidth=size.line * 1.3,
        zorder=5,
    )


def _labels(
    groups: Mapping[str, np.ndarray], size: FigureStyle
) -> tuple[list[str], bool]:
    """Return the names of groups in lines that fit side by side, or whole ones to be turned."""
    room = int(size.width * POINTS / len(groups) / (LETTER * size.font))
    names = [clean(group) for group in groups]
    counts = [len(numbers) for numbers in groups.values()]
    counted = min(counts) < FEW or len(set(counts)) > 1
    turned = any(len(word) > room for name in names for word in name.split())
    if not turned:
        names = [textwrap.fill(name, room, break_on_hyphens=False) for name in names]
    between = " " if turned else "\n"
    if counted:
        names = [
            f"{name}{between}(n = {count})"
            for name, count in zip(names, counts, strict=True)
        ]
    return names, turned


def _boxes(axes: Any, drawn: list[Drawn], size: FigureStyle) -> None:
    if not drawn:
        return
    places, columns, colours = zip(*drawn, strict=True)
    line = {"linewidth": size.line / 1.5, "color": GREY}
    made = axes.boxplot(
        columns,
        positions=places,
        widths=BOX,
        showfliers=False,  # every run is a dot
        patch_artist=True,
        medianprops={"linewidth": 0},  # drawn for all groups
        whiskerprops=line,
        capprops=line,
    )
    for box, colour in zip(made["boxes"], colours, strict=True):
        box.set(facecolor=(colour, 0.2), edgecolor=colour, linewidth=size.line / 1.5)


def _violins(axes: Any, drawn: list[Drawn], size: FigureStyle) -> None:
    for place, column, colour in drawn:
        if np.ptp(column):
            made = axes.violinplot(
                [column], positions=[place], widths=0.7, showextrema=False
            )
            made["bodies"][0].set(facecolor=colour, edgecolor=colour, alpha=0.25)
        low, high = np.percentile(column, (25, 75))
        axes.vlines(place, low, high, color=GREY, linewidth=size.line * 2, zorder=3)


def _colours(count: int) -> list[str]:
    return [COLOURS[number % len(COLOURS)] for number in range(count)]
