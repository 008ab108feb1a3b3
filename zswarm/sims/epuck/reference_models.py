"""Turn readings of an e-puck into what its controller sees: reference models 1.1 and 1.2.

Machines of AutoMoDe have a model 1.2 of their own, with numbers that networks see only in part.

Source: K. Hasselmann et al., "Reference models for AutoMoDe", TR/IRIDIA/2018-002. docs/epuck.md has
the equations, and what the implementations do beyond them.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline, sqrt
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
    for robot in range(world.number):
        remember(world, robot)
        if world.model == 1:
            see_1_1(world, robot, observations, len_1_1 * robot)
        elif world.model == 2:
            at = len_1_2 * robot
            see_vectors(world, robot, observations, at)
            observations[at + 8] = ground(world, robot, 0)
            observations[at + 9] = crowd(world.robots[HEARD, robot])
        else:
            at = len_machine * robot
            see_vectors(world, robot, observations, at)
            observations[at + 8] = vote(world, robot)
            observations[at + 9] = world.robots[HEARD, robot]
            observations[at + 14] = draw_uniform(world.stream)


len_1_1, len_1_2, len_machine = (len(SENSOR_NAMES[model]) for model in (1, 2, 3))


@inline(counts=False, inner=True)
def remember(world, robot):
    """Store this step's messages and votes for the floor in place of the oldest."""
    robots = world.robots
    step = world.counts[STEP_NUMBER]
    slot = 2 * (step % MEMORY)
    world.memory[robot, slot] = robots[HEARD_X, robot]
    world.memory[robot, slot + 1] = robots[HEARD_Y, robot]
    black = 0.0
    white = 0.0
    for sensor in range(3):
        reading = robots[GROUND + sensor, robot]
        if reading < DARK_GROUND:
            black += 1.0
        elif reading > BRIGHT_GROUND:
            white += 1.0
    slot = FIRST_VOTE + 2 * (step % VOTES)
    world.memory[robot, slot] = black
    world.memory[robot, slot + 1] = white


@inline(counts=False, inner=True)
def see_vectors(world, robot, observations, at):
    """Write the vectors of model 1.2: proximity, light, and from 10 on attraction."""
    robots = world.robots
    x = 0.0
    y = 0.0
    for sensor in range(SENSORS):
        x += robots[PROXIMITY + sensor, robot] * ANGLES_X[sensor]
        y += robots[PROXIMITY + sensor, robot] * ANGLES_Y[sensor]
    length = sqrt(x * x + y * y)
    project(x, y, 1.0 / length if length > 1.0 else 1.0, observations, at)
    x = 0.0
    y = 0.0
    lit = False
    for sensor in range(SENSORS):
        reading = robots[LIGHT + sensor, robot]
        lit = lit or reading > BRIGHT
        x += reading * ANGLES_X[sensor]
        y += reading * ANGLES_Y[sensor]
    length = sqrt(x * x + y * y)
    project(x, y, 1.0 / length if lit and length > 0.0 else 0.0, observations, at + 4)
    x, y = attraction(world, robot)
    project(x, y, 1.0, observations, at + 10)


@inline(counts=False, inner=True)
def see_1_1(world, robot, observations, at):
    """Write 24 inputs: proximity and light readings, ground, neighbours, attraction."""
    robots = world.robots
    for sensor in range(2 * SENSORS):
        observations[at + sensor] = robots[PROXIMITY + sensor, robot]
    for table in range(3):
        observations[at + 16 + table] = ground(world, robot, table)
    observations[at + 19] = crowd(robots[HEARD, robot])
    x, y = attraction(world, robot)
    length = sqrt(x * x + y * y)
    rescaled = 2.0 / (1.0 + exp(-length)) - 1.0
    project(x, y, rescaled / length if length > 0.0 else 0.0, observations, at + 20)


@inline(counts=False, inner=True)
def project(x, y, factor, observations, at):
    """Write the lengths of a vector in four directions, 0 instead of negative ones."""
    for direction in range(4):
        length = factor * (x * DIRECTIONS_X[direction] + y * DIRECTIONS_Y[direction])
        observations[at + direction] = max(length, 0.0)


@inline(counts=False, inner=True)
def vote(world, robot):
    """Return 0 for black, 1 for white, 1/2 for grey, by the readings of the last steps."""
    black = 0.0
    white = 0.0
    for slot in range(VOTES):
        black += world.memory[robot, FIRST_VOTE + 2 * slot]
        white += world.memory[robot, FIRST_VOTE + 2 * slot + 1]
    if black > MAJORITY:
        return 0.0
    return 1.0 if white > MAJORITY else 0.5


@inline(counts=False, inner=True)
def ground(world, robot, table):
    """Return 0 for black, 1 for white, and a recorded reading for grey."""
    voted = vote(world, robot)
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
def attraction(world, robot):
    """Return the sum of the vectors of all messages that the robot remembers."""
    x = 0.0
    y = 0.0
    for slot in range(MEMORY):
        x += world.memory[robot, 2 * slot]
        y += world.memory[robot, 2 * slot + 1]
    return x, y
