"""Compute the world of ``arena``: round robots that see, hear and push each other in a room.

All is ``+ - * /`` and square roots of float32; docs/simulators.md has the formulas. Each step sorts
robots into cells at least as wide as their sight, so that each robot searches nine cells only: a
step takes time in proportion to the robots. Eight lanes compute the eight rays.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import NamedTuple

import numpy as np

from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.lanes import LANES, list_true, load, select, store
from zswarm.kernels.signatures import Float32Rows, Float64s, Int32Rows, Int32s, UInt64s
from zswarm.sims.trial import LANE_NUMBERS

ZERO, HALF, ONE, TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
THREE_HALVES = np.float32(1.5)
# The least divisor: a ray's component towards a wall, and the distance of two robots in m.
TINY = np.float32(1e-6)
DIAGONAL = np.float32(0.70710678)
RAYS = np.array(  # x and then y in a robot's frame, 45 degrees apart, the first ahead
    [
        *(ONE, DIAGONAL, ZERO, -DIAGONAL, -ONE, -DIAGONAL, ZERO, DIAGONAL),
        *(ZERO, DIAGONAL, ONE, DIAGONAL, ZERO, -DIAGONAL, -ONE, -DIAGONAL),
    ]
)
WORLD_INPUTS = LANES + 2

# ``robots``: a row for each; NEAREST: the square of the distance to the nearest neighbour.
X, Y, HEADING_X, HEADING_Y, PUSH_X, PUSH_Y, NEIGHBOURS, NEAREST, SAID, HEARD = range(10)
CARRIES, READING, ROBOT_ROWS = range(10, 13)
# ``queue``: X, Y and what was said, in the order of cells.
QUEUE_SAID, QUEUE_ROWS = range(2, 4)
# ``places``: of a robot its cell; the robots in the order of cells; where in that order neighbours
# are.
CELL, ORDER, NEAR, PLACE_ROWS = range(4)
# ``tally``: of the trial.
STEP_NUMBER, MEASURED, CONTACTS, FOUND, DELIVERED, TRUTH, FIRST, SECOND, TALLIES = range(
    9
)


class ArenaWorld(NamedTuple):
    """Settings, with lengths in m, and the state of a trial.

    The tables ``robots``, ``queue`` and ``places`` have eight columns more than there are robots.
    """

    task: int
    steps: int
    number: int  # of robots
    per_side: int  # cells
    side: np.float32
    sight: np.float32
    radius: np.float32
    half_stride: np.float32  # half the way of a step at full speed
    half_turn: np.float32  # t per difference of the wheels, each from -1 to 1
    cells_per_metre: np.float32
    nest: np.float32
    noise: np.float32
    robots: Float32Rows
    queue: Float32Rows
    places: Int32Rows
    cells: Int32s  # (cells + 2,), the position in ``queue`` at which each cell begins
    items: Float32Rows  # X and Y
    tally: Float64s
    stream: UInt64s


def cells_per_side(side: float, sight: float, robots: int) -> int:
    """Return the rows and columns of cells in the room; 1 if more would exclude no robot."""
    cells = min(int(0.999 * side / sight), int(np.sqrt(robots)))
    return cells if cells > 2 else 1


@inline(counts=False, inner=True)
def cut(output):
    """Return an output limited to 0..1; 0 for NaN."""
    positive = select(output > ZERO, output, ZERO)
    return select(positive < ONE, positive, ONE)


@inline(counts=False, inner=True)
def at_least(number, least):
    """Return the greater of two, also of lanes, which Python's ``max`` does not accept."""
    return select(number > least, number, least)


@inline(counts=False, inner=True)
def sort(world):
    """Sort robots by cell, row after row, and by index within a cell."""
    robots = world.robots
    places = world.places
    cells = world.cells
    per_side = world.per_side
    cells[:] = 0
    if per_side == 1:  # they are in order
        cells[1:] = world.number
        for robot in range(world.number):
            line_up(world, robot, robot)
        return
    for robot in range(world.number):
        column = min(int(robots[X, robot] * world.cells_per_metre), per_side - 1)
        row = min(int(robots[Y, robot] * world.cells_per_metre), per_side - 1)
        places[CELL, robot] = row * per_side + column
        cells[row * per_side + column + 2] += 1
    for cell in range(2, cells.shape[0]):
        cells[cell] += cells[cell - 1]
    for robot in range(world.number):
        after = places[CELL, robot] + 1  # begins one too far left until all are placed
        line_up(world, robot, cells[after])
        cells[after] += 1


@inline(counts=False, inner=True)
def line_up(world, robot, at):
    """Put a robot into the queue."""
    world.places[ORDER, at] = robot
    world.queue[X, at] = world.robots[X, robot]
    world.queue[Y, at] = world.robots[Y, robot]
    world.queue[QUEUE_SAID, at] = world.robots[SAID, robot]


@inline(counts=False)
def look(world, observations):
    """Write observations of all robots, sums of what they hear, and how they are pushed."""
    sort(world)
    inputs = observations.shape[0] // world.number
    contacts = 0
    for row in range(world.per_side):
        for column in range(world.per_side):
            cell = row * world.per_side + column
            for place in range(world.cells[cell], world.cells[cell + 1]):
                robot = world.places[ORDER, place]
                near = find(world, place, row, column)
                contacts += meet(world, robot, near, observations, inputs * robot)
    world.tally[CONTACTS] += contacts


@inline(counts=False, inner=True)
def find(world, place, row, column):
    """List the robots in sight of the robot at a place of the queue.

    Returns:
        their number.
    """
    queue = world.queue
    cells = world.cells
    per_side = world.per_side
    x = queue[X, place]
    y = queue[Y, place]
    lanes = load(LANE_NUMBERS, 0)
    first = max(column - 1, 0)
    last = min(column + 1, per_side - 1)
    near = 0
    for other_row in range(max(row - 1, 0), min(row + 2, per_side)):
        end = cells[other_row * per_side + last + 1]
        for at in range(cells[other_row * per_side + first], end, LANES):
            dx = load(queue[X], at) - x
            dy = load(queue[Y], at) - y
            is_near = dx * dx + dy * dy < world.sight * world.sight
            which = is_near & (lanes < end - at) & (lanes != place - at)
            near += list_true(which, at, world.places[NEAR], near)
    return near


@inline(counts=False, inner=True)
def meet(world, robot, near, observations, at):
    """Write a robot's observation from ``at`` on, what it hears, and how neighbours push it.

    Returns:
        the number of neighbours that overlap it.
    """
    robots = world.robots
    queue = world.queue
    sight = world.sight
    x = robots[X, robot]
    y = robots[Y, robot]
    heading_x = robots[HEADING_X, robot]
    heading_y = robots[HEADING_Y, robot]
    ray_x = load(RAYS, 0)
    ray_y = load(RAYS, LANES)
    disc = world.radius * world.radius
    touch = world.radius + world.radius
    sum_x = sum_y = push_x = push_y = heard = ZERO
    nearest = sight * sight
    along_x = heading_x * ray_x - heading_y * ray_y
    along_y = heading_y * ray_x + heading_x * ray_y
    reach = at_most(to_wall(x, along_x, world.side), to_wall(y, along_y, world.side))
    reach = at_most(reach, sight)
    contacts = 0
    for neighbour in range(near):
        other = world.places[NEAR, neighbour]
        dx = queue[X, other] - x
        dy = queue[Y, other] - y
        ahead = dx * heading_x + dy * heading_y
        aside = dy * heading_x - dx * heading_y
        sum_x += ahead
        sum_y += aside
        heard += queue[QUEUE_SAID, other]
        centre = ahead * ray_x + aside * ray_y
        off = aside * ray_x - ahead * ray_y
        # The square of half of what the ray's line has within the robot.
        chord = disc - off * off
        hit = centre - sqrt(at_least(chord, ZERO))
        reach = select((chord > ZERO) & (centre > ZERO) & (hit < reach), hit, reach)
        square = dx * dx + dy * dy
        nearest = at_most(square, nearest)
        if square < touch * touch:
            contacts += 1
            distance = sqrt(square)
            share = HALF * (touch - distance) / at_least(distance, TINY)
            push_x -= share * dx
            push_y -= share * dy
    per_sight = ONE / sight
    per_neighbour = per_sight / np.float32(max(near, 1))
    store(observations, at, ONE - reach * per_sight)
    observations[at + LANES] = sum_x * per_neighbour
    observations[at + LANES + 1] = sum_y * per_neighbour
    robots[PUSH_X, robot] = push_x
    robots[PUSH_Y, robot] = push_y
    robots[NEIGHBOURS, robot] = np.float32(near)
    robots[NEAREST, robot] = nearest
    robots[HEARD, robot] = heard
    return contacts


@inline(counts=False, inner=True)
def at_most(number, most):
    """Return the smaller of two, also of lanes."""
    return select(number < most, number, most)


@inline(counts=False, inner=True)
def to_wall(place, along, side):
    """Return the distances along rays to the wall in one dimension of the room."""
    size = select(along < ZERO, ZERO - along, along)
    return select(along > ZERO, side - place, place) / at_least(size, TINY)


@inline(counts=False, inner=True)
def drive(world, actions):
    """Turn and move all robots by wheels and pushes, eight at once; walls stop them."""
    robots = world.robots
    low = world.radius
    high = world.side - world.radius
    for first in range(0, world.number, LANES):
        left = TWO * cut(load(actions, first)) - ONE
        right = TWO * cut(load(actions, world.number + first)) - ONE
        t = (right - left) * world.half_turn
        forward = (left + right) * world.half_stride
        per_square = ONE / (ONE + t * t)
        cosine = (ONE - t * t) * per_square
        sine = (t + t) * per_square
        heading_x = load(robots[HEADING_X], first)
        heading_y = load(robots[HEADING_Y], first)
        x = cosine * heading_x - sine * heading_y
        y = cosine * heading_y + sine * heading_x
        per_length = THREE_HALVES - HALF * (x * x + y * y)  # a step of Newton's method
        x = x * per_length
        y = y * per_length
        store(robots[HEADING_X], first, x)
        store(robots[HEADING_Y], first, y)
        to_x = load(robots[X], first) + forward * x + load(robots[PUSH_X], first)
        to_y = load(robots[Y], first) + forward * y + load(robots[PUSH_Y], first)
        store(robots[X], first, at_most(at_least(to_x, low), high))
        store(robots[Y], first, at_most(at_least(to_y, low), high))
