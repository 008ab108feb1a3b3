"""Draw a trial as a film in SVG, which browsers play without a script.

Readers who prefer reduced motion, and printed pages, get the paths instead.
"""

from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from zswarm.ot.replay.appearance import colours, corners, nose, scaled, sized
from zswarm.sims.simulator import Body, Frame, Label, Line

NAMESPACE = "http://www.w3.org/2000/svg"  # of a file; not needed within HTML
SIDE, GAP = 420.0, 28.0  # pixels: of a panel, between two
# Pixels: above a panel, a line and a letter of text.
TITLE, LINE, LETTER = 24.0, 21.0, 7.0
MOST_FRAMES = 400
MOST_POSITIONS = 100_000  # of all bodies; more would take megabytes
MOST_TURNS = 200_000  # of a trial, some seconds of computing
MOST_LABELS = 60  # and changes of labels
# The last picture stays for HOLD_S.
FRAME_S, SHORTEST_S, LONGEST_S, HOLD_S = 0.12, 3.0, 12.0, 1.5
STYLE = (
    ".zs{font:13px system-ui,sans-serif}.zs text,.zs g g text{fill:#333}"
    ".zs .field{fill:#fafafa;stroke:#bbb}.zs .still{display:none}"
    "@media (prefers-color-scheme:dark){.zs text{fill:#ddd}}"
    "@media (prefers-reduced-motion:reduce){.zs .moving{display:none}.zs .still{display:inline}}"
    "@media print{.zs .moving{display:none}.zs .still{display:inline}}"
)


class Panel(NamedTuple):
    """One trial."""

    title: str
    frames: Sequence[Frame]


def svg(panels: Sequence[Panel]) -> str:
    """Draw panels next to each other; they play together, again and again."""
    longest = max(len(panel.frames) for panel in panels)
    colour_of = colours(*(panel.frames for panel in panels))
    parts, left, height = [], 1.0, 0.0
    for title, frames in panels:
        scale = SIDE / max(frames[0].width, frames[0].height)
        drawn = _Film(frames, scale, longest, colour_of).panel()
        text = f'<text y="-8">{escape(title)}</text>'
        parts.append(f'<g transform="translate({left:g} {TITLE:g})">{text}{drawn}</g>')
        left += frames[0].width * scale + GAP
        height = max(height, frames[0].height * scale)
    width = left - GAP + 1
    legend, top, full = "", TITLE + height + LINE, 0.0
    for kind, x, row in placed(
        colour_of, width, 1.0, lambda kind: 30 + LETTER * len(kind)
    ):
        y = top + row * LINE
        box = f'x="{x:g}" y="{y - 10:g}" width="11" height="11" rx="2"'
        legend += f'<rect {box} fill="{colour_of[kind]}" stroke="#bbb"/>'
        legend += f'<text x="{x + 16:g}" y="{y:g}">{escape(kind)}</text>'
        full = y + 0.6 * LINE
    size = f'viewBox="0 0 {width:g} {full:g}" width="{width:g}" height="{full:g}"'
    title = escape("; ".join(panel.title for panel in panels))
    return (
        f'<svg xmlns="{NAMESPACE}" class="zs" role="img" aria-label="{title}" {size}>'
        f"<style>{STYLE}</style>{''.join(parts)}{legend}</svg>\n"
    )


def placed(
    kinds: Iterable[str], width: float, left: float, wide: Callable[[str], float]
) -> list[tuple[str, float, int]]:
    """Return kinds with the left edge and the row of their names in a legend."""
    found, x, row = [], left, 0
    for kind in kinds:
        if x > left and x + wide(kind) > width:
            x, row = left, row + 1
        found.append((kind, x, row))
        x += wide(kind)
    return found


def thinned(count: int, most: int) -> list[int]:
    """Return the numbers of at most ``most`` frames, and of the last one."""
    return [*range(0, count - 1, -(-count // most)), count - 1]


def play_s(count: int) -> float:
    """Return the duration of a film with this number of frames."""
    return min(max(count * FRAME_S, SHORTEST_S), LONGEST_S)


class _Film:
    """The frames of one panel that are drawn, and when."""

    def __init__(
        self, frames: Sequence[Frame], scale: float, longest: int, colours: dict[str, str]
    ) -> None:
        most = min(MOST_FRAMES, MOST_POSITIONS // max(1, len(frames[0].bodies)))
        chosen = thinned(len(frames), max(2, most))
        self.places = sized(frames[0].places, scale)
        self.frames = [scaled(frames[number], scale) for number in chosen]
        self.duration_s = play_s(longest) + HOLD_S
        share = play_s(longest) / self.duration_s / max(1, longest - 1)
        self.times = [number * share for number in chosen]
        self.colours = colours

    def panel(self) -> str:
        first, last = self.frames[0], self.frames[-1]
        size = f'width="{first.width:g}" height="{first.height:g}"'
        parts = [f'<rect class="field" {size}/>']
        for place in self.places:
            at = f'x="{place.x:g}" y="{place.y:g}"'
            size = f'width="{place.width:g}" height="{place.height:g}"'
            parts.append(f'<rect {at} {size} fill="{self.colours[place.kind]}"/>')
        # Agents come first, and are drawn over everything else.
        ways = list(zip(*(frame.bodies for frame in self.frames), strict=True))[::-1]
        lines = list(zip(*(frame.lines for frame in self.frames), strict=True))
        moving = [*map(self._moving, ways), *map(self._line, lines)]
        moving += self._labels([frame.labels for frame in self.frames])
        still = [*map(self._path, ways), *(self._line(way[-1:]) for way in lines)]
        still += self._labels([last.labels])
        return (
            f'{"".join(parts)}<g class="moving">{"".join(moving)}</g>'
            f'<g class="still">{"".join(still)}</g>'
        )

    def _moving(self, way: Sequence[Body]) -> str:
        start = way[0]
        fill = self._animated(
            "fill", [self.colours[body.kind] for body in way], discrete=True
        )
        if start.shape == "disc" and start.heading is None:
            x = self._animated("cx", [f"{body.x:.4g}" for body in way])
            y = self._animated("cy", [f"{body.y:.4g}" for body in way])
            return self._shape(start, f"{x}{y}{fill}")
        places = [f"{body.x:.4g} {body.y:.4g}" for body in way]
        turns = np.unwrap([body.heading or 0.0 for body in way])
        angles = [f"{angle:.4g}" for angle in np.degrees(turns).tolist()]
        at = start._replace(x=0.0, y=0.0, heading=None if start.heading is None else 0.0)
        return (
            f'<g transform="translate({places[0]})">{self._animated("translate", places)}'
            f'<g transform="rotate({angles[0]})">{self._animated("rotate", angles)}'
            f"{self._shape(at, fill)}</g></g>"
        )

    def _animated(
        self, name: str, values: Sequence[str], *, discrete: bool = False
    ) -> str:
        """Animate an attribute or a transformation; return "" if it does not change."""
        if len(set(values)) == 1:
            return ""
        last = len(values) - 1
        needed = [
            (f"{time:.4f}", value)
            for i, (time, value) in enumerate(zip(self.times, values, strict=True))
            if i in (0, last) or not values[i - 1] == value == values[i + 1]
        ]
        times, steps = map(";".join, zip(*needed, ("1", values[-1]), strict=True))
        what = f'animate attributeName="{name}"'
        if name in ("translate", "rotate"):
            what = f'animateTransform attributeName="transform" type="{name}"'
        mode = ' calcMode="discrete"' if discrete else ""
        return (
            f'<{what} dur="{self.duration_s:g}s" repeatCount="indefinite"{mode} '
            f'keyTimes="{times}" values="{steps}"/>'
        )

    def _shape(self, body: Body, inside: str = "") -> str:
        fill = f'fill="{self.colours[body.kind]}"'
        if body.shape != "disc":
            edge = " ".join(f"{x:.4g},{y:.4g}" for x, y in corners(body))
            return f'<polygon points="{edge}" {fill}>{inside}</polygon>'
        centre = f'cx="{body.x:.4g}" cy="{body.y:.4g}"'
        disc = f'<circle {centre} r="{body.radius:.3g}" {fill}>{inside}</circle>'
        if body.heading is None:
            return disc
        to_x, to_y = nose(body)
        ends = f'x1="{body.x:.4g}" y1="{body.y:.4g}" x2="{to_x:.4g}" y2="{to_y:.4g}"'
        width = max(1.0, 0.28 * body.radius)
        return f'{disc}<line {ends} stroke="#fff" stroke-width="{width:.2g}"/>'

    def _path(self, way: Sequence[Body]) -> str:
        points = " ".join(f"{body.x:.4g},{body.y:.4g}" for body in way)
        stroke = (
            f'stroke="{self.colours[way[-1].kind]}" stroke-opacity=".35" stroke-width="2"'
        )
        return f'<polyline points="{points}" fill="none" {stroke}/>{self._shape(way[-1])}'

    def _line(self, way: Sequence[Line]) -> str:
        start, moving = [], []
        for place, name in enumerate(("x1", "y1", "x2", "y2"), 1):
            ends = [f"{line[place]:.4g}" for line in way]
            moving.append(self._animated(name, ends))
            start.append(f'{name}="{ends[0]}"')
        stroke = f'stroke="{self.colours[way[0].kind]}" stroke-width="3"'
        return f"<line {' '.join(start)} {stroke}>{''.join(moving)}</line>"

    def _labels(self, frames: Sequence[Sequence[Label]]) -> list[str]:
        """Draw labels while they apply; none if there are too many."""
        every = dict.fromkeys(label for labels in frames for label in labels)
        if len(every) > MOST_LABELS:
            return []
        drawn = []
        for label in every:
            shown = ["visible" if label in labels else "hidden" for labels in frames]
            drawn.append(
                f'<text x="{label.x:.4g}" y="{label.y:.4g}" '
                'text-anchor="middle" dominant-baseline="middle" '
                f'style="font-size:{max(label.size, 9):.3g}px" '
                f'visibility="{shown[0]}">{escape(label.text)}'
                f"{self._animated('visibility', shown, discrete=True)}</text>"
            )
        return drawn
