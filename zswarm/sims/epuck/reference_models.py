"""Turn readings of an e-puck into what its controller sees: reference models 1.1 and 1.2.

Machines of AutoMoDe have a model 1.2 of their own, with numbers that networks see only in part.

Source: K. Hasselmann et al., "Reference models for AutoMoDe", TR/IRIDIA/2018-002. docs/epuck.md has
the equations, and what the implementations do beyond them.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.lanes import LANES, fill, load, select, store
from zswarm.kernels.portable import PI, exp
from zswarm.kernels.random import draw_uniform
from zswarm.sims.epuck.sensors import ANGLES_X, ANGLES_Y, SENSORS
from zswarm.sims.epuck.world import (
    FIRST_VOTE,
    GROUND,
    HEARD,
    HEARD_X,
    HEARD_Y,
    LIGHT,
    MEMORY,
    PROXIMITY,
    STEP_NUMBER,
    VOTES,
    unit_vectors,
)

BRIGHT = 0.2  # a reading above it sees a lamp
DARK_GROUND, BRIGHT_GROUND = (
    0.03,
    0.85,
)  # a reading below or above it votes for black or white
MAJORITY = 10  # votes of 15; more decide
DIRECTIONS = [PI / 4, 3 * PI / 4, 5 * PI / 4, 7 * PI / 4]
DIRECTIONS_X, DIRECTIONS_Y = unit_vectors(DIRECTIONS)
QUADRANTS = "front_left", "back_left", "back_right", "front_right"
SENSOR_NAMES = {
    1: (
        *(f"proximity_{sensor}" for sensor in range(SENSORS)),
        *(f"light_{sensor}" for sensor in range(SENSORS)),
        *("ground_left", "ground_centre", "ground_right", "neighbours"),
        *(f"attraction_{name}" for name in QUADRANTS),
    ),
    2: (
        *(f"proximity_{name}" for name in QUADRANTS),
        *(f"light_{name}" for name in QUADRANTS),
        *("ground", "neighbours"),
        *(f"attraction_{name}" for name in QUADRANTS),
    ),
}
SENSOR_NAMES[3] = (*SENSOR_NAMES[2], "chance")


@inline(counts=False, inner=True, copied=False)
def interpret(world, observations):
    """Write what the controllers of all robots see."""
    for at in range(0, world.robots.shape[1], LANES):
        remember(world, at)
        if world.model == 1:
            see_1_1(world, at)
        else:
            see_vectors(world, at)
            store(world.seen[8], at, vote(world.memory, at))
    inputs = world.seen.shape[0]
    for robot in range(world.number):
        first = inputs * robot
        for number in range(inputs):
            observations[first + number] = world.seen[number, robot]
        if world.model == 1:
            voted = world.seen[16, robot]
            for table in range(3):
                observations[first + 16 + table] = ground(world, voted, table)
            observations[first + 19] = crowd(world.robots[HEARD, robot])
        elif world.model == 2:
            observations[first + 8] = ground(world, world.seen[8, robot], 0)
            observations[first + 9] = crowd(world.robots[HEARD, robot])
        else:
            observations[first + 9] = world.robots[HEARD, robot]
            observations[first + 14] = draw_uniform(world.stream)


@inline(counts=False, inner=True)
def remember(world, at):
    """Store this step's messages and votes for the floor in place of the oldest."""
    robots = world.robots
    step = world.counts[STEP_NUMBER]
    slot = 2 * (step % MEMORY)
    store(world.memory[slot], at, load(robots[HEARD_X], at))
    store(world.memory[slot + 1], at, load(robots[HEARD_Y], at))
    black = fill(0.0)
    white = fill(0.0)
    for sensor in range(3):
        reading = load(robots[GROUND + sensor], at)
        black = black + select(reading < DARK_GROUND, 1.0, 0.0)
        white = white + select(reading > BRIGHT_GROUND, 1.0, 0.0)
    slot = FIRST_VOTE + 2 * (step % VOTES)
    store(world.memory[slot], at, black)
    store(world.memory[slot + 1], at, white)


@inline(counts=False, inner=True)
def see_vectors(world, at):
    """Write the vectors of model 1.2: proximity, light, and from 10 on attraction."""
    robots = world.robots
    x = fill(0.0)
    y = fill(0.0)
    for sensor in range(SENSORS):
        reading = load(robots[PROXIMITY + sensor], at)
        x = x + reading * ANGLES_X[sensor]
        y = y + reading * ANGLES_Y[sensor]
    length = sqrt(x * x + y * y)
    factor = 1.0 / select(length > 1.0, length, 1.0)
    project(world.seen, 0, at, x, y, factor)
    x = fill(0.0)
    y = fill(0.0)
    most = fill(0.0)
    for sensor in range(SENSORS):
        reading = load(robots[LIGHT + sensor], at)
        most = select(reading > most, reading, most)
        x = x + reading * ANGLES_X[sensor]
        y = y + reading * ANGLES_Y[sensor]
    length = sqrt(x * x + y * y)
    shines = (most > BRIGHT) & (length > 0.0)
    factor = select(shines, 1.0 / select(shines, length, 1.0), 0.0)
    project(world.seen, 4, at, x, y, factor)
    x, y = attraction(world.memory, at)
    project(world.seen, 10, at, x, y, fill(1.0))


@inline(counts=False, inner=True)
def see_1_1(world, at):
    """Write 24 inputs: proximity and light readings, ground, neighbours, attraction."""
    for sensor in range(2 * SENSORS):
        store(world.seen[sensor], at, load(world.robots[PROXIMITY + sensor], at))
    store(world.seen[16], at, vote(world.memory, at))
    x, y = attraction(world.memory, at)
    length = sqrt(x * x + y * y)
    store(world.seen[20], at, length)
    for robot in range(at, at + LANES):
        length_here = world.seen[20, robot]
        rescaled = 2.0 / (1.0 + exp(-length_here)) - 1.0
        world.seen[21, robot] = rescaled / length_here if length_here > 0.0 else 0.0
    project(world.seen, 20, at, x, y, load(world.seen[21], at))


@inline(counts=False, inner=True)
def project(seen, first, at, x, y, factor):
    """Write the lengths of vectors in four directions, 0 instead of negative ones."""
    for direction in range(4):
        length = factor * (x * DIRECTIONS_X[direction] + y * DIRECTIONS_Y[direction])
        store(seen[first + direction], at, select(length > 0.0, length, 0.0))


@inline(counts=False, inner=True)
def vote(memory, at):
    """Return 0 for black, 1 for white, 1/2 for grey, by the readings of the last steps."""
    black = fill(0.0)
    white = fill(0.0)
    for slot in range(FIRST_VOTE, FIRST_VOTE + 2 * VOTES, 2):
        black = black + load(memory[slot], at)
        white = white + load(memory[slot + 1], at)
    other = select(white > float(MAJORITY), 1.0, fill(0.5))
    return select(black > float(MAJORITY), 0.0, other)


@inline(counts=False, inner=True)
def ground(world, voted, table):
    """Return 0 for black, 1 for white, and a recorded reading for grey."""
    if voted != 0.5:
        return voted
    at = draw_uniform(world.stream) * (world.greys.shape[1] - 1)
    low = int(at)
    below = world.greys[table, low]
    return below + (at - low) * (world.greys[table, low + 1] - below)


@inline(counts=False, inner=True)
def crowd(heard):
    """Return the input for a number of neighbours."""
    return 1.0 - 2.0 / (1.0 + exp(heard))


@inline(counts=False, inner=True)
def attraction(memory, at):
    """Return the sums of the vectors of all messages that robots remember."""
    x = fill(0.0)
    y = fill(0.0)
    for slot in range(0, 2 * MEMORY, 2):
        x = x + load(memory[slot], at)
        y = y + load(memory[slot + 1], at)
    return x, y
