"""Score the missions of e-puck robots, and describe their arenas.

Each mission is that of the field's published files; docs/epuck.md names them.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import NamedTuple

import numpy as np

from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.portable import PI, cos, sin
from zswarm.kernels.random import draw_uniform
from zswarm.sims.epuck.arenas import (
    DODECAGON,
    HEXAGON,
    IN_AREA,
    IN_RADIUS,
    THIRD,
    Box,
    Grounds,
    Place,
    disc,
    rectangle,
)
from zswarm.sims.epuck.world import (
    BLACK,
    CARRIES,
    PLACE_X,
    PLACE_Y,
    SIZE_X,
    WHITE,
    X,
    Y,
)


class Mission(NamedTuple):
    """A mission as published.

    Attributes:
        lamp: its place and intensity.
        hearing: range of messages, m.
        floor: the first that contains a point gives its grey.
        walls: inside of the arena.
        start: the way in which robots start.
        sector: from which angle to which one they start.
        score: one of ``SCORES``; empty: its own.
        spots: the first of ``floor`` which are homes or nests.
        at_end: only the last step counts.
    """

    seconds: float
    lamp: tuple[float, float, float, float]
    hearing: float
    floor: tuple[Place, ...] = ()
    walls: tuple[Box, ...] = ()
    robots: int = 20
    arena: Grounds = DODECAGON
    start: int = IN_AREA
    sector: tuple[float, float] = (0.0, 2.0 * PI)
    score: str = ""
    spots: int = 0
    at_end: bool = False


STUDY_LAMP, NO_LAMP = (0.0, -1.25, 0.75, 5.0), (0.0, -1.25, 0.75, 0.0)
SOUTH_LAMP, NORTH_LAMP = (0.0, -1.5, 0.4, 3.0), (0.0, 1.5, 0.4, 2.0)
SPOTS = disc(0.0, 0.6, 0.3, BLACK), disc(0.0, -0.6, 0.3, WHITE)
SHELTER = (
    (0.0, -0.1, 0.325, 0.025, 0.2, 0.0),
    (-0.3125, -0.025, 0.025, 0.1, 0.2, 0.0),
    (0.3125, -0.025, 0.025, 0.1, 0.2, 0.0),
)
MISSIONS = {
    "aggregation": Mission(120.0, STUDY_LAMP, 0.5, SPOTS),
    "foraging": Mission(
        120.0,
        STUDY_LAMP,
        0.5,
        (
            disc(0.75, 0.0, 0.25, BLACK),
            disc(-0.75, 0.0, 0.25, BLACK),
            rectangle(0.0, -1.6, 2.0, 1.0, WHITE),
        ),
    ),
    "grid-exploration": Mission(120.0, NO_LAMP, 0.5),
    "aac": Mission(60.0, SOUTH_LAMP, 0.7, SPOTS),
    "sca": Mission(
        60.0,
        NORTH_LAMP,
        0.7,
        (
            disc(0.8, -0.1, 0.3, BLACK),
            disc(-0.8, -0.1, 0.3, BLACK),
            rectangle(0.0, 0.0, 0.3, 0.075, WHITE),
        ),
        SHELTER,
    ),
    "spc": Mission(
        60.0,
        (0.0, 1.5, 0.4, 0.0),
        0.7,
        (rectangle(-0.6, 0.0, 0.3, 0.3, WHITE), disc(0.6, 0.0, 0.3, BLACK)),
    ),
    "lcn": Mission(60.0, NORTH_LAMP, 0.7),
    "cfa": Mission(
        60.0,
        SOUTH_LAMP,
        0.7,
        (
            disc(0.5, 0.5, 0.3, BLACK),
            disc(0.5, -0.5, 0.3, BLACK),
            disc(-0.5, 0.0, 0.3, BLACK),
        ),
    ),
}
MISSIONS["cfa-corrected"] = MISSIONS["cfa"]
# A mission of the kind and in an arena that ``generated`` draws, too.
MISSIONS["homing"] = Mission(
    120.0,
    (*HEXAGON.lamp, 5.0),
    0.5,
    (disc(0.0, HEXAGON.arena.around * THIRD, 0.3, WHITE),),
    arena=HEXAGON.arena,
    start=IN_RADIUS,
    score="homing",
    spots=1,
)
NAMES = (*MISSIONS, "generated")
# Those of the missions, and those of spots anywhere.
SCORES = (*list(MISSIONS)[:9], "homing", "one-spot", "deliveries")
AGGREGATION, FORAGING, GRID_EXPLORATION, AAC, SCA, SPC, LCN, CFA, CFA_CORRECTED = range(9)
HOMING, ONE_SPOT, DELIVERIES = range(9, 12)

SIDE = 2.50001  # m, of the square that grid exploration divides
CELLS = 10  # per side
COVERING = 1_000  # random points of each of SPC's distances
COVERAGE = 10_000  # random points of CFA's distance, and of LCN's area
LINK, DISC_RADIUS = (
    0.35,
    0.25,
)  # LCN: the distance that links robots, and what each covers
ARENA_RADIUS = 1.2
TOTAL, HEARINGS, FIRST_CELL = range(3)  # of ``tally``


@inline(counts=False, inner=True, copied=False)
def score(world):
    """Add the score of a step."""
    robots = world.robots
    mission = world.mission
    if mission in (AGGREGATION, AAC):
        for robot in range(world.number):
            if within(robots[X, robot], robots[Y, robot] - 0.6, 0.3):
                world.tally[TOTAL] += 1.0
    elif mission == SCA:
        for robot in range(world.number):
            if abs(robots[X, robot]) < 0.3 and abs(robots[Y, robot]) < 0.075:
                world.tally[TOTAL] += 1.0
    elif mission == FORAGING:
        for robot in range(world.number):
            forage(world, robot)
    elif mission == GRID_EXPLORATION:
        explore(world)
    elif mission >= HOMING:
        count_spots(world)


@inline(counts=False, inner=True)
def count_spots(world):
    """Count robots on spots: on all homes, on the home with most, or those that deliver."""
    robots = world.robots
    most = 0.0
    total = 0.0
    for spot in range(world.spots):
        here = 0.0
        for robot in range(world.number):
            if world.mission == DELIVERIES:
                if spot == 0 and on_spots(
                    world, robot, world.spots, world.floor.shape[0]
                ):
                    robots[CARRIES, robot] = 1.0
                if on_spots(world, robot, spot, spot + 1):
                    here += robots[CARRIES, robot]
                    robots[CARRIES, robot] = 0.0
            elif on_spots(world, robot, spot, spot + 1):
                here += 1.0
        total += here
        most = max(most, here)
    if world.at_end > 0:
        world.tally[TOTAL] = 0.0
    world.tally[TOTAL] += most / world.number if world.mission == ONE_SPOT else total


@inline(counts=False, inner=True)
def on_spots(world, robot, first, end):
    """Return whether a robot is on one of some discs of the floor."""
    for spot in range(first, end):
        dx = world.robots[X, robot] - world.floor[spot, PLACE_X]
        dy = world.robots[Y, robot] - world.floor[spot, PLACE_Y]
        if within(dx, dy, world.floor[spot, SIZE_X]):
            return True
    return False


@inline(counts=False, inner=True)
def within(dx, dy, radius):
    """Return whether an offset is not longer than a radius."""
    return dx * dx + dy * dy <= radius * radius


@inline(counts=False, inner=True)
def forage(world, robot):
    """Let a robot load at a source and deliver in the nest."""
    robots = world.robots
    x = robots[X, robot]
    y = robots[Y, robot]
    if within(x - 0.75, y, 0.25) or within(x + 0.75, y, 0.25):
        robots[CARRIES, robot] = 1.0
    elif y <= -0.6:
        world.tally[TOTAL] += robots[CARRIES, robot]
        robots[CARRIES, robot] = 0.0


@inline(counts=False, inner=True)
def explore(world):
    """Reset the counters of visited cells; add all counters, then count one step."""
    robots = world.robots
    cells = world.tally
    for robot in range(world.number):
        column = int(np.floor(CELLS * (robots[X, robot] / SIDE + 0.5)))
        row = int(np.floor(CELLS * (robots[Y, robot] / SIDE + 0.5)))
        if 0 <= column < CELLS and 0 <= row < CELLS:
            cells[FIRST_CELL + CELLS * row + column] = 0.0
    for cell in range(FIRST_CELL, FIRST_CELL + CELLS * CELLS):
        world.tally[TOTAL] -= cells[cell]
        cells[cell] += 1.0


@inline(counts=False, copied=False)
def judge(world, fitness, metrics):
    """Write the score of a trial; higher is better. Further calls draw the same points."""
    mission = world.mission
    state = world.stream[0]
    if mission == GRID_EXPLORATION:
        fitness[0] = world.tally[TOTAL] / (CELLS * CELLS)
    elif mission == SPC:
        fitness[0] = -(cover_square(world) / 0.08 + cover_circle(world) / 0.06)
    elif mission == LCN:
        fitness[0] = largest_area(world)
    elif mission == CFA:
        fitness[0] = 250.0 - 100.0 * coverage_distance(world, 1) / COVERAGE
    elif mission == CFA_CORRECTED:
        fitness[0] = 250.0 - 100.0 * coverage_distance(world, COVERAGE) / COVERAGE
    else:
        fitness[0] = world.tally[TOTAL]
    world.stream[0] = state
    metrics[0] = world.tally[HEARINGS] / (world.steps * world.number)


@inline(counts=False, inner=True)
def nearest(world, x, y, taken, none):
    """Return the distance from a point to the nearest robot that is taken; ``none`` without."""
    robots = world.robots
    least = -1.0
    for robot in range(world.number):
        if taken[robot] > 0.0:
            dx = robots[X, robot] - x
            dy = robots[Y, robot] - y
            square = dx * dx + dy * dy
            if least < 0.0 or square < least:
                least = square
    return none if least < 0.0 else sqrt(least)


@inline(counts=False, inner=True, copied=False)
def cover_square(world):
    """Return the mean distance of points of the white square to the robots in it."""
    robots = world.robots
    taken = robots[CARRIES]
    for robot in range(world.number):
        dx = abs(robots[X, robot] + 0.6)
        inside = dx <= 0.3 and abs(robots[Y, robot]) <= 0.3
        taken[robot] = 1.0 if inside else 0.0
    total = 0.0
    for _ in range(COVERING):
        x = -0.9 + 0.6 * draw_uniform(world.stream)
        y = -0.3 + 0.6 * draw_uniform(world.stream)
        total += nearest(world, x, y, taken, 0.85)
    return total / COVERING


@inline(counts=False, inner=True, copied=False)
def cover_circle(world):
    """Return the mean distance of points of the black circle's line to the robots on it."""
    robots = world.robots
    taken = robots[CARRIES]
    for robot in range(world.number):
        dx = robots[X, robot] - 0.6
        distance = sqrt(dx * dx + robots[Y, robot] * robots[Y, robot])
        taken[robot] = 1.0 if 0.26 <= distance <= 0.34 else 0.0
    total = 0.0
    for _ in range(COVERING):
        angle = 2.0 * PI * draw_uniform(world.stream)
        x = 0.6 + 0.3 * cos(angle)
        total += nearest(world, x, 0.3 * sin(angle), taken, 0.6)
    return total / COVERING


@inline(counts=False, inner=True, copied=False)
def coverage_distance(world, points):
    """Return the sum of the distances of random points to the robots that are not on black.

    The points are uniform in radius and angle, not in area, as published.
    """
    robots = world.robots
    taken = robots[CARRIES]
    for robot in range(world.number):
        x = robots[X, robot]
        y = robots[Y, robot]
        black = within(x - 0.5, y - 0.5, 0.3) or within(x - 0.5, y + 0.5, 0.3)
        taken[robot] = 0.0 if black or within(x + 0.5, y, 0.3) else 1.0
    total = 0.0
    for _ in range(points):
        radius = ARENA_RADIUS * draw_uniform(world.stream)
        angle = 2.0 * PI * draw_uniform(world.stream)
        total += nearest(world, radius * cos(angle), radius * sin(angle), taken, 2.5)
    return total


@inline(counts=False, inner=True, copied=False)
def largest_area(world):
    """Return the area in m^2 that the largest connected group covers."""
    robots = world.robots
    number = world.number
    group = robots[CARRIES]  # the number of each robot's group, from 1
    for robot in range(number):
        group[robot] = 0.0
    groups = 0.0
    largest = 0.0
    members = 0
    for first in range(number):
        if group[first] > 0.0:
            continue
        groups += 1.0
        group[first] = groups
        size = 1
        grown = True
        while grown:
            grown = False
            for robot in range(number):
                for other in range(number):
                    if group[robot] == groups and group[other] == 0.0:
                        dx = robots[X, other] - robots[X, robot]
                        dy = robots[Y, other] - robots[Y, robot]
                        if dx * dx + dy * dy < LINK * LINK:
                            group[other] = groups
                            size += 1
                            grown = True
        if size > members:
            members = size
            largest = groups
    return covered_by(world, group, largest)


@inline(counts=False, inner=True, copied=False)
def covered_by(world, group, which):
    """Return the area of the union of discs around the robots of a group, by random points."""
    robots = world.robots
    low_x = low_y = 2.0 * ARENA_RADIUS
    high_x = high_y = -2.0 * ARENA_RADIUS
    for robot in range(world.number):
        if group[robot] == which:
            low_x = min(low_x, robots[X, robot] - DISC_RADIUS)
            high_x = max(high_x, robots[X, robot] + DISC_RADIUS)
            low_y = min(low_y, robots[Y, robot] - DISC_RADIUS)
            high_y = max(high_y, robots[Y, robot] + DISC_RADIUS)
        else:
            group[robot] = 0.0
    hits = 0
    for _ in range(COVERAGE):
        x = low_x + (high_x - low_x) * draw_uniform(world.stream)
        y = low_y + (high_y - low_y) * draw_uniform(world.stream)
        if within(x, y, ARENA_RADIUS):
            distance = nearest(world, x, y, group, 2.0 * ARENA_RADIUS)
            hits += 1 if distance <= DISC_RADIUS else 0
    return (high_x - low_x) * (high_y - low_y) * hits / COVERAGE
