"""Move e-puck robots: motors that follow the wheels, in ten substeps of a control step.

The model is that of ARGoS' ``dynamics2d`` engine, in the order of its operations. docs/epuck.md has
the equations.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.portable import cos, sin
from zswarm.sims.epuck.contacts import FIRST, SECOND, find_contacts
from zswarm.sims.epuck.impulses import (
    INERTIA,
    MOST_CHANGE,
    MOST_TURN,
    SUBSTEP_S,
    solve,
)
from zswarm.sims.epuck.walls import first_near, is_near
from zswarm.sims.epuck.world import (
    ANGLE,
    COSINE,
    LEFT,
    MASS,
    PUSH_SPIN,
    PUSH_X,
    PUSH_Y,
    RADIUS,
    RIGHT,
    SINE,
    SPEED_X,
    SPEED_Y,
    SPIN,
    SUBSTEP,
    TARGET_SPIN,
    TARGET_X,
    TARGET_Y,
    TOUCHES,
    WHEEL_DISTANCE,
    X,
    Y,
)

SUBSTEPS = 10
REACH = 1.5  # of the way of the fastest robot in a step: how far any may come


@inline(counts=False, inner=True, copied=False)
def drive(world):
    """Let all robots drive for one control step."""
    aim(world)
    pairs = list_pairs(world)
    for _ in range(SUBSTEPS):
        world.counts[SUBSTEP] += 1
        move(world)
        found, touching = find_contacts(world, pairs)
        pull_free(world)
        if found > 0:
            solve(world, found, touching)
    turn(world)


@inline(counts=False, inner=True)
def aim(world):
    """Set the target velocities of a step from commands; the heading at its start holds for it."""
    robots = world.robots
    for robot in range(world.number):
        left = robots[LEFT, robot]
        right = robots[RIGHT, robot]
        speed = (left + right) * 0.5
        robots[TARGET_X, robot] = speed * robots[COSINE, robot]
        robots[TARGET_Y, robot] = speed * robots[SINE, robot]
        robots[TARGET_SPIN, robot] = (right - left) / WHEEL_DISTANCE


@inline(counts=False, inner=True)
def turn(world):
    """Set the cosines and sines of all headings."""
    robots = world.robots
    for robot in range(world.number):
        robots[COSINE, robot] = cos(robots[ANGLE, robot])
        robots[SINE, robot] = sin(robots[ANGLE, robot])


@inline(counts=False, inner=True)
def list_pairs(world):
    """List the pairs of robots, and of robots and walls, that may touch in this step.

    Returns:
        their number.
    """
    robots = world.robots
    number = world.number
    fastest = 0.0
    for robot in range(number):
        x = robots[SPEED_X, robot]
        y = robots[SPEED_Y, robot]
        fastest = max(fastest, x * x + y * y)
        x = robots[TARGET_X, robot]
        y = robots[TARGET_Y, robot]
        fastest = max(fastest, x * x + y * y)
    reach = REACH * SUBSTEPS * SUBSTEP_S * sqrt(fastest)  # of a robot in a step
    apart = 2.0 * (RADIUS + reach)
    found = 0
    for robot in range(number):
        x = robots[X, robot]
        y = robots[Y, robot]
        first = first_near(world, x, y, RADIUS + reach)
        for wall in range(world.walls.shape[0] - 1, first - 1, -1):
            if is_near(world.walls[wall], x, y, RADIUS + reach):
                world.pairs[found, FIRST] = robot
                world.pairs[found, SECOND] = number + wall
                found += 1
        for other in range(number - 1, robot, -1):
            dx = robots[X, other] - x
            dy = robots[Y, other] - y
            if dx * dx + dy * dy < apart * apart:
                world.pairs[found, FIRST] = robot
                world.pairs[found, SECOND] = other
                found += 1
    return found


@inline(counts=False, inner=True)
def move(world):
    """Move and turn all robots for a substep, with the velocities of the previous one."""
    robots = world.robots
    for robot in range(world.number):
        robots[X, robot] += robots[SPEED_X, robot] * SUBSTEP_S
        robots[Y, robot] += robots[SPEED_Y, robot] * SUBSTEP_S
        robots[ANGLE, robot] += robots[SPIN, robot] * SUBSTEP_S


@inline(counts=False, inner=True)
def pull_free(world):
    """Let the motors of robots that nothing touches change their velocities."""
    robots = world.robots
    for robot in range(world.number):
        if robots[TOUCHES, robot] > 0.0:
            continue
        dx = robots[TARGET_X, robot] - robots[SPEED_X, robot]
        dy = robots[TARGET_Y, robot] - robots[SPEED_Y, robot]
        square = dx * dx + dy * dy
        if square > MOST_CHANGE * MOST_CHANGE:
            part = MOST_CHANGE / sqrt(square)
            dx *= part
            dy *= part
        robots[SPEED_X, robot] += dx
        robots[SPEED_Y, robot] += dy
        robots[PUSH_X, robot] = dx * MASS
        robots[PUSH_Y, robot] = dy * MASS
        change = robots[TARGET_SPIN, robot] - robots[SPIN, robot]
        change = min(max(change, -MOST_TURN), MOST_TURN)
        robots[SPIN, robot] += change
        robots[PUSH_SPIN, robot] = change * INERTIA
