"""Solve the contacts of e-puck robots by sequential impulses.

Source: E. Catto, "Iterative Dynamics with Temporal Coherence", 2005, in the form and order of
Chipmunk 6. docs/epuck.md describes it. Contacts that share no robot do not depend on each other:
they are solved in an order in which such ones follow each other, so that a processor computes
several at once. The bits are those of the order in which contacts were found.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline, sqrt
from zswarm.sims.epuck.contacts import (
    ACROSS_MASS,
    ACROSS_NOW,
    ALONG_MASS,
    ALONG_NOW,
    ARM_X,
    ARM_Y,
    FIRST,
    FRICTION,
    GROUP,
    NORMAL_X,
    NORMAL_Y,
    SECOND,
)
from zswarm.sims.epuck.world import (
    ACROSS,
    ACTIVE,
    ALONG,
    BEFORE,
    GROUPS,
    LEADER,
    LEVEL,
    LEVEL_STARTS,
    LEVELS,
    MASS,
    NOW,
    ORDER,
    PUSH_SPIN,
    PUSH_X,
    PUSH_Y,
    RADIUS,
    SPEED_X,
    SPEED_Y,
    SPIN,
    SUBSTEP,
    TARGET_SPIN,
    TARGET_X,
    TARGET_Y,
    TOUCHED,
    TOUCHES,
    TOUCHING,
)

SUBSTEP_S = 0.01
ITERATIONS = 10
SETTLED = 1e-15  # N s; a millionth of a millionth of what a motor can do
PER_MASS = 1.0 / MASS
INERTIA = (
    0.5 * MASS * (2.0 * RADIUS) * (2.0 * RADIUS)
)  # of twice the radius, as implemented
PER_INERTIA = 1.0 / INERTIA
MOST_IMPULSE = 1.5 * SUBSTEP_S  # of a motor: 1.5 N, 1.5 N m
MOST_CHANGE = MOST_IMPULSE * PER_MASS  # m/s in a substep
MOST_TURN = MOST_IMPULSE * PER_INERTIA  # rad/s in a substep
CACHED = 3  # substeps for which the impulses of a contact that ended are cached

# ``bodies``: a row for each robot that touches something: its velocities, the impulses of its
# motors, and its target velocities.
BODY_X, BODY_Y, BODY_SPIN = range(3)
MOTOR_X, MOTOR_Y, MOTOR_SPIN, WANTED_X, WANTED_Y, WANTED_SPIN = range(3, 9)
BODY_COLUMNS = 16


@inline(counts=False, inner=True)
def solve(world, found, touching):
    """Find the velocities of all robots that touch something."""
    robots = world.robots
    lists = world.lists
    for at in range(touching):
        robot = lists[TOUCHING, at]
        body = world.bodies[robot]
        body[BODY_X] = robots[SPEED_X, robot]
        body[BODY_Y] = robots[SPEED_Y, robot]
        body[BODY_SPIN] = robots[SPIN, robot]
        body[MOTOR_X] = robots[PUSH_X, robot]
        body[MOTOR_Y] = robots[PUSH_Y, robot]
        body[MOTOR_SPIN] = robots[PUSH_SPIN, robot]
        body[WANTED_X] = robots[TARGET_X, robot]
        body[WANTED_Y] = robots[TARGET_Y, robot]
        body[WANTED_SPIN] = robots[TARGET_SPIN, robot]
    sort(world, found)
    for at in range(found):
        weigh(world, lists[ORDER, at])
    for at in range(touching):
        body = world.bodies[lists[TOUCHING, at]]
        body[BODY_X] += body[MOTOR_X] * PER_MASS
        body[BODY_Y] += body[MOTOR_Y] * PER_MASS
        body[BODY_SPIN] += body[MOTOR_SPIN] * PER_INERTIA
    settle(world, found, touching, group(world, found, touching))
    for at in range(found):
        impulses = world.impulses[pair_of(world, at)]
        impulses[ALONG] = world.contacts[at, ALONG_NOW]
        impulses[ACROSS] = world.contacts[at, ACROSS_NOW]
    for at in range(touching):
        robot = lists[TOUCHING, at]
        body = world.bodies[robot]
        robots[SPEED_X, robot] = body[BODY_X]
        robots[SPEED_Y, robot] = body[BODY_Y]
        robots[SPIN, robot] = body[BODY_SPIN]
        robots[PUSH_X, robot] = body[MOTOR_X]
        robots[PUSH_Y, robot] = body[MOTOR_Y]
        robots[PUSH_SPIN, robot] = body[MOTOR_SPIN]
        robots[TOUCHES, robot] = 0.0


@inline(counts=False, inner=True)
def pair_of(world, index):
    """Return the place of a contact's pair in ``impulses``."""
    bodies = world.number + world.walls.shape[0]
    return world.links[index, FIRST] * bodies + world.links[index, SECOND]


@inline(counts=False, inner=True)
def sort(world, found):
    """Order contacts by level: each follows all that were found before it with one of its robots.

    Those of a level share no robot.
    """
    lists = world.lists
    levels = 0
    for index in range(found):
        robot = world.links[index, FIRST]
        other = world.links[index, SECOND]
        level = lists[LEVEL, robot]
        if other < world.number:
            level = max(level, lists[LEVEL, other])
            lists[LEVEL, other] = level + 1
        lists[LEVEL, robot] = level + 1
        lists[LEVELS, index] = level
        if level == levels:
            lists[LEVEL_STARTS, level] = 0
            levels += 1
        lists[LEVEL_STARTS, level] += 1
    start = 0
    for level in range(levels):
        count = lists[LEVEL_STARTS, level]
        lists[LEVEL_STARTS, level] = start
        start += count
    for index in range(found):
        level = lists[LEVELS, index]
        lists[ORDER, lists[LEVEL_STARTS, level]] = index
        lists[LEVEL_STARTS, level] += 1


@inline(counts=False, inner=True)
def leader(lists, robot):
    """Return the robot that stands for all that touch a robot, also through others."""
    while lists[LEADER, robot] != robot:
        robot = lists[LEADER, robot]
    return robot


@inline(counts=False, inner=True)
def group(world, found, touching):
    """Number the groups of robots that touch each other, also through others.

    Returns:
        how many they are.
    """
    lists = world.lists
    for index in range(found):
        other = world.links[index, SECOND]
        if other < world.number:
            one = leader(lists, world.links[index, FIRST])
            two = leader(lists, other)
            lists[LEADER, max(one, two)] = min(one, two)
    groups = 0
    for at in range(touching):
        robot = lists[TOUCHING, at]
        if lists[LEADER, robot] == robot:
            lists[GROUPS, robot] = groups
            world.changes[BEFORE, groups] = 1.0
            world.changes[NOW, groups] = 0.0
            groups += 1
    for at in range(touching):
        robot = lists[TOUCHING, at]
        lists[ACTIVE, at] = robot
        lists[GROUPS, robot] = lists[GROUPS, leader(lists, robot)]
    for index in range(found):
        world.links[index, GROUP] = lists[GROUPS, world.links[index, FIRST]]
    return groups


@inline(counts=False, inner=True)
def settle(world, found, touching, groups):
    """Find the velocities of all groups.

    An iteration goes through all groups: they do not depend on each other, either. A group whose
    impulses hardly changed in an iteration is left out of the next.
    """
    lists = world.lists
    bodies = world.bodies
    now = world.changes[NOW]
    number = world.number
    for _ in range(ITERATIONS):
        for at in range(found):
            index = lists[ORDER, at]
            link = world.links[index]
            contact = world.contacts[index]
            if link[SECOND] < number:
                change = part(bodies[link[FIRST]], bodies[link[SECOND]], contact)
            else:
                change = stop(bodies[link[FIRST]], contact)
            now[link[GROUP]] = max(now[link[GROUP]], change)
        for at in range(touching):
            robot = lists[ACTIVE, at]
            change = pull(bodies[robot])
            now[lists[GROUPS, robot]] = max(now[lists[GROUPS, robot]], change)
        settled = False
        for which in range(groups):
            if now[which] < SETTLED and world.changes[BEFORE, which] >= SETTLED:
                settled = True
            world.changes[BEFORE, which] = now[which]
            now[which] = 0.0
        if settled:
            found, touching = leave_out(world, found, touching)
            if touching == 0:
                break


@inline(counts=False, inner=True)
def leave_out(world, found, touching):
    """Leave out the contacts and robots of groups that are settled; return how many remain."""
    lists = world.lists
    before = world.changes[BEFORE]
    left = 0
    for at in range(found):
        index = lists[ORDER, at]
        lists[ORDER, left] = index
        left += 1 if before[world.links[index, GROUP]] >= SETTLED else 0
    remaining = 0
    for at in range(touching):
        robot = lists[ACTIVE, at]
        lists[ACTIVE, remaining] = robot
        remaining += 1 if before[lists[GROUPS, robot]] >= SETTLED else 0
    return left, remaining


@inline(counts=False, inner=True)
def weigh(world, index):
    """Compute the effective masses of a contact; apply its last impulses if it persists."""
    contact = world.contacts[index]
    two_robots = world.links[index, SECOND] < world.number
    nx = contact[NORMAL_X]
    ny = contact[NORMAL_Y]
    arm_along = contact[ARM_X] * ny - contact[ARM_Y] * nx
    arm_across = contact[ARM_X] * nx + contact[ARM_Y] * ny
    along = PER_MASS + PER_INERTIA * arm_along * arm_along
    across = PER_MASS + PER_INERTIA * arm_across * arm_across
    if two_robots:
        along += along  # of the other robot, whose arm is opposite
        across += across
    contact[ALONG_MASS] = 1.0 / along
    contact[ACROSS_MASS] = 1.0 / across
    impulses = world.impulses[pair_of(world, index)]
    gap = world.counts[SUBSTEP] - int(impulses[TOUCHED])
    if gap > CACHED:
        impulses[ALONG] = 0.0
        impulses[ACROSS] = 0.0
    contact[ALONG_NOW] = impulses[ALONG]
    contact[ACROSS_NOW] = impulses[ACROSS]
    impulses[TOUCHED] = world.counts[SUBSTEP]
    if gap == 1:
        one = world.bodies[world.links[index, FIRST]]
        if two_robots:
            two = world.bodies[world.links[index, SECOND]]
            push_apart(one, two, contact, contact[ALONG_NOW], contact[ACROSS_NOW])
        else:
            push(one, contact, contact[ALONG_NOW], contact[ACROSS_NOW])


@inline(counts=False, inner=True)
def push(body, contact, along, across):
    """Apply an impulse against the normal, and one across it, to a robot."""
    x = contact[NORMAL_X] * along - contact[NORMAL_Y] * across
    y = contact[NORMAL_X] * across + contact[NORMAL_Y] * along
    turned = PER_INERTIA * (contact[ARM_X] * y - contact[ARM_Y] * x)
    body[BODY_X] -= x * PER_MASS
    body[BODY_Y] -= y * PER_MASS
    body[BODY_SPIN] -= turned


@inline(counts=False, inner=True)
def push_apart(one, two, contact, along, across):
    """Apply an impulse along the normal, and one across it, to both robots of a contact."""
    x = contact[NORMAL_X] * along - contact[NORMAL_Y] * across
    y = contact[NORMAL_X] * across + contact[NORMAL_Y] * along
    turned = PER_INERTIA * (contact[ARM_X] * y - contact[ARM_Y] * x)
    one_x = one[BODY_X] - x * PER_MASS
    one_y = one[BODY_Y] - y * PER_MASS
    one_spin = one[BODY_SPIN] - turned
    two_x = two[BODY_X] + x * PER_MASS
    two_y = two[BODY_Y] + y * PER_MASS
    two_spin = two[BODY_SPIN] - turned
    one[BODY_X] = one_x
    one[BODY_Y] = one_y
    one[BODY_SPIN] = one_spin
    two[BODY_X] = two_x
    two[BODY_Y] = two_y
    two[BODY_SPIN] = two_spin


@inline(counts=False, inner=True)
def part(one, two, contact):
    """Stop the approach of two robots, and their sliding as far as friction does.

    Returns:
        how much the impulses changed, N s.
    """
    x = one[BODY_SPIN] * contact[ARM_Y] - one[BODY_X]
    y = -one[BODY_SPIN] * contact[ARM_X] - one[BODY_Y]
    x += two[BODY_X] + two[BODY_SPIN] * contact[ARM_Y]
    y += two[BODY_Y] - two[BODY_SPIN] * contact[ARM_X]
    along, across = changes(contact, x, y)
    push_apart(one, two, contact, along, across)
    return max(abs(along), abs(across))


@inline(counts=False, inner=True)
def stop(body, contact):
    """Stop a robot at a wall, and its sliding as far as friction does; return as ``part``."""
    x = body[BODY_SPIN] * contact[ARM_Y] - body[BODY_X]
    y = -body[BODY_SPIN] * contact[ARM_X] - body[BODY_Y]
    along, across = changes(contact, x, y)
    push(body, contact, along, across)
    return max(abs(along), abs(across))


@inline(counts=False, inner=True)
def changes(contact, x, y):
    """Update a contact's impulses for a relative velocity; return by how much they change."""
    nx = contact[NORMAL_X]
    ny = contact[NORMAL_Y]
    old_along = contact[ALONG_NOW]
    old_across = contact[ACROSS_NOW]
    along = max(old_along - (x * nx + y * ny) * contact[ALONG_MASS], 0.0)
    most = contact[FRICTION] * along
    across = old_across - (y * nx - x * ny) * contact[ACROSS_MASS]
    across = min(max(across, -most), most)
    contact[ALONG_NOW] = along
    contact[ACROSS_NOW] = across
    return along - old_along, across - old_across


@inline(counts=False, inner=True)
def pull(body):
    """Let the motors of a robot pull its velocities to their targets, within their force.

    Returns:
        how much the impulses changed, N s and N m s.
    """
    old_x = body[MOTOR_X]
    old_y = body[MOTOR_Y]
    x = old_x + MASS * (body[WANTED_X] - body[BODY_X])
    y = old_y + MASS * (body[WANTED_Y] - body[BODY_Y])
    square = x * x + y * y
    if square > MOST_IMPULSE * MOST_IMPULSE:
        limited = MOST_IMPULSE / sqrt(square)
        x *= limited
        y *= limited
    old = body[MOTOR_SPIN]
    spin = old + INERTIA * (body[WANTED_SPIN] - body[BODY_SPIN])
    spin = min(max(spin, -MOST_IMPULSE), MOST_IMPULSE)
    body[MOTOR_X] = x
    body[MOTOR_Y] = y
    body[MOTOR_SPIN] = spin
    body[BODY_X] += (x - old_x) * PER_MASS
    body[BODY_Y] += (y - old_y) * PER_MASS
    body[BODY_SPIN] += (spin - old) * PER_INERTIA
    return max(abs(x - old_x), abs(y - old_y), abs(spin - old))
