"""A controller's trial as a moving picture: SVG that any browser plays, without a script.

Whoever wants no motion, and paper, gets the paths instead.
"""

import itertools
import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple

from zswarm.evaluate import turns
from zswarm.nets.representation import Representation
from zswarm.sims.simulator import Body, Frame, Simulator

NAMESPACE = "http://www.w3.org/2000/svg"  # of a file; not needed within HTML
SIDE, GAP = 420.0, 28.0  # pixels: of a panel, between two
TITLE, LINE, LETTER = 24.0, 21.0, 7.0  # pixels: above a panel, a line and a letter of text
MOST_FRAMES = 400
MOST_POSITIONS = 100_000  # of all bodies; more would make a picture of megabytes
MOST_TURNS = 200_000  # of a trial that is looked at, some seconds of computing
MOST_SEEN = 1_000_000  # positions that are kept of it, some hundred megabytes
FRAME_S, SHORTEST_S, LONGEST_S, HOLD_S = 0.12, 3.0, 12.0, 1.5  # the last picture stays for HOLD_S
KNOWN = {"blockade": "#8b9099", "exit": "#35a36b", "home": "#cfe3f5", "flag's stand": "#f2d16b"}
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442", "#000000")  # Okabe and Ito
STYLE = (
    ".zs{font:13px system-ui,sans-serif}.zs text{fill:#333}.zs .field{fill:#fafafa;stroke:#bbb}.zs .still{display:none}"
    "@media (prefers-color-scheme:dark){.zs text{fill:#ddd}}"
    "@media (prefers-reduced-motion:reduce){.zs .moving{display:none}.zs .still{display:inline}}"
    "@media print{.zs .moving{display:none}.zs .still{display:inline}}"
)


class Panel(NamedTuple):
    """One trial."""

    title: str
    frames: Sequence[Frame]


def frames(simulator: Simulator, representation: Representation, genome: bytes, seed: int) -> list[Frame]:
    """A trial, looked at after each round: whenever an agent is about to act a second time. Empty: nothing that can be drawn.

    A trial of more than ``MOST_TURNS`` or ``MOST_SEEN`` is left there.
    """
    seen: list[Frame] = []
    acted: set[int] = set()
    parameters = representation.parameters([genome] * simulator.participants)
    for turn in itertools.islice(turns(simulator, representation, parameters, seed), MOST_TURNS):
        if not seen or not acted.isdisjoint(turn.agents):
            if (frame := simulator.frame()) is None:
                return []
            if len(seen) * len(frame.bodies) > MOST_SEEN:
                break
            seen.append(frame)
            acted.clear()
        acted.update(turn.agents)
    if (last := simulator.frame()) is not None:
        seen.append(last)
    return seen if _drawable(seen) else []


def svg(panels: Sequence[Panel]) -> str:
    """Panels side by side, played together again and again."""
    longest = max(len(panel.frames) for panel in panels)
    play_s = min(max(longest * FRAME_S, SHORTEST_S), LONGEST_S)
    kinds = dict.fromkeys(kind for panel in panels for kind in _kinds(panel.frames))
    colours = {**dict(zip((kind for kind in kinds if kind not in KNOWN), itertools.cycle(PALETTE))), **KNOWN}
    parts, left, height = [], 1.0, 0.0
    for panel in panels:
        scale = SIDE / max(panel.frames[0].width, panel.frames[0].height)
        parts.append(
            f'<g transform="translate({left:g} {TITLE:g})"><text y="-8">{escape(panel.title)}</text>'
            f"{_panel(panel.frames, scale, play_s, colours, longest)}</g>"
        )
        left += panel.frames[0].width * scale + GAP
        height = max(height, panel.frames[0].height * scale)
    width = left - GAP + 1
    legend, rows = _legend(kinds, colours, width, TITLE + height + LINE)
    whole = f"{width:g} {TITLE + height + (rows + 0.6) * LINE:g}"
    size = f'viewBox="0 0 {whole}" width="{whole.split()[0]}" height="{whole.split()[1]}"'
    title = escape("; ".join(panel.title for panel in panels))
    return (
        f'<svg xmlns="{NAMESPACE}" class="zs" role="img" aria-label="{title}" {size}>'
        f"<style>{STYLE}</style>{''.join(parts)}{legend}</svg>\n"
    )


def _drawable(seen: Sequence[Frame]) -> bool:
    """A field that has a size, the same bodies in all frames, and each of them somewhere."""
    numbers = [
        (frame.width, frame.height, *(n for body in frame.bodies for n in (body.x, body.y, body.radius))) for frame in seen
    ]
    places = [n for place in seen[0].places for n in (place.x, place.y, place.width, place.height)] if seen else []
    return (
        all(frame.width > 0 < frame.height and len(frame.bodies) == len(seen[0].bodies) for frame in seen)
        and all(map(math.isfinite, itertools.chain(places, *numbers)))
    )  # fmt: skip


def _kinds(seen: Sequence[Frame]) -> list[str]:
    kinds = [place.kind for place in seen[0].places]
    kinds += [body.kind for frame in seen for body in frame.bodies]
    return list(dict.fromkeys(kinds))


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
    return f'{"".join(parts)}<g class="moving">{"".join(moving)}</g><g class="still">{"".join(still)}</g>'


def _moving(way: Sequence[Body], times: Sequence[float], scale: float, colours: dict[str, str], duration_s: float) -> str:
    animations = []
    for name, values, discrete in (
        ("cx", [f"{body.x * scale:.4g}" for body in way], False),
        ("cy", [f"{body.y * scale:.4g}" for body in way], False),
        ("fill", [colours[body.kind] for body in way], True),
    ):
        if len(set(values)) > 1:
            kept = [i for i in range(len(values)) if i in (0, len(values) - 1) or not values[i - 1] == values[i] == values[i + 1]]
            at = [f"{times[i]:.4f}" for i in kept] + ["1"]
            mode = ' calcMode="discrete"' if discrete else ""
            animations.append(
                f'<animate attributeName="{name}" dur="{duration_s:g}s" repeatCount="indefinite"{mode} '
                f'keyTimes="{";".join(at)}" values="{";".join([*(values[i] for i in kept), values[-1]])}"/>'
            )
    start = way[0]
    return (
        f'<circle cx="{start.x * scale:.4g}" cy="{start.y * scale:.4g}" r="{start.radius * scale:.3g}" '
        f'fill="{colours[start.kind]}">{"".join(animations)}</circle>'
    )


def _still(way: Sequence[Body], scale: float, colours: dict[str, str]) -> str:
    points = " ".join(f"{body.x * scale:.4g},{body.y * scale:.4g}" for body in way)
    end = way[-1]
    colour = colours[end.kind]
    return (
        f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-opacity=".35" stroke-width="2"/>'
        f'<circle cx="{end.x * scale:.4g}" cy="{end.y * scale:.4g}" r="{end.radius * scale:.3g}" fill="{colour}"/>'
    )


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
