"""A controller's trial as a moving picture: SVG that any browser plays, without a script.

Whoever wants no motion, and paper, gets the paths instead.
"""

import itertools
import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple

from zswarm.sims.simulator import Body, Frame, Label, Line

NAMESPACE = "http://www.w3.org/2000/svg"  # of a file; not needed within HTML
SIDE, GAP = 420.0, 28.0  # pixels: of a panel, between two
TITLE, LINE, LETTER = 24.0, 21.0, 7.0  # pixels: above a panel, a line and a letter of text
MOST_FRAMES = 400
MOST_POSITIONS = 100_000  # of all bodies; more would make a picture of megabytes
MOST_TURNS = 200_000  # of a trial that is looked at, some seconds of computing
MOST_WORDS = 60  # labels, and changes of them, that are shown
FRAME_S, SHORTEST_S, LONGEST_S, HOLD_S = 0.12, 3.0, 12.0, 1.5  # the last picture stays for HOLD_S
KNOWN = {
    **dict.fromkeys(("blockade", "wall", "track", "rod"), "#8b9099"),
    **dict.fromkeys(("exit", "goal", "right"), "#35a36b"),
    **dict.fromkeys(("home", "nest"), "#cfe3f5"),
    **dict.fromkeys(("flag's stand", "light"), "#f2d16b"),
    "opponents' home": "#f6d9c4",
    "opponents' flag's stand": "#d9a300",
}
TRANSFORMS = ("translate", "rotate")
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442", "#000000")  # Okabe and Ito
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
    """Panels side by side, played together again and again."""
    longest = max(len(panel.frames) for panel in panels)
    play_s = min(max(longest * FRAME_S, SHORTEST_S), LONGEST_S)
    colour_of = colours(*(panel.frames for panel in panels))
    parts, left, height = [], 1.0, 0.0
    for panel in panels:
        scale = SIDE / max(panel.frames[0].width, panel.frames[0].height)
        parts.append(
            f'<g transform="translate({left:g} {TITLE:g})"><text y="-8">{escape(panel.title)}</text>'
            f"{_panel(panel.frames, scale, play_s, colour_of, longest)}</g>"
        )
        left += panel.frames[0].width * scale + GAP
        height = max(height, panel.frames[0].height * scale)
    width = left - GAP + 1
    legend, rows = _legend(colour_of, colour_of, width, TITLE + height + LINE)
    whole = f"{width:g} {TITLE + height + (rows + 0.6) * LINE:g}"
    size = f'viewBox="0 0 {whole}" width="{whole.split()[0]}" height="{whole.split()[1]}"'
    title = escape("; ".join(panel.title for panel in panels))
    return (
        f'<svg xmlns="{NAMESPACE}" class="zs" role="img" aria-label="{title}" {size}>'
        f"<style>{STYLE}</style>{''.join(parts)}{legend}</svg>\n"
    )


def colours(*trials: Sequence[Frame]) -> dict[str, str]:
    """A colour for each kind of thing in some trials, in the order in which they come."""
    kinds: dict[str, None] = {}
    for frames in trials:
        kinds |= dict.fromkeys(place.kind for place in frames[0].places)
        kinds |= dict.fromkeys(line.kind for line in frames[0].lines)
        kinds |= dict.fromkeys(body.kind for frame in frames for body in frame.bodies)
    others = dict(zip((kind for kind in kinds if kind not in KNOWN), itertools.cycle(PALETTE)))
    return {kind: KNOWN.get(kind) or others[kind] for kind in kinds}


def corners(body: Body) -> list[tuple[float, float]]:
    """Those of a body that is no disc, from its centre, in its radii."""
    turned = body.heading or 0.0
    first, count, reach = {"square": (0.25, 4, math.sqrt(2)), "diamond": (0.0, 4, 1.1), "triangle": (-0.5, 3, 1.2)}[body.shape]
    angles = (math.pi * (first + 2 * corner / count) + turned for corner in range(count))
    return [(reach * math.cos(angle), reach * math.sin(angle)) for angle in angles]


def _panel(seen: Sequence[Frame], scale: float, play_s: float, colours: dict[str, str], longest: int) -> str:
    first = seen[0]
    parts = [f'<rect class="field" width="{first.width * scale:g}" height="{first.height * scale:g}"/>']
    parts += [
        f'<rect x="{place.x * scale:g}" y="{place.y * scale:g}" width="{place.width * scale:g}" '
        f'height="{place.height * scale:g}" fill="{colours[place.kind]}"/>'
        for place in first.places
    ]
    most = max(2, min(MOST_FRAMES, MOST_POSITIONS // max(1, len(first.bodies))))
    chosen = range(0, len(seen), -(-len(seen) // most))
    picked = [*chosen, *([len(seen) - 1] if chosen[-1] != len(seen) - 1 else [])]
    share = play_s / (play_s + HOLD_S) / max(1, longest - 1)
    times = [number * share for number in picked]
    moving, still = [], []
    for number in range(len(first.bodies)):
        way = [seen[at].bodies[number] for at in picked]
        moving.append(_moving(way, times, scale, colours, play_s + HOLD_S))
        still.append(_still(way, scale, colours))
    for number in range(len(first.lines)):
        lines = [seen[at].lines[number] for at in picked]
        moving.append(_line(lines, times, scale, colours, play_s + HOLD_S))
        still.append(_line(lines[-1:], times, scale, colours, play_s + HOLD_S))
    moving += _words([seen[at].labels for at in picked], times, scale, play_s + HOLD_S)
    still += _words([seen[-1].labels], times, scale, play_s + HOLD_S)
    return f'{"".join(parts)}<g class="moving">{"".join(moving)}</g><g class="still">{"".join(still)}</g>'


def _moving(way: Sequence[Body], times: Sequence[float], scale: float, colours: dict[str, str], duration_s: float) -> str:
    fill = _animated("fill", [colours[body.kind] for body in way], times, duration_s, discrete=True)
    start = way[0]
    if start.shape == "disc" and start.heading is None:
        x = _animated("cx", [f"{body.x * scale:.4g}" for body in way], times, duration_s)
        y = _animated("cy", [f"{body.y * scale:.4g}" for body in way], times, duration_s)
        return _shape(start, scale, colours[start.kind], f"{x}{y}{fill}")
    places = _animated("translate", [f"{body.x * scale:.4g} {body.y * scale:.4g}" for body in way], times, duration_s)
    degrees = _unwound([math.degrees(body.heading or 0.0) for body in way])
    turns = _animated("rotate", [f"{angle:.4g}" for angle in degrees], times, duration_s)
    at = start._replace(x=0.0, y=0.0, heading=None if start.heading is None else 0.0)
    return (
        f'<g transform="translate({start.x * scale:.4g} {start.y * scale:.4g})">{places}<g transform="rotate({degrees[0]:.4g})">'
        f"{turns}{_shape(at, scale, colours[start.kind], fill)}</g></g>"
    )


def _animated(name: str, values: Sequence[str], times: Sequence[float], duration_s: float, *, discrete: bool = False) -> str:
    """How an attribute, or a way to transform, changes; nothing where it does not."""
    if len(set(values)) == 1:
        return ""
    kept = [i for i in range(len(values)) if i in (0, len(values) - 1) or not values[i - 1] == values[i] == values[i + 1]]
    at = [f"{times[i]:.4f}" for i in kept] + ["1"]
    mode = ' calcMode="discrete"' if discrete else ""
    what = (
        f'animateTransform attributeName="transform" type="{name}"' if name in TRANSFORMS else f'animate attributeName="{name}"'
    )
    return (
        f'<{what} dur="{duration_s:g}s" repeatCount="indefinite"{mode} '
        f'keyTimes="{";".join(at)}" values="{";".join([*(values[i] for i in kept), values[-1]])}"/>'
    )


def _unwound(degrees: Sequence[float]) -> list[float]:
    """Angles of which each is less than half a turn from the one before."""
    found = [degrees[0]]
    for angle in degrees[1:]:
        found.append(found[-1] + (angle - found[-1] + 180.0) % 360.0 - 180.0)
    return found


def _shape(body: Body, scale: float, colour: str, inside: str) -> str:
    """A body, with the mark of its heading."""
    x, y, radius = body.x * scale, body.y * scale, body.radius * scale
    if body.shape != "disc":
        points = " ".join(f"{x + radius * dx:.4g},{y + radius * dy:.4g}" for dx, dy in corners(body))
        return f'<polygon points="{points}" fill="{colour}">{inside}</polygon>'
    disc = f'<circle cx="{x:.4g}" cy="{y:.4g}" r="{radius:.3g}" fill="{colour}">{inside}</circle>'
    if body.heading is None:
        return disc
    to_x, to_y = x + 0.9 * radius * math.cos(body.heading), y + 0.9 * radius * math.sin(body.heading)
    return (
        f'{disc}<line x1="{x:.4g}" y1="{y:.4g}" x2="{to_x:.4g}" y2="{to_y:.4g}" stroke="#fff" '
        f'stroke-width="{max(1.0, 0.28 * radius):.2g}"/>'
    )


def _still(way: Sequence[Body], scale: float, colours: dict[str, str]) -> str:
    points = " ".join(f"{body.x * scale:.4g},{body.y * scale:.4g}" for body in way)
    end = way[-1]
    colour = colours[end.kind]
    return (
        f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-opacity=".35" stroke-width="2"/>'
        f"{_shape(end, scale, colour, '')}"
    )


def _line(way: Sequence[Line], times: Sequence[float], scale: float, colours: dict[str, str], duration_s: float) -> str:
    ends = list(zip(("x1", "y1", "x2", "y2"), zip(*(line[1:] for line in way), strict=True), strict=True))
    moving = "".join(_animated(name, [f"{at * scale:.4g}" for at in values], times, duration_s) for name, values in ends)
    start = " ".join(f'{name}="{values[0] * scale:.4g}"' for name, values in ends)
    return f'<line {start} stroke="{colours[way[0].kind]}" stroke-width="3">{moving}</line>'


def _words(said: Sequence[Sequence[Label]], times: Sequence[float], scale: float, duration_s: float) -> list[str]:
    """Labels, each as long as it is there; none of them where they change all the time."""
    every = dict.fromkeys(label for labels in said for label in labels)
    if len(every) > MOST_WORDS:
        return []
    return [
        f'<text x="{label.x * scale:.4g}" y="{label.y * scale:.4g}" text-anchor="middle" dominant-baseline="middle" '
        f'style="font-size:{max(label.size * scale, 9):.3g}px" visibility="{shown[0]}">{escape(label.text)}'
        f"{_animated('visibility', shown, times, duration_s, discrete=True)}</text>"
        for label in every
        for shown in [["visible" if label in labels else "hidden" for labels in said]]
    ]


def _legend(kinds: Iterable[str], colours: dict[str, str], width: float, top: float) -> tuple[str, int]:
    """What the colours mean, in so many lines."""
    parts, x, row = [], 1.0, 0
    for kind in kinds:
        wide = 16 + LETTER * len(kind)
        if x > 1.0 and x + wide > width:
            x, row = 1.0, row + 1
        y = top + row * LINE
        parts.append(f'<rect x="{x:g}" y="{y - 10:g}" width="11" height="11" rx="2" fill="{colours[kind]}"/>')
        parts.append(f'<text x="{x + 16:g}" y="{y:g}">{escape(kind)}</text>')
        x += wide + 14
    return "".join(parts), row + 1
