"""The world of ``arena``: a square room with walls, and round robots on two wheels that see, hear and push one another.

All is ``+ - * /`` and square roots of float32. A heading is a unit vector and turns by 2 atan(t), which needs no sine:
cos = (1 - t^2) / (1 + t^2) and sin = 2 t / (1 + t^2).

Robots are sorted into cells no narrower than their sight in each step, so that each looks at those of nine cells only: a step
takes time in proportion to the robots. The eight rays are computed side by side.
"""

import numpy as np

from zswarm.jit import inline, sqrt
from zswarm.lanes import LANES, load, select, store

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

# ``robots``: a row of float32 for each of these, a number per robot; the last three in the order of cells.
X, Y, HEADING_X, HEADING_Y, PUSH_X, PUSH_Y, NEIGHBOURS, NEAREST, SAID, HEARD, SORTED_X, SORTED_Y, SORTED_SAID = range(13)
WORLD_ROWS = 13
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


@inline(counts=False)
def cut(output):  # type: ignore[no-untyped-def]  # compiled
    """An output cut to 0..1; NaN is 0."""
    positive = output if output > ZERO else ZERO
    return positive if positive < ONE else ONE


@inline(counts=False)
def at_least(number, least):  # type: ignore[no-untyped-def]  # compiled
    """The greater of two; Python's ``max`` cannot be computed side by side."""
    return number if number > least else least


@inline(counts=False)
def sort(robots, places, cells, per_side, lengths):  # type: ignore[no-untyped-def]  # compiled
    """Put robots in the order of cells, row after row, those of a cell by index; a cell begins where ``cells`` says."""
    cells[:] = 0
    for robot in range(robots.shape[1]):
        column = min(int(robots[X, robot] * lengths[CELLS_PER_METRE]), per_side - 1)
        row = min(int(robots[Y, robot] * lengths[CELLS_PER_METRE]), per_side - 1)
        places[CELL, robot] = row * per_side + column
        cells[row * per_side + column + 2] += 1
    for cell in range(2, cells.shape[0]):
        cells[cell] += cells[cell - 1]
    for robot in range(robots.shape[1]):
        after = places[CELL, robot] + 1  # begins one too far left until all are placed
        at = cells[after]
        cells[after] += 1
        places[ORDER, at] = robot
        robots[SORTED_X, at], robots[SORTED_Y, at] = robots[X, robot], robots[Y, robot]
        robots[SORTED_SAID, at] = robots[SAID, robot]


@inline(counts=False)
def look(robots, places, cells, per_side, rays, lengths, observations):  # type: ignore[no-untyped-def]  # compiled
    """Write what all robots see, what they hear, and how they are pushed.

    Returns:
        how many robots overlap another; each once per other.
    """
    sort(robots, places, cells, per_side, lengths)
    ray_x, ray_y = load(rays, 0), load(rays, LANES)
    inputs = observations.shape[0] // robots.shape[1]
    contacts = 0
    for row in range(per_side):
        for column in range(per_side):
            cell = row * per_side + column
            for place in range(cells[cell], cells[cell + 1]):
                robot = places[ORDER, place]
                near = find(place, row, column, robots, places, cells, per_side, lengths)
                contacts += meet(robot, near, robots, places, ray_x, ray_y, lengths, observations, inputs * robot)
    return contacts


@inline(counts=False)
def to_walls(x, y, heading_x, heading_y, ray_x, ray_y, side):  # type: ignore[no-untyped-def]  # compiled
    """How far it is along the rays to a wall."""
    along_x, along_y = heading_x * ray_x - heading_y * ray_y, heading_y * ray_x + heading_x * ray_y
    wall_x = select(along_x > ZERO, side - x, x) / divisor(along_x)
    wall_y = select(along_y > ZERO, side - y, y) / divisor(along_y)
    return select(wall_x < wall_y, wall_x, wall_y)


@inline(counts=False)
def divisor(numbers):  # type: ignore[no-untyped-def]  # compiled
    """Without signs, and not zero."""
    sizes = select(numbers < ZERO, ZERO - numbers, numbers)
    return select(sizes > TINY, sizes, TINY)


@inline(counts=False)
def find(place, row, column, robots, places, cells, per_side, lengths):  # type: ignore[no-untyped-def]  # compiled
    """List the neighbours of the robot at a place of the order; returns their number. Without a branch that none can foresee."""
    x, y, seen = robots[SORTED_X, place], robots[SORTED_Y, place], lengths[SIGHT] * lengths[SIGHT]
    first, last = max(column - 1, 0), min(column + 1, per_side - 1)
    near = 0
    for other_row in range(max(row - 1, 0), min(row + 2, per_side)):
        begin = other_row * per_side
        for at in range(cells[begin + first], cells[begin + last + 1]):
            dx, dy = robots[SORTED_X, at] - x, robots[SORTED_Y, at] - y
            places[NEAR, near] = at
            near += 1 if (dx * dx + dy * dy < seen) & (at != place) else 0
    return near


@inline(counts=False)
def meet(robot, near, robots, places, ray_x, ray_y, lengths, observations, at):  # type: ignore[no-untyped-def]  # compiled
    """Write from ``at`` on how far a robot's rays reach, and where its neighbours are on average; it hears and is pushed by them.

    Returns:
        how many overlap it.
    """
    x, y, heading_x, heading_y = robots[X, robot], robots[Y, robot], robots[HEADING_X, robot], robots[HEADING_Y, robot]
    sight, disc, touch = lengths[SIGHT], lengths[RADIUS] * lengths[RADIUS], lengths[RADIUS] + lengths[RADIUS]
    sum_x, sum_y, push_x, push_y, heard, nearest = ZERO, ZERO, ZERO, ZERO, ZERO, sight * sight
    reach = to_walls(x, y, heading_x, heading_y, ray_x, ray_y, lengths[SIDE])
    reach = select(reach < sight, reach, sight)
    contacts = 0
    for neighbour in range(near):
        other = places[NEAR, neighbour]
        dx, dy = robots[SORTED_X, other] - x, robots[SORTED_Y, other] - y
        ahead, aside = dx * heading_x + dy * heading_y, dy * heading_x - dx * heading_y
        sum_x, sum_y, heard = sum_x + ahead, sum_y + aside, heard + robots[SORTED_SAID, other]
        centre, off = ahead * ray_x + aside * ray_y, aside * ray_x - ahead * ray_y
        chord = disc - off * off  # square of half of what the ray's line has within the robot
        hit = centre - sqrt(select(chord > ZERO, chord, ZERO))
        reach = select((chord > ZERO) & (centre > ZERO) & (hit < reach), hit, reach)
        square = dx * dx + dy * dy
        nearest = square if square < nearest else nearest
        if square < touch * touch:
            contacts += 1
            distance = sqrt(square)
            share = HALF * (touch - distance) / at_least(distance, TINY)
            push_x, push_y = push_x - share * dx, push_y - share * dy
    per_sight, number = ONE / sight, np.float32(max(near, 1))
    store(observations, at, ONE - reach * per_sight)
    observations[at + LANES] = sum_x * (per_sight / number)
    observations[at + LANES + 1] = sum_y * (per_sight / number)
    robots[PUSH_X, robot], robots[PUSH_Y, robot] = push_x, push_y
    robots[NEIGHBOURS, robot], robots[NEAREST, robot] = np.float32(near), sqrt(nearest)
    robots[HEARD, robot] = heard / number if near > 0 else robots[SAID, robot]
    return contacts


@inline(counts=False)
def drive(actions, robots, lengths):  # type: ignore[no-untyped-def]  # compiled
    """Turn and move all robots by their wheels and by those that push them; walls hold them."""
    low, high = lengths[RADIUS], lengths[SIDE] - lengths[RADIUS]
    for robot in range(robots.shape[1]):
        left, right = TWO * cut(actions[robot, 0]) - ONE, TWO * cut(actions[robot, 1]) - ONE
        t, forward = (right - left) * lengths[HALF_TURN], (left + right) * lengths[HALF_STRIDE]
        per_square = ONE / (ONE + t * t)
        cosine, sine = (ONE - t * t) * per_square, (t + t) * per_square
        heading_x, heading_y = robots[HEADING_X, robot], robots[HEADING_Y, robot]
        turned_x = cosine * heading_x - sine * heading_y
        turned_y = cosine * heading_y + sine * heading_x
        per_length = THREE_HALVES - HALF * (turned_x * turned_x + turned_y * turned_y)  # a step of Newton's
        turned_x, turned_y = turned_x * per_length, turned_y * per_length
        x = robots[X, robot] + forward * turned_x + robots[PUSH_X, robot]
        y = robots[Y, robot] + forward * turned_y + robots[PUSH_Y, robot]
        x, y = at_least(x, low), at_least(y, low)
        robots[X, robot], robots[Y, robot] = x if x < high else high, y if y < high else high
        robots[HEADING_X, robot], robots[HEADING_Y, robot] = turned_x, turned_y
