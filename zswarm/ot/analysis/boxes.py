"""Draw one number of each run as boxes or violins, a column for each group."""

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
NARROW = 5  # groups from which on labels are turned
Shape = Literal["box", "violin"]


def draw(
    values: Mapping[str, np.ndarray],
    height: str,
    shape: Shape,
    size: FigureStyle,
    title: str = "",
) -> "Figure":
    """Return a figure: quartiles or densities, and every run as a dot.

    Args:
        values: by group, (runs,) float64; -inf, where every candidate failed, is left out.
        height: name of the vertical axis.

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
        places = np.arange(1, len(finite) + 1)
        columns = list(finite.values())
        if shape == "box":
            _boxes(axes, columns, places, size)
        else:
            _violins(axes, columns, places, size)
        for place, numbers, colour in zip(
            places, columns, _colours(len(columns)), strict=True
        ):
            spread = np.linspace(-0.12, 0.12, len(numbers)) if len(numbers) > 1 else 0.0
            axes.plot(
                place + spread,
                np.sort(numbers),
                "o",
                color=colour,
                markersize=2.2 * size.line,
                alpha=0.6,
                markeredgewidth=0,
                zorder=4,
            )
        turned = len(finite) > NARROW
        axes.set_xticks(
            places,
            [f"{clean(group)}" for group in finite],
            rotation=35 if turned else 0,
            ha="right" if turned else "center",
        )
        axes.set_xlim(0.4, len(finite) + 0.6)
        axes.set_ylabel(height)
        if title:
            axes.set_title(
                clean(title), loc="left", fontweight="bold", fontsize=size.font
            )
    return figure


def _boxes(axes: Any, columns: list[np.ndarray], places: Any, size: FigureStyle) -> None:
    line = {"linewidth": size.line / 1.5, "color": GREY}
    drawn = axes.boxplot(
        columns,
        positions=places,
        widths=0.5,
        showfliers=False,  # every run is a dot
        patch_artist=True,
        medianprops={"linewidth": size.line * 1.3, "color": "black"},
        whiskerprops=line,
        capprops=line,
    )
    for box, colour in zip(drawn["boxes"], _colours(len(columns)), strict=True):
        box.set(facecolor=(colour, 0.2), edgecolor=colour, linewidth=size.line / 1.5)


def _violins(
    axes: Any, columns: list[np.ndarray], places: Any, size: FigureStyle
) -> None:
    wide = [
        (place, column)
        for place, column in zip(places, columns, strict=True)
        if np.ptp(column)
    ]
    if wide:
        drawn = axes.violinplot(
            [column for _, column in wide],
            positions=[place for place, _ in wide],
            widths=0.7,
            showextrema=False,
        )
        colours = dict(zip(places, _colours(len(columns)), strict=True))
        for body, (place, _) in zip(drawn["bodies"], wide, strict=True):
            body.set(facecolor=colours[place], edgecolor=colours[place], alpha=0.25)
    for place, column in zip(places, columns, strict=True):
        low, middle, high = np.percentile(column, (25, 50, 75))
        axes.vlines(place, low, high, color=GREY, linewidth=size.line * 2, zorder=3)
        axes.plot(place, middle, "_", color="black", markersize=6 * size.line, zorder=5)


def _colours(count: int) -> list[str]:
    return [COLOURS[number % len(COLOURS)] for number in range(count)]
