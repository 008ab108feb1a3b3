"""Describe the arenas of e-puck robots: walls, floor, lamp, and where robots start.

Source of the arenas with 3, 4 and 6 sides: MissionGeneratorMG1 of the demiurge project.
"""

from typing import NamedTuple

import numpy as np

from zswarm.kernels.portable import PI
from zswarm.sims.epuck.world import BLACK, DISC, RECTANGLE, unit_vectors

Place = tuple[float, float, float, float, float, float]  # a row of ``EpuckWorld.floor``
Spot = tuple[float, float, float]  # the centre and the radius of a disc
# Centre, half sizes along its axes, height, and degrees that it is turned.
Box = tuple[float, float, float, float, float, float]

# Ways in which robots start: uniform in the disc's area; uniform in radius and angle, also not on
# spots of the floor.
IN_AREA, IN_RADIUS, OFF_SPOTS = range(3)


class Arena(NamedTuple):
    """An arena without its floor.

    Attributes:
        outer: its walls, whose centres are the points nearest to the middle.
        free: radius of a disc around the middle that touches no outer wall, m.
        half_side: of pictures, m.
        around: radius of the disc in which robots start, m.
    """

    outer: tuple[Box, ...]
    free: float
    half_side: float
    around: float


class Shape(NamedTuple):
    """A shape that missions are drawn in.

    Attributes:
        nests, sources, homes: where spots may be.
        obstacles: where walls may be inside.
        lamp: its place.
        first_half: angle at which the half begins in which robots start on one side.
    """

    arena: Arena
    nests: tuple[Spot, ...]
    sources: tuple[Spot, ...]
    homes: tuple[Spot, ...]
    obstacles: tuple[Box, ...]
    lamp: tuple[float, float, float]
    first_half: float


def disc(x: float, y: float, radius: float, grey: float = BLACK) -> Place:
    """Return a spot of the floor."""
    return (DISC, x, y, radius, radius, grey)


def rectangle(x: float, y: float, width: float, height: float, grey: float) -> Place:
    """Return a rectangle of the floor by its centre and its half sizes."""
    return (RECTANGLE, x, y, width, height, grey)


def wall_rows(boxes: tuple[Box, ...]) -> np.ndarray:
    """Return (walls, WALL_COLUMNS) of boxes."""
    cosines, sines = unit_vectors([degrees * PI / 180 for *_, degrees in boxes])
    rows = [
        [x, y, cosine, sine, half_x, half_y, top]
        for (x, y, half_x, half_y, top, _), cosine, sine in zip(
            boxes, cosines, sines, strict=True
        )
    ]
    return np.array(rows, np.float64)


# The dodecagon of the published files: walls of .01 x .66 x .08 m, coordinates rounded as there.
DODECAGON = Arena(
    tuple(
        (x, y, 0.005, 0.33, 0.08, degrees)
        for x, y, degrees in (
            *((-1.231, 0.0, 0), (1.231, 0.0, 0), (0.0, 1.231, 90), (0.0, -1.231, 90)),
            *((-0.615, -1.066, 60), (-1.066, -0.615, 30)),
            *((0.615, 1.066, 60), (1.066, 0.615, 30)),
            *((-0.615, 1.066, -60), (-1.066, 0.615, -30)),
            *((0.615, -1.066, -60), (1.066, -0.615, -30)),
        )
    ),
    free=1.225,
    half_side=1.25,
    around=1.2,
)

WALL, OBSTACLE = (0.055, 0.055), (0.026, 0.07)  # width and height, m
THIRD = 2 / 3
ROOT_2, ROOT_3 = 1.4142135623730951, 1.7320508075688772
MARGIN = 0.001  # m


def _polygon(
    side: float, inner: float, around: float, degrees: tuple[float, ...]
) -> Arena:
    """Return the arena of a regular polygon.

    Args:
        inner, around: radii of the circles in it and around it, m.
        degrees: directions of the walls' centres.
    """
    width, top = WALL
    away = inner + width / 2
    cosines, sines = unit_vectors([angle * PI / 180 for angle in degrees])
    walls = tuple(
        (away * cosine, away * sine, width / 2, side / 2, top, angle)
        for cosine, sine, angle in zip(
            cosines.tolist(), sines.tolist(), degrees, strict=True
        )
    )
    return Arena(walls, inner - MARGIN, around + WALL[0], around)


def _obstacles(length: float, *places: tuple[float, float, float]) -> tuple[Box, ...]:
    width, top = OBSTACLE
    return tuple((x, y, width / 2, length / 2, top, angle) for x, y, angle in places)


def _both(x: float, y: float, *radii: float) -> tuple[Spot, ...]:
    """Return spots at a place and at the one opposite."""
    return tuple((sign * x, sign * y, radius) for sign in (1.0, -1.0) for radius in radii)


def _triangle() -> Shape:
    side = 2.4
    inner, around = side / 2 / ROOT_3, side / ROOT_3
    arena = _polygon(side, inner, around, (60.0, -60.0, 180.0))
    corner = ROOT_3 / 2 * (around + WALL[0] / 2)
    return Shape(
        arena,
        nests=(
            *((0.0, 0.0, 0.15), (0.0, 0.0, 0.3)),
            *((around / 2, 0.0, 0.15), (around / 2, 0.0, 0.3), (around, 0.0, 0.4)),
        ),
        sources=(
            *((0.0, 0.0, 0.15), (around / 2, 0.0, 0.15), (around, 0.0, 0.4)),
            *((-inner / 2, corner / 2, 0.15), (-inner / 2, -corner / 2, 0.15)),
            *((-inner, corner, 0.4), (-inner, -corner, 0.4)),
        ),
        homes=(
            *((0.0, 0.0, 0.3), (around / 2, 0.0, 0.3)),
            *((-inner / 2, corner / 2, 0.3), (-inner / 2, -corner / 2, 0.3)),
        ),
        obstacles=_obstacles(
            0.25,
            (-inner / 4, -corner / 4, 60.0),
            (-inner / 4, corner / 4, -60.0),
            (around / 4, 0.0, 0.0),
        ),
        lamp=(-inner - 0.2, 0.0, 0.4),
        first_half=PI / 2,
    )


def _square() -> Shape:
    side = 1.94
    around = side / ROOT_2
    arena = _polygon(side, side / 2, around, (45.0, -135.0, -45.0, 135.0))
    out = around * THIRD
    return Shape(
        arena,
        nests=(
            *((0.0, 0.0, 0.15), (0.0, 0.0, 0.3)),
            *_both(0.0, around, 0.4),
            *_both(0.0, out, 0.15, 0.3),
        ),
        sources=(
            *((0.0, 0.0, 0.15), *_both(0.0, around, 0.4), *_both(around, 0.0, 0.4)),
            *(*_both(0.0, out, 0.15), *_both(out, 0.0, 0.15)),
        ),
        homes=((0.0, 0.0, 0.3), *_both(0.0, out, 0.3), *_both(out, 0.0, 0.3)),
        obstacles=_obstacles(
            0.45,
            *((0.0, out / 2, 90.0), (0.0, -out / 2, 90.0)),
            *((out / 2, 0.0, 0.0), (-out / 2, 0.0, 0.0)),
        ),
        lamp=(0.0, -1.61, 0.4),
        first_half=0.0,
    )


def _hexagon() -> Shape:
    side = around = 1.29
    inner = side / 2 * ROOT_3
    directions = (60.0, -120.0, -60.0, 120.0, 0.0, 180.0)
    arena = _polygon(side, inner, around, directions)
    out, aside = around * THIRD, inner * THIRD
    corner = THIRD * (around + WALL[0] / 2)
    x, y = corner * ROOT_3 / 2, corner / 2
    return Shape(
        arena,
        nests=(
            *((0.0, 0.0, 0.15), (0.0, 0.0, 0.3)),
            *_both(0.0, around, 0.4),
            *_both(0.0, out, 0.15, 0.3),
        ),
        sources=(
            *((0.0, 0.0, 0.15), *_both(0.0, around, 0.4), *_both(0.0, out, 0.15)),
            *(*_both(aside, 0.0, 0.15), *_both(x, y, 0.15), *_both(x, -y, 0.15)),
        ),
        homes=((0.0, 0.0, 0.3), *_both(0.0, out, 0.3), *_both(aside, 0.0, 0.3)),
        obstacles=_obstacles(
            0.35,
            *((0.0, aside / 2, 90.0), (0.0, -aside / 2, 90.0)),
            *((aside / 2, 0.0, 0.0), (-aside / 2, 0.0, 0.0)),
        ),
        lamp=(0.0, -around - 0.2, 0.4),
        first_half=0.0,
    )


TRIANGLE, SQUARE, HEXAGON = _triangle(), _square(), _hexagon()
