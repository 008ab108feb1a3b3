"""Define the tasks of ``arena``: their starts, sensors, events and fitness.

Sensors are those besides the rays and the offset of neighbours, which all tasks share.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import NamedTuple

import numpy as np

from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.random import draw_integer
from zswarm.sims import arena_world
from zswarm.sims.arena_world import (
    CARRIES,
    CONTACTS,
    DELIVERED,
    FIRST,
    FOUND,
    HALF,
    HEADING_X,
    HEADING_Y,
    HEARD,
    MEASURED,
    NEAREST,
    NEIGHBOURS,
    ONE,
    READING,
    SAID,
    SECOND,
    STEP_NUMBER,
    TRUTH,
    WORLD_INPUTS,
    ZERO,
    X,
    Y,
    at_least,
    cut,
)


class Task(NamedTuple):
    """The names of what differs by task."""

    sensors: tuple[str, ...]
    actuators: tuple[str, ...]
    metrics: tuple[str, ...]


FORAGING_SENSORS = ("item_ahead", "item_aside", "nest_ahead", "nest_aside", "carries")
TASKS = {
    "aggregation": Task((), (), ("spread", "neighbours", "contacts")),
    "dispersion": Task((), (), ("nearest", "neighbours", "contacts")),
    "foraging": Task(FORAGING_SENSORS, (), ("delivered", "found", "contacts")),
    "consensus": Task(
        ("reading", "heard"), ("say",), ("error", "disagreement", "contacts")
    ),
}
AGGREGATION, DISPERSION, FORAGING, CONSENSUS = range(4)

DRAW = 1 << 24  # a draw below it is exact in float32
UNIT = np.float32(2.0**-24)
SHORTEST = np.float32(0.01)
MIDDLE = 0.3826  # mean distance of a square's points to its centre, in its sides


@inline(counts=False, inner=True)
def draw(world, low, high):
    """Return a float32 from low to high: low + u (high - low), u a multiple of 2**-24 below 1."""
    return low + np.float32(draw_integer(world.stream, DRAW)) * UNIT * (high - low)


@inline(counts=False)
def start(world, seed):
    """Lay out a trial."""
    robots = world.robots
    world.stream[0] = seed
    world.tally[:] = 0.0
    robots[:] = ZERO
    low = world.radius
    high = world.side - world.radius
    if world.task == DISPERSION:  # the middle half
        low, high = low + (high - low) * HALF * HALF, high - (high - low) * HALF * HALF
    for robot in range(world.number):
        robots[X, robot] = draw(world, low, high)
        robots[Y, robot] = draw(world, low, high)
        square = ZERO
        while square > ONE or square < SHORTEST:
            heading_x = draw(world, -ONE, ONE)
            heading_y = draw(world, -ONE, ONE)
            square = heading_x * heading_x + heading_y * heading_y
        length = sqrt(square)
        robots[HEADING_X, robot] = heading_x / length
        robots[HEADING_Y, robot] = heading_y / length
    if world.task == CONSENSUS:
        truth = draw(world, ZERO, ONE)
        world.tally[TRUTH] = truth
        for robot in range(world.number):
            robots[READING, robot] = truth + draw(world, -world.noise, world.noise)
            robots[SAID, robot] = cut(robots[READING, robot])
    for item in range(world.items.shape[1]):
        place_item(world, item)


@inline(counts=False, inner=True)
def place_item(world, item):
    """Put an item somewhere outside the nest."""
    far = world.side - world.radius
    world.items[X, item] = draw(world, world.nest, far)
    world.items[Y, item] = draw(world, world.radius, far)


@inline(counts=False)
def observe(world, observations):
    """Write what each robot senses."""
    arena_world.look(world, observations)
    inputs = observations.shape[0] // world.number
    if world.task == FORAGING:
        for robot in range(world.number):
            sense_items(world, robot, observations, inputs * robot + WORLD_INPUTS)
    elif world.task == CONSENSUS:
        robots = world.robots
        for robot in range(world.number):
            at = inputs * robot + WORLD_INPUTS
            observations[at] = robots[READING, robot]
            observations[at + 1] = robots[SAID, robot]
            if robots[NEIGHBOURS, robot] > ZERO:
                observations[at + 1] = robots[HEARD, robot] / robots[NEIGHBOURS, robot]


@inline(counts=False, inner=True)
def sense_items(world, robot, observations, at):
    """Write where the nearest item and the nest are, and whether the robot carries an item."""
    robots = world.robots
    items = world.items
    x = robots[X, robot]
    y = robots[Y, robot]
    heading_x = robots[HEADING_X, robot]
    heading_y = robots[HEADING_Y, robot]
    least = world.sight * world.sight
    to_x = ZERO
    to_y = ZERO
    for item in range(items.shape[1]):
        dx = items[X, item] - x
        dy = items[Y, item] - y
        square = dx * dx + dy * dy
        if square < least:
            least = square
            to_x = dx
            to_y = dy
    distance = at_least(sqrt(least), world.radius)
    observations[at] = (to_x * heading_x + to_y * heading_y) / distance
    observations[at + 1] = (to_y * heading_x - to_x * heading_y) / distance
    observations[at + 2] = -heading_x
    observations[at + 3] = heading_y
    observations[at + 4] = robots[CARRIES, robot]


@inline(counts=False)
def act(world, actions):
    """Measure the state that was observed, and advance by one step."""
    world.tally[STEP_NUMBER] += 1.0
    if 2.0 * world.tally[STEP_NUMBER] > world.steps:
        measure(world)
    arena_world.drive(world, actions)
    if world.task == FORAGING:
        for robot in range(world.number):
            carry(world, robot)
    elif world.task == CONSENSUS:
        for robot in range(world.number):
            world.robots[SAID, robot] = cut(actions[2 * world.number + robot])


@inline(counts=False, inner=True)
def carry(world, robot):
    """Let a robot deliver its item in the nest, or find one."""
    robots = world.robots
    items = world.items
    x = robots[X, robot]
    y = robots[Y, robot]
    if robots[CARRIES, robot] > ZERO:
        if x < world.nest:
            robots[CARRIES, robot] = ZERO
            world.tally[DELIVERED] += 1.0
        return
    for item in range(items.shape[1]):
        dx = items[X, item] - x
        dy = items[Y, item] - y
        if dx * dx + dy * dy < world.radius * world.radius:
            robots[CARRIES, robot] = ONE
            world.tally[FOUND] += 1.0
            place_item(world, item)
            return


@inline(counts=False, inner=True)
def measure(world):
    """Add to the tally what counts of the present state."""
    robots = world.robots
    tally = world.tally
    total = np.float32(world.number)
    first = ZERO
    second = ZERO
    if world.task == AGGREGATION:
        middle_x = ZERO
        middle_y = ZERO
        for robot in range(world.number):
            middle_x += robots[X, robot]
            middle_y += robots[Y, robot]
        middle_x /= total
        middle_y /= total
        for robot in range(world.number):
            dx = robots[X, robot] - middle_x
            dy = robots[Y, robot] - middle_y
            first += sqrt(dx * dx + dy * dy)
            second += robots[NEIGHBOURS, robot]
    elif world.task == DISPERSION:
        for robot in range(world.number):
            first += sqrt(robots[NEAREST, robot])
            second += robots[NEIGHBOURS, robot]
    elif world.task == CONSENSUS:
        truth = np.float32(tally[TRUTH])
        middle = ZERO
        for robot in range(world.number):
            middle += robots[SAID, robot]
        middle /= total
        for robot in range(world.number):
            first += abs(robots[SAID, robot] - truth)
            second += abs(robots[SAID, robot] - middle)
    tally[MEASURED] += 1.0
    tally[FIRST] += np.float64(first / total)
    tally[SECOND] += np.float64(second / total)


@inline(counts=False)
def is_over(world):
    """Return whether the trial ends."""
    return world.tally[STEP_NUMBER] >= world.steps


@inline(counts=False)
def judge(world, fitness, metrics):
    """Write fitness and metrics of a trial that ended."""
    tally = world.tally
    first = tally[FIRST] / tally[MEASURED]
    second = tally[SECOND] / tally[MEASURED]
    if world.task == AGGREGATION:
        fitness[0] = 1.0 - first / (MIDDLE * np.float64(world.side))
    elif world.task == DISPERSION:
        fitness[0] = first / np.float64(world.sight)
    elif world.task == FORAGING:
        first = tally[DELIVERED]
        second = tally[FOUND]
        fitness[0] = (first + second) / 2.0
    else:
        fitness[0] = 1.0 - 4.0 * first
    metrics[0] = first
    metrics[1] = second
    metrics[2] = tally[CONTACTS] / 2.0 / tally[STEP_NUMBER]
