"""How things look, alike in films, GIFs and the player: colours of kinds, corners of shapes."""

import itertools
import math
import re
from collections.abc import Sequence
from typing import Any

from zswarm.sims.simulator import Body, Frame

# By name; the player has them as ``--zp-NAME``, for light and dark pages.
COLOURS = {
    "wall": "#8b9099",
    "exit": "#35a36b",
    "home": "#cfe3f5",
    "home-2": "#f6d9c4",
    "flag": "#f2d16b",
    "flag-2": "#d9a300",
    # The palette of Okabe and Ito.
    "c1": "#0072b2",
    "c2": "#d55e00",
    "c3": "#009e73",
    "c4": "#cc79a7",
    "c5": "#e69f00",
    "c6": "#56b4e9",
    "c7": "#f0e442",
    "c8": "#000000",
}
# They are in the colours of the palette.
AGENT = re.compile(r"(robot|opponent|cart|defender)\b(?!.*says)")
KNOWN = {
    "^opponents' home": "home-2",
    "^opponents' flag": "flag-2",
    "wall|blockade|track|^rod$": "wall",
    "exit|goal|right": "exit",
    "nest|home|white floor": "home",
    "black floor": "c8",
    "flag's stand|^light$|^lamp$": "flag",
    "wrong|too much": "c2",
    "too little": "c1",
}
# The first corner in half turns, the number of corners, and their distance in radii.
SHAPES = {
    "square": (0.25, 4, math.sqrt(2)),
    "diamond": (0.0, 4, 1.1),
    "triangle": (-0.5, 3, 1.2),
}


def kinds(*trials: Sequence[Frame]) -> dict[str, str]:
    """Return all kinds in the order in which they occur, each with the name of its colour."""
    found: dict[str, None] = {}
    for frames in trials:
        found |= dict.fromkeys(place.kind for place in frames[0].places)
        found |= dict.fromkeys(line.kind for line in frames[0].lines)
        found |= dict.fromkeys(body.kind for frame in frames for body in frame.bodies)
    palette = itertools.cycle(name for name in COLOURS if name.startswith("c"))
    return {kind: _known(kind) or next(palette) for kind in found}


def _known(kind: str) -> str:
    if AGENT.match(kind):
        return ""
    return next((name for pattern, name in KNOWN.items() if re.search(pattern, kind)), "")


def colours(*trials: Sequence[Frame]) -> dict[str, str]:
    """Return the colour of each kind, for pictures that are always light."""
    return {kind: COLOURS[name] for kind, name in kinds(*trials).items()}


def scaled(frame: Frame, scale: float) -> Frame:
    """Return what moves in a frame, in pixels."""
    bodies = [
        body._replace(x=body.x * scale, y=body.y * scale, radius=body.radius * scale)
        for body in frame.bodies
    ]
    lines, labels = sized(frame.lines, scale), sized(frame.labels, scale)
    return Frame(frame.width * scale, frame.height * scale, [], bodies, lines, labels)


def sized(things: Sequence[Any], scale: float) -> list[Any]:
    """Return rectangles, lines or labels in pixels: a text and numbers each."""
    return [type(one)(one[0], *(number * scale for number in one[1:])) for one in things]


def corners(body: Body) -> list[tuple[float, float]]:
    """Return the corners of a body that is not a disc."""
    first, count, reach = SHAPES[body.shape]
    return [
        _at(body, reach, math.pi * (first + 2 * corner / count) + (body.heading or 0.0))
        for corner in range(count)
    ]


def nose(body: Body) -> tuple[float, float]:
    """Return the end of the line from the centre of a disc that shows its heading."""
    return _at(body, 0.9, body.heading or 0.0)


def _at(body: Body, reach: float, angle: float) -> tuple[float, float]:
    """Return the point that is so many radii from the centre of a body, in a direction."""
    distance = reach * body.radius
    return body.x + distance * math.cos(angle), body.y + distance * math.sin(angle)
