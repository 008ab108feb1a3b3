"""How things look, alike in films, GIFs and the player: colours of kinds, corners of shapes."""

import math
import re
from collections.abc import Sequence
from typing import Any

from zswarm.sims.simulator import Body, Frame

# On light and on dark pages by name; the player has them as ``--zp-NAME``.
COLOURS = {
    "wall": ("#686f78", "#6b737c"),
    "exit": ("#009e73", "#2fbf92"),
    "home": ("#a9d3f0", "#29485c"),
    "home-2": ("#f3cdb0", "#5c4029"),
    "flag": ("#e3c22b", "#f2d84b"),
    "flag-2": ("#b98a00", "#c79a2a"),
    "floor-black": ("#111111", "#111111"),
    "floor-grey": ("#bbbbbb", "#bbbbbb"),
    "floor-white": ("#ffffff", "#ffffff"),
    # The palette of Okabe and Ito, darker or lighter where it would be pale.
    "c1": ("#0072b2", "#56b4e9"),
    "c2": ("#d55e00", "#f0813a"),
    "c3": ("#009e73", "#2fbf92"),
    "c4": ("#a8457f", "#e39ac2"),
    "c5": ("#b87800", "#e69f00"),
    "c6": ("#2f8fc7", "#9bd0f2"),
    "c7": ("#7a6a00", "#f0e442"),
    "c8": ("#333333", "#dddddd"),
}
PALETTE = [name for name in COLOURS if re.fullmatch(r"c\d", name)]
# They are in the colours of the palette.
AGENT = re.compile(r"(robot|opponent|cart|defender)\b(?!.*says)")
# Colours of words in a kind; the first one that it contains counts. docs/own-simulator.md has both
# tables.
WORDS = {
    "opponents' home": "home-2",
    "opponents' flag": "flag-2",
    "black floor": "floor-black",
    "grey floor": "floor-grey",
    "white floor": "floor-white",
    "wall": "wall",
    "blockade": "wall",
    "track": "wall",
    "rod": "wall",
    "exit": "exit",
    "goal": "exit",
    "right": "exit",
    "nest": "home",
    "home": "home",
    "flag": "flag",
    "light": "flag",
    "lamp": "flag",
    "wrong": "c2",
    "too much": "c2",
    "too little": "c1",
}
# The first corner in half turns, the number of corners, and their distance in radii.
SHAPES = {
    "square": (0.25, 4, math.sqrt(2)),
    "diamond": (0.0, 4, 1.1),
    "triangle": (-0.5, 3, 1.2),
}


def kinds(
    *trials: Sequence[Frame], shown: dict[str, str] | None = None
) -> dict[str, str]:
    """Return all kinds in the order in which they occur, each with the name of its colour.

    Args:
        shown: kinds of other pictures with their colours, which apply here, too; new kinds are
            added.
    """
    found: dict[str, None] = {}
    for frames in trials:
        found |= dict.fromkeys(place.kind for place in frames[0].places)
        found |= dict.fromkeys(line.kind for line in frames[0].lines)
        found |= dict.fromkeys(body.kind for frame in frames for body in frame.bodies)
    shown = {} if shown is None else shown
    for kind in found:
        free = sum(not _stated(other) for other in shown)
        shown.setdefault(kind, _stated(kind) or PALETTE[free % len(PALETTE)])
    return {kind: shown[kind] for kind in found}


def _stated(kind: str) -> str:
    """Return the name of the colour that a word in a kind states, or ""."""
    if AGENT.match(kind):
        return ""
    found = (name for word, name in WORDS.items() if re.search(rf"\b{word}s?\b", kind))
    return next(found, "")


def colours(*trials: Sequence[Frame]) -> dict[str, str]:
    """Return the colour of each kind, for pictures that are always light."""
    return {kind: COLOURS[name][0] for kind, name in kinds(*trials).items()}


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
