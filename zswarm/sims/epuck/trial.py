"""Play a trial of e-puck robots: placement, and the order of a control step.

A control step acts, moves, senses, controls and scores, as the reference simulator does: the
command of a step moves the robot in the next one. So nobody moves in the first step, and the last
command is not used.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

import numpy as np

from zswarm.kernels.jit import inline
from zswarm.kernels.portable import PI, cos, sin
from zswarm.kernels.random import draw_normal, draw_uniform
from zswarm.sims.epuck import missions, physics, reference_models, sensors
from zswarm.sims.epuck.arenas import IN_AREA, OFF_SPOTS
from zswarm.sims.epuck.walls import square_to
from zswarm.sims.epuck.world import (
    ANGLE,
    CENTRE_X,
    CENTRE_Y,
    HEARD,
    LEFT,
    RADIUS,
    RIGHT,
    STEP_NUMBER,
    WHEEL_NOISE,
    X,
    Y,
)

FASTEST = 12.0  # cm/s, of a wheel
METRES = float(np.float32(0.01))  # in a centimetre
LONG_AGO = -1_000.0  # a substep


@inline(counts=False, copied=False)
def start(world, seed):
    """Place all robots, and score the first step, in which nobody moves."""
    world.stream[0] = seed
    world.counts[:] = 0
    world.counts[STEP_NUMBER] = 1
    world.tally[:] = 0.0
    world.robots[:, : world.number] = 0.0
    world.memory[:] = 0.0
    world.impulses[:] = LONG_AGO
    robots = world.robots
    for robot in range(world.number):
        robots[X, robot] = world.around * (2.0 * draw_uniform(world.stream) - 1.0)
        robots[Y, robot] = world.around * (2.0 * draw_uniform(world.stream) - 1.0)
    for robot in range(world.number):
        place(world, robot)
    physics.turn(world)
    missions.score(world)


@inline(counts=False, inner=True, copied=False)
def place(world, robot):
    """Draw places for a robot until it may start there."""
    robots = world.robots
    free = False
    while not free:
        a = draw_uniform(world.stream)
        b = draw_uniform(world.stream)
        if world.start == IN_AREA:
            radius = max(a, b) * world.around
            angle = 2.0 * PI * (min(a, b) / max(a, b)) if max(a, b) > 0.0 else 0.0
        else:
            radius = a * world.around
            angle = world.sector_from + b * (world.sector_to - world.sector_from)
        robots[X, robot] = radius * cos(angle)
        robots[Y, robot] = radius * sin(angle)
        robots[ANGLE, robot] = 2.0 * PI * draw_uniform(world.stream)
        free = is_free(world, robot)


@inline(counts=False, inner=True)
def is_free(world, robot):
    """Return whether a robot may start where it is: it overlaps no wall and no other robot.

    ARGoS builds SCA's shelter after it has placed the robots, so robots may overlap its walls.
    """
    robots = world.robots
    spots = world.floor.shape[0] if world.start == OFF_SPOTS else 0
    if missions.on_spots(world, robot, 0, spots):
        return False
    for wall in range(world.outer_walls):  # beyond a wall's middle it is outside
        x = world.walls[wall, CENTRE_X]
        y = world.walls[wall, CENTRE_Y]
        if robots[X, robot] * x + robots[Y, robot] * y > x * x + y * y:
            return False
    for other in range(world.number):
        dx = robots[X, other] - robots[X, robot]
        dy = robots[Y, other] - robots[Y, robot]
        if other != robot and dx * dx + dy * dy < 4.0 * RADIUS * RADIUS:
            return False
    walls = world.outer_walls if world.mission == missions.SCA else world.walls.shape[0]
    for wall in range(walls):
        square = square_to(world.walls[wall], robots[X, robot], robots[Y, robot])
        if square < RADIUS * RADIUS:
            return False
    return True


@inline(counts=False, copied=False)
def observe(world, observations):
    """Sense, and write what the controllers of all robots see."""
    sensors.sense(world)
    for robot in range(world.number):
        world.tally[missions.HEARINGS] += world.robots[HEARD, robot]
    reference_models.interpret(world, observations)


@inline(counts=False, copied=False)
def act(world, actions):
    """Take the commands of all robots; unless the trial is over, drive them and score the step."""
    for robot in range(world.number):
        command(world, LEFT, robot, actions[robot])
        command(world, RIGHT, robot, actions[world.number + robot])
    world.counts[STEP_NUMBER] += 1
    if not is_over(world):
        physics.drive(world)
        missions.score(world)


@inline(counts=False, inner=True)
def command(world, wheel, robot, output):
    """Set the speed of a wheel from an output: 0 is full speed back, 1 full speed ahead."""
    output = np.float64(output)
    positive = output if output > 0.0 else 0.0  # 0 for NaN
    speed = (2.0 * min(positive, 1.0) - 1.0) * FASTEST * METRES
    noise = world.constants[WHEEL_NOISE]
    if noise > 0.0:
        speed *= 1.0 + noise * draw_normal(world.stream)
    world.robots[wheel, robot] = speed


@inline(counts=False)
def is_over(world):
    """Return whether all steps were played."""
    return world.counts[STEP_NUMBER] > world.steps
