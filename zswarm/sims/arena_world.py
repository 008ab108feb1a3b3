"""The world of ``arena``: a square room with walls, and round robots on two wheels that see, hear and push one another.

All is ``+ - * /`` and square roots of float32. A heading is a unit vector and turns by 2 atan(t), which needs no sine:
cos = (1 - t^2) / (1 + t^2) and sin = 2 t / (1 + t^2).

Robots are sorted into cells no narrower than their sight in each step, so that each looks at those of nine cells only: a step
takes time in proportion to the robots. The eight rays are computed side by side.
"""

import numpy as np

from zswarm.jit import inline, sqrt
from zswarm.lanes import LANES, list_true, load, select, store

ZERO, HALF, ONE, THREE_HALVES, TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(1.5), np.float32(2)
TINY = np.float32(1e-6)  # no ray is taken to be nearer to a wall's direction, no two robots nearer in metres: divisors
DIAGONAL = np.float32(0.70710678)
RAYS = np.array(  # x and then y in a robot's frame, 45 degrees apart, the first ahead
    [
        *(ONE, DIAGONAL, ZERO, -DIAGONAL, -ONE, -DIAGONAL, ZERO, DIAGONAL),
        *(ZERO, DIAGONAL, ONE, DIAGONAL, ZERO, -DIAGONAL, -ONE, -DIAGONAL),
    ]
)
WORLD_INPUTS = LANES + 2

# ``robots``: a row of float32 for each of these, a number per robot.
X, Y, HEADING_X, HEADING_Y, PUSH_X, PUSH_Y, NEIGHBOURS, NEAREST, SAID, HEARD = range(10)
WORLD_ROWS = 10
# ``queue``: the first rows again, and what was said, in the order of cells; as ``places``, it is eight longer, for all lanes.
QUEUE_SAID = 2
QUEUE_ROWS = 3
COUNT = np.arange(LANES, dtype=np.int32)
# ``places``: a row of int32 for each. Of a robot its cell; the robots in the order of cells; where in that order neighbours are.
CELL, ORDER, NEAR = range(3)
PLACE_ROWS = 3
# ``lengths``: float32, from the settings. HALF_STRIDE is half the way of a step at full speed, HALF_TURN is t per difference of
# the wheels, each from -1 to 1.
SIDE, SIGHT, RADIUS, HALF_STRIDE, HALF_TURN, CELLS_PER_METRE = range(6)
WORLD_LENGTHS = 6


def cells_per_side(side: float, sight: float, robots: int) -> int:
    """How many rows and columns of cells the room has; 1 where more would leave nobody out."""
    cells = min(int(0.999 * side / sight), int(np.sqrt(robots)))
    return cells if cells > 2 else 1


@inline(counts=False, inner=True)
def cut(output):  # type: ignore[no-untyped-def]  # compiled
    """An output cut to 0..1; NaN is 0."""
    positive = select(output > ZERO, output, ZERO)
    return select(positive < ONE, positive, ONE)


@inline(counts=False, inner=True)
def at_least(number, least):  # type: ignore[no-untyped-def]  # compiled
    """The greater of two; Python's ``max`` cannot be computed side by side."""
    return select(number > least, number, least)


@inline(counts=False, inner=True)
def sort(robots, queue, places, cells, per_side, lengths):  # type: ignore[no-untyped-def]  # compiled
    """Put robots in the order of cells, row after row, those of a cell by index; a cell begins where ``cells`` says."""
    number, per_metre = robots.shape[1], lengths[CELLS_PER_METRE]
    cells[:] = 0
    if per_side == 1:  # they are in order
        cells[1:] = number
        rest = number // LANES * LANES
        for first in range(0, rest, LANES):
            store(places[ORDER], first, load(COUNT, 0) + first)
            store(queue[X], first, load(robots[X], first))
            store(queue[Y], first, load(robots[Y], first))
            store(queue[QUEUE_SAID], first, load(robots[SAID], first))
        for robot in range(rest, number):
            places[ORDER, robot] = robot
            queue[X, robot], queue[Y, robot], queue[QUEUE_SAID, robot] = robots[X, robot], robots[Y, robot], robots[SAID, robot]
        return
    for robot in range(number):
        column = min(int(robots[X, robot] * per_metre), per_side - 1)
        row = min(int(robots[Y, robot] * per_metre), per_side - 1)
        places[CELL, robot] = row * per_side + column
        cells[row * per_side + column + 2] += 1
    for cell in range(2, cells.shape[0]):
        cells[cell] += cells[cell - 1]
    for robot in range(number):
        after = places[CELL, robot] + 1  # begins one too far left until all are placed
        at = cells[after]
        cells[after] += 1
        places[ORDER, at] = robot
        queue[X, at], queue[Y, at], queue[QUEUE_SAID, at] = robots[X, robot], robots[Y, robot], robots[SAID, robot]


@inline(counts=False)
def look(robots, queue, places, cells, per_side, rays, lengths, observations):  # type: ignore[no-untyped-def]  # compiled
    """Write what all robots see, what they hear, and how they are pushed.

    Returns:
        how many robots overlap another; each once per other.
    """
    sort(robots, queue, places, cells, per_side, lengths)
    ray_x, ray_y, side, sight, radius = load(rays, 0), load(rays, LANES), lengths[SIDE], lengths[SIGHT], lengths[RADIUS]
    per_sight = ONE / sight
    inputs = observations.shape[0] // robots.shape[1]
    contacts = 0
    for row in range(per_side):
        for column in range(per_side):
            cell = row * per_side + column
            for place in range(cells[cell], cells[cell + 1]):
                robot = places[ORDER, place]
                near = find(place, row, column, queue, places, cells, per_side, sight * sight)
                contacts += meet(
                    robot, near, robots, queue, places, ray_x, ray_y, side, sight, radius, per_sight, observations, inputs * robot
                )
    return contacts


@inline(counts=False, inner=True)
def to_walls(x, y, heading_x, heading_y, ray_x, ray_y, side):  # type: ignore[no-untyped-def]  # compiled
    """How far it is along the rays to a wall."""
    along_x, along_y = heading_x * ray_x - heading_y * ray_y, heading_y * ray_x + heading_x * ray_y
    wall_x = select(along_x > ZERO, side - x, x) / divisor(along_x)
    wall_y = select(along_y > ZERO, side - y, y) / divisor(along_y)
    return select(wall_x < wall_y, wall_x, wall_y)


@inline(counts=False, inner=True)
def divisor(numbers):  # type: ignore[no-untyped-def]  # compiled
    """Without signs, and not zero."""
    sizes = select(numbers < ZERO, ZERO - numbers, numbers)
    return select(sizes > TINY, sizes, TINY)


@inline(counts=False, inner=True)
def find(place, row, column, queue, places, cells, per_side, seen):  # type: ignore[no-untyped-def]  # compiled
    """List those nearer than the root of ``seen`` to the robot at a place of the queue, eight candidates at once.

    Returns:
        their number.
    """
    x, y, count = queue[X, place], queue[Y, place], load(COUNT, 0)
    first, last = max(column - 1, 0), min(column + 1, per_side - 1)
    near = 0
    for other_row in range(max(row - 1, 0), min(row + 2, per_side)):
        end = cells[other_row * per_side + last + 1]
        for at in range(cells[other_row * per_side + first], end, LANES):
            dx, dy = load(queue[X], at) - x, load(queue[Y], at) - y
            which = (dx * dx + dy * dy < seen) & (count < end - at) & (count != place - at)
            near += list_true(which, at, places[NEAR], near)
    return near


@inline(counts=False, inner=True)
def meet(  # type: ignore[no-untyped-def]  # compiled
    robot, near, robots, queue, places, ray_x, ray_y, side, sight, radius, per_sight, observations, at
):
    """Write from ``at`` on how far a robot's rays reach, and where its neighbours are on average; it hears and is pushed by them.

    Returns:
        how many overlap it.
    """
    x, y, heading_x, heading_y = robots[X, robot], robots[Y, robot], robots[HEADING_X, robot], robots[HEADING_Y, robot]
    disc, touch = radius * radius, radius + radius
    sum_x, sum_y, push_x, push_y, heard, nearest = ZERO, ZERO, ZERO, ZERO, ZERO, sight * sight
    reach = to_walls(x, y, heading_x, heading_y, ray_x, ray_y, side)
    reach = select(reach < sight, reach, sight)
    contacts = 0
    for neighbour in range(near):
        other = places[NEAR, neighbour]
        dx, dy = queue[X, other] - x, queue[Y, other] - y
        ahead, aside = dx * heading_x + dy * heading_y, dy * heading_x - dx * heading_y
        sum_x, sum_y, heard = sum_x + ahead, sum_y + aside, heard + queue[QUEUE_SAID, other]
        centre, off = ahead * ray_x + aside * ray_y, aside * ray_x - ahead * ray_y
        chord = disc - off * off  # square of half of what the ray's line has within the robot
        hit = centre - sqrt(select(chord > ZERO, chord, ZERO))
        reach = select((chord > ZERO) & (centre > ZERO) & (hit < reach), hit, reach)
        square = dx * dx + dy * dy
        nearest = select(square < nearest, square, nearest)
        if square < touch * touch:
            contacts += 1
            distance = sqrt(square)
            share = HALF * (touch - distance) / at_least(distance, TINY)
            push_x, push_y = push_x - share * dx, push_y - share * dy
    per_neighbour = per_sight / np.float32(max(near, 1))
    store(observations, at, ONE - reach * per_sight)
    observations[at + LANES] = sum_x * per_neighbour
    observations[at + LANES + 1] = sum_y * per_neighbour
    robots[PUSH_X, robot], robots[PUSH_Y, robot] = push_x, push_y
    robots[NEIGHBOURS, robot], robots[NEAREST, robot], robots[HEARD, robot] = np.float32(near), nearest, heard
    return contacts


@inline(counts=False, inner=True)
def drive(actions, robots, lengths):  # type: ignore[no-untyped-def]  # compiled
    """Turn and move all robots by their wheels and by those that push them, eight at once; walls hold them."""
    low, high, half_turn, half_stride = lengths[RADIUS], lengths[SIDE] - lengths[RADIUS], lengths[HALF_TURN], lengths[HALF_STRIDE]
    rest = robots.shape[1] // LANES * LANES
    for first in range(0, rest, LANES):
        to_x, to_y, heading_x, heading_y = drive_on(
            load(actions[0], first), load(actions[1], first), load(robots[X], first), load(robots[Y], first),
            load(robots[HEADING_X], first), load(robots[HEADING_Y], first), load(robots[PUSH_X], first),
            load(robots[PUSH_Y], first), half_turn, half_stride, low, high,
        )  # fmt: skip
        store(robots[X], first, to_x)
        store(robots[Y], first, to_y)
        store(robots[HEADING_X], first, heading_x)
        store(robots[HEADING_Y], first, heading_y)
    for robot in range(rest, robots.shape[1]):
        robots[X, robot], robots[Y, robot], robots[HEADING_X, robot], robots[HEADING_Y, robot] = drive_on(
            actions[0, robot], actions[1, robot], robots[X, robot], robots[Y, robot],
            robots[HEADING_X, robot], robots[HEADING_Y, robot], robots[PUSH_X, robot],
            robots[PUSH_Y, robot], half_turn, half_stride, low, high,
        )  # fmt: skip


@inline(counts=False, inner=True)
def drive_on(  # type: ignore[no-untyped-def]  # compiled
    left, right, x, y, heading_x, heading_y, push_x, push_y, half_turn, half_stride, low, high
):
    """Where one robot, or eight, are after a step, and their heading."""
    left, right = TWO * cut(left) - ONE, TWO * cut(right) - ONE
    t, forward = (right - left) * half_turn, (left + right) * half_stride
    per_square = ONE / (ONE + t * t)
    cosine, sine = (ONE - t * t) * per_square, (t + t) * per_square
    turned_x = cosine * heading_x - sine * heading_y
    turned_y = cosine * heading_y + sine * heading_x
    per_length = THREE_HALVES - HALF * (turned_x * turned_x + turned_y * turned_y)  # a step of Newton's
    turned_x, turned_y = turned_x * per_length, turned_y * per_length
    to_x, to_y = at_least(x + forward * turned_x + push_x, low), at_least(y + forward * turned_y + push_y, low)
    return select(to_x < high, to_x, high), select(to_y < high, to_y, high), turned_x, turned_y
