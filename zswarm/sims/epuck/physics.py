"""Move e-puck robots: motors that follow the wheels, in ten substeps of a control step.

The model is that of ARGoS' ``dynamics2d`` engine, in the order of its operations. docs/epuck.md has
the equations.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.angles import are_near, turned
from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.lanes import LANES, any_of, load, select, store
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
    for at in range(0, robots.shape[1], LANES):
        left = load(robots[LEFT], at)
        right = load(robots[RIGHT], at)
        speed = (left + right) * 0.5
        store(robots[TARGET_X], at, speed * load(robots[COSINE], at))
        store(robots[TARGET_Y], at, speed * load(robots[SINE], at))
        store(robots[TARGET_SPIN], at, (right - left) / WHEEL_DISTANCE)


@inline(counts=False, inner=True)
def turn(world):
    """Set the cosines and sines of all headings."""
    robots = world.robots
    for at in range(0, robots.shape[1], LANES):
        angles = load(robots[ANGLE], at)
        if are_near(angles):
            cosines, sines = turned(angles)
            store(robots[COSINE], at, cosines)
            store(robots[SINE], at, sines)
        else:
            for robot in range(at, at + LANES):
                robots[COSINE, robot] = cos(robots[ANGLE, robot])
                robots[SINE, robot] = sin(robots[ANGLE, robot])


@inline(counts=False, inner=True)
def farthest(world):
    """Return how far any robot may come in this step."""
    robots = world.robots
    fastest = 0.0
    for robot in range(world.number):
        x = robots[SPEED_X, robot]
        y = robots[SPEED_Y, robot]
        fastest = max(fastest, x * x + y * y)
        x = robots[TARGET_X, robot]
        y = robots[TARGET_Y, robot]
        fastest = max(fastest, x * x + y * y)
    return REACH * SUBSTEPS * SUBSTEP_S * sqrt(fastest)


@inline(counts=False, inner=True)
def list_pairs(world):
    """List the pairs of robots, and of robots and walls, that may touch in this step.

    Returns:
        their number.
    """
    robots = world.robots
    number = world.number
    reach = RADIUS + farthest(world)
    square = 4.0 * reach * reach
    last = robots.shape[1] - LANES
    found = 0
    for robot in range(number):
        x = robots[X, robot]
        y = robots[Y, robot]
        first = first_near(world, x, y, reach)
        for wall in range(world.walls.shape[0] - 1, first - 1, -1):
            if is_near(world.walls[wall], x, y, reach):
                world.pairs[found, FIRST] = robot
                world.pairs[found, SECOND] = number + wall
                found += 1
        for at in range(last, robot - LANES, -LANES):
            dx = load(robots[X], at) - x
            dy = load(robots[Y], at) - y
            squares = dx * dx + dy * dy
            if not any_of((squares < square) & (load(world.places, at) > float(robot))):
                continue
            for other in range(at + LANES - 1, max(at - 1, robot), -1):
                dx = robots[X, other] - x
                dy = robots[Y, other] - y
                if dx * dx + dy * dy < square:
                    world.pairs[found, FIRST] = robot
                    world.pairs[found, SECOND] = other
                    found += 1
    return found


@inline(counts=False, inner=True)
def move(world):
    """Move and turn all robots for a substep, with the velocities of the previous one."""
    robots = world.robots
    for at in range(0, robots.shape[1], LANES):
        go(robots[X], robots[SPEED_X], at)
        go(robots[Y], robots[SPEED_Y], at)
        go(robots[ANGLE], robots[SPIN], at)


@inline(counts=False, inner=True)
def go(places, speeds, at):
    """Add what speeds do in a substep."""
    store(places, at, load(places, at) + load(speeds, at) * SUBSTEP_S)


@inline(counts=False, inner=True)
def pull_free(world):
    """Let the motors of robots that nothing touches change their velocities."""
    robots = world.robots
    for at in range(0, robots.shape[1], LANES):
        free = load(robots[TOUCHES], at) == 0.0
        dx = load(robots[TARGET_X], at) - load(robots[SPEED_X], at)
        dy = load(robots[TARGET_Y], at) - load(robots[SPEED_Y], at)
        square = dx * dx + dy * dy
        over = square > MOST_CHANGE * MOST_CHANGE
        if any_of(over):
            part = select(over, MOST_CHANGE / sqrt(select(over, square, 1.0)), 1.0)
            dx = dx * part
            dy = dy * part
        change = load(robots[TARGET_SPIN], at) - load(robots[SPIN], at)
        change = select(change < -MOST_TURN, -MOST_TURN, change)
        change = select(change > MOST_TURN, MOST_TURN, change)
        change_if(free, robots[SPEED_X], robots[PUSH_X], at, dx, MASS)
        change_if(free, robots[SPEED_Y], robots[PUSH_Y], at, dy, MASS)
        change_if(free, robots[SPIN], robots[PUSH_SPIN], at, change, INERTIA)


@inline(counts=False, inner=True)
def change_if(which, speeds, impulses, at, change, inertia):
    """Change the speeds of some robots, and write the impulses that it took."""
    old = load(speeds, at)
    store(speeds, at, select(which, old + change, old))
    store(impulses, at, select(which, change * inertia, load(impulses, at)))
