"""Solve the contacts of e-puck robots with each other and with walls, by sequential impulses.

Source: E. Catto, "Iterative Dynamics with Temporal Coherence", 2005, in the form and order of
Chipmunk 6. docs/epuck.md describes it.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline, sqrt
from zswarm.sims.epuck.world import (
    ACROSS,
    ALONG,
    CENTRE_X,
    CENTRE_Y,
    CHANGE,
    CHANGES,
    HALF_LENGTH,
    HALF_WIDTH,
    MASS,
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
    WALL_COSINE,
    WALL_SINE,
    X,
    Y,
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
BETWEEN_ROBOTS, WITH_WALL = 0.7 * 0.7, 0.7 * 0.1  # friction
CACHED = 3  # substeps for which the impulses of a contact that ended are cached

# ``contacts``: a row for each that touches in this substep.
FIRST, SECOND, PAIR, NORMAL_X, NORMAL_Y, ARM_X, ARM_Y, OTHER_X, OTHER_Y = range(9)
ALONG_MASS, ACROSS_MASS, FRICTION, CONTACT_COLUMNS = range(9, 13)


@inline(counts=False, inner=True)
def find_contacts(world, pairs):
    """List the pairs that touch, with normals and the arms of their points.

    Returns:
        their number.
    """
    bodies = world.number + world.walls.shape[0]
    found = 0
    for index in range(pairs):
        pair = world.pairs[index]
        robot = pair // bodies
        other = pair - robot * bodies
        contact = world.contacts[found]
        if other < world.number:
            touching = meet_robot(world.robots, robot, other, contact)
        else:
            box = world.walls[other - world.number]
            touching = meet_wall(world.robots, robot, box, contact)
        if touching:
            contact[FIRST] = robot
            contact[SECOND] = other
            contact[PAIR] = pair
            found += 1
    return found


@inline(counts=False, inner=True)
def meet_robot(robots, robot, other, contact):
    """Write the contact of two robots; return whether they touch."""
    dx = robots[X, other] - robots[X, robot]
    dy = robots[Y, other] - robots[Y, robot]
    square = dx * dx + dy * dy
    if not square < (2.0 * RADIUS) * (2.0 * RADIUS):
        return False
    distance = sqrt(square)
    contact[NORMAL_X] = dx / distance if distance > 0.0 else 1.0
    contact[NORMAL_Y] = dy / distance if distance > 0.0 else 0.0
    contact[ARM_X] = dx * 0.5
    contact[ARM_Y] = dy * 0.5
    contact[OTHER_X] = -dx * 0.5
    contact[OTHER_Y] = -dy * 0.5
    contact[FRICTION] = BETWEEN_ROBOTS
    robots[TOUCHES, robot] = 1.0
    robots[TOUCHES, other] = 1.0
    return True


@inline(counts=False, inner=True)
def meet_wall(robots, robot, box, contact):
    """Write the contact of a robot and a wall; return whether they touch."""
    dx = robots[X, robot] - box[CENTRE_X]
    dy = robots[Y, robot] - box[CENTRE_Y]
    cosine = box[WALL_COSINE]
    sine = box[WALL_SINE]
    along = dx * cosine + dy * sine
    across = dy * cosine - dx * sine
    beyond = abs(along) - box[HALF_LENGTH]
    above = abs(across) - box[HALF_WIDTH]
    if max(beyond, above) >= RADIUS:
        return False
    along_sign = -1.0 if along < 0.0 else 1.0
    across_sign = -1.0 if across < 0.0 else 1.0
    if beyond > 0.0 and above > 0.0:  # towards a corner
        distance = sqrt(beyond * beyond + above * above)
        if distance >= RADIUS:
            return False
        to_along = -along_sign * beyond / distance
        to_across = -across_sign * above / distance
        arm = 0.5 * (RADIUS + distance)
    else:
        if above >= beyond:
            to_along = 0.0
            to_across = -across_sign
        else:
            to_along = -along_sign
            to_across = 0.0
        arm = 0.5 * (RADIUS + max(beyond, above))
    normal_x = to_along * cosine - to_across * sine
    normal_y = to_along * sine + to_across * cosine
    contact[NORMAL_X] = normal_x
    contact[NORMAL_Y] = normal_y
    contact[ARM_X] = normal_x * arm
    contact[ARM_Y] = normal_y * arm
    contact[OTHER_X] = 0.0
    contact[OTHER_Y] = 0.0
    contact[FRICTION] = WITH_WALL
    robots[TOUCHES, robot] = 1.0
    return True


@inline(counts=False, inner=True, copied=False)
def solve(world, contacts):
    """Find the velocities of all robots that touch something."""
    robots = world.robots
    for index in range(contacts):
        weigh(world, world.contacts[index])
    for robot in range(world.number):
        if robots[TOUCHES, robot] > 0.0:
            robots[SPEED_X, robot] += robots[PUSH_X, robot] * PER_MASS
            robots[SPEED_Y, robot] += robots[PUSH_Y, robot] * PER_MASS
            robots[SPIN, robot] += robots[PUSH_SPIN, robot] * PER_INERTIA
    connect(world, contacts)
    settle(world, contacts)
    robots[TOUCHES] = 0.0


@inline(counts=False, inner=True)
def connect(world, contacts):
    """Give robots that touch each other, also through others, the number of the first of them."""
    groups = world.groups
    for robot in range(world.number):
        groups[robot] = robot
    changed = True
    while changed:
        changed = False
        for index in range(contacts):
            other = int(world.contacts[index, SECOND])
            if other < world.number:
                robot = int(world.contacts[index, FIRST])
                if groups[robot] != groups[other]:
                    groups[robot] = groups[other] = min(groups[robot], groups[other])
                    changed = True


@inline(counts=False, inner=True)
def settle(world, contacts):
    """Find the velocities of all groups of robots that touch each other.

    An iteration goes through all groups: they do not depend on each other, so a processor computes
    several at once. A group whose impulses hardly changed in an iteration is left out of the next.
    """
    robots = world.robots
    groups = world.groups
    touching = 0
    for robot in range(world.number):
        robots[CHANGE, robot] = 1.0
        robots[CHANGES, robot] = 0.0
        if robots[TOUCHES, robot] > 0.0:
            groups[world.number + touching] = robot
            touching += 1
    for _ in range(ITERATIONS):
        for index in range(contacts):
            contact = world.contacts[index]
            group = groups[int(contact[FIRST])]
            if robots[CHANGE, group] >= SETTLED:
                change = separate(world, contact)
                robots[CHANGES, group] = max(robots[CHANGES, group], change)
        unsettled = False
        for at in range(world.number, world.number + touching):
            group = groups[groups[at]]
            if robots[CHANGE, group] >= SETTLED:
                change = pull(robots, groups[at])
                robots[CHANGES, group] = max(robots[CHANGES, group], change)
        for at in range(world.number, world.number + touching):
            robot = groups[at]
            robots[CHANGE, robot] = robots[CHANGES, robot]
            robots[CHANGES, robot] = 0.0
            unsettled = unsettled or robots[CHANGE, robot] >= SETTLED
        if not unsettled:
            break


@inline(counts=False, inner=True)
def weigh(world, contact):
    """Compute the effective masses of a contact; apply its last impulses if it persists."""
    pair = int(contact[PAIR])
    nx = contact[NORMAL_X]
    ny = contact[NORMAL_Y]
    arm_along = contact[ARM_X] * ny - contact[ARM_Y] * nx
    arm_across = contact[ARM_X] * nx + contact[ARM_Y] * ny
    along = PER_MASS + PER_INERTIA * arm_along * arm_along
    across = PER_MASS + PER_INERTIA * arm_across * arm_across
    if contact[SECOND] < world.number:
        arm_along = contact[OTHER_X] * ny - contact[OTHER_Y] * nx
        arm_across = contact[OTHER_X] * nx + contact[OTHER_Y] * ny
        along += PER_MASS + PER_INERTIA * arm_along * arm_along
        across += PER_MASS + PER_INERTIA * arm_across * arm_across
    contact[ALONG_MASS] = 1.0 / along
    contact[ACROSS_MASS] = 1.0 / across
    impulses = world.impulses[pair]
    gap = world.counts[SUBSTEP] - int(impulses[TOUCHED])
    if gap > CACHED:
        impulses[ALONG] = 0.0
        impulses[ACROSS] = 0.0
    elif gap == 1:
        push(world, contact, impulses[ALONG], impulses[ACROSS])
    impulses[TOUCHED] = world.counts[SUBSTEP]


@inline(counts=False, inner=True)
def push(world, contact, along, across):
    """Apply an impulse along the normal and one across it, to its left."""
    robots = world.robots
    impulse_x = contact[NORMAL_X] * along - contact[NORMAL_Y] * across
    impulse_y = contact[NORMAL_X] * across + contact[NORMAL_Y] * along
    robot = int(contact[FIRST])
    robots[SPEED_X, robot] -= impulse_x * PER_MASS
    robots[SPEED_Y, robot] -= impulse_y * PER_MASS
    robots[SPIN, robot] -= PER_INERTIA * (
        contact[ARM_X] * impulse_y - contact[ARM_Y] * impulse_x
    )
    other = int(contact[SECOND])
    if other < world.number:
        robots[SPEED_X, other] += impulse_x * PER_MASS
        robots[SPEED_Y, other] += impulse_y * PER_MASS
        robots[SPIN, other] += PER_INERTIA * (
            contact[OTHER_X] * impulse_y - contact[OTHER_Y] * impulse_x
        )


@inline(counts=False, inner=True)
def separate(world, contact):
    """Stop the approach of a contact, and its sliding as far as friction does.

    Returns:
        how much the impulses changed, N s.
    """
    robots = world.robots
    robot = int(contact[FIRST])
    other = int(contact[SECOND])
    x = robots[SPIN, robot] * contact[ARM_Y] - robots[SPEED_X, robot]
    y = -robots[SPIN, robot] * contact[ARM_X] - robots[SPEED_Y, robot]
    if other < world.number:
        x += robots[SPEED_X, other] - robots[SPIN, other] * contact[OTHER_Y]
        y += robots[SPEED_Y, other] + robots[SPIN, other] * contact[OTHER_X]
    impulses = world.impulses[int(contact[PAIR])]
    along = x * contact[NORMAL_X] + y * contact[NORMAL_Y]
    across = y * contact[NORMAL_X] - x * contact[NORMAL_Y]
    old_along = impulses[ALONG]
    old_across = impulses[ACROSS]
    impulses[ALONG] = max(old_along - along * contact[ALONG_MASS], 0.0)
    most = contact[FRICTION] * impulses[ALONG]
    impulses[ACROSS] = min(max(old_across - across * contact[ACROSS_MASS], -most), most)
    along = impulses[ALONG] - old_along
    across = impulses[ACROSS] - old_across
    push(world, contact, along, across)
    return max(abs(along), abs(across))


@inline(counts=False, inner=True)
def pull(robots, robot):
    """Let the motors of a robot pull its velocities to their targets, within their force.

    Returns:
        how much the impulses changed, N s and N m s.
    """
    old_x = robots[PUSH_X, robot]
    old_y = robots[PUSH_Y, robot]
    x = old_x + MASS * (robots[TARGET_X, robot] - robots[SPEED_X, robot])
    y = old_y + MASS * (robots[TARGET_Y, robot] - robots[SPEED_Y, robot])
    square = x * x + y * y
    if square > MOST_IMPULSE * MOST_IMPULSE:
        part = MOST_IMPULSE / sqrt(square)
        x *= part
        y *= part
    robots[PUSH_X, robot] = x
    robots[PUSH_Y, robot] = y
    robots[SPEED_X, robot] += (x - old_x) * PER_MASS
    robots[SPEED_Y, robot] += (y - old_y) * PER_MASS
    old = robots[PUSH_SPIN, robot]
    spin = old + INERTIA * (robots[TARGET_SPIN, robot] - robots[SPIN, robot])
    spin = min(max(spin, -MOST_IMPULSE), MOST_IMPULSE)
    robots[PUSH_SPIN, robot] = spin
    robots[SPIN, robot] += (spin - old) * PER_INERTIA
    return max(abs(x - old_x), abs(y - old_y), abs(spin - old))
