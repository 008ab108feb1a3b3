"""Find the contacts of e-puck robots with each other and with walls.

Source: the shapes and the order of Chipmunk 6. docs/epuck.md describes it.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline, sqrt
from zswarm.sims.epuck.world import (
    CENTRE_X,
    CENTRE_Y,
    HALF_LENGTH,
    HALF_WIDTH,
    LEADER,
    LEVEL,
    RADIUS,
    TOUCHES,
    TOUCHING,
    WALL_COSINE,
    WALL_SINE,
    X,
    Y,
)

BETWEEN_ROBOTS, WITH_WALL = 0.7 * 0.7, 0.7 * 0.1  # friction

# ``contacts``: a row for each that touches in this substep. The arm reaches from the first robot's
# centre to the contact; that of a second robot is opposite.
NORMAL_X, NORMAL_Y, ARM_X, ARM_Y, FRICTION = range(5)
ALONG_MASS, ACROSS_MASS, ALONG_NOW, ACROSS_NOW, CONTACT_COLUMNS = range(5, 10)
# ``links``: of these contacts.
FIRST, SECOND, GROUP, LINK_COLUMNS = range(4)


@inline(counts=False, inner=True)
def find_contacts(world, pairs):
    """List the pairs that touch, with normals and arms; list the robots that touch something.

    Returns:
        their numbers.
    """
    found = 0
    touching = 0
    for index in range(pairs):
        robot = world.pairs[index, FIRST]
        other = world.pairs[index, SECOND]
        contact = world.contacts[found]
        if other < world.number:
            if not meet_robot(world.robots, robot, other, contact):
                continue
            touching = touch(world, other, touching)
        elif not meet_wall(
            world.robots, robot, world.walls[other - world.number], contact
        ):
            continue
        touching = touch(world, robot, touching)
        world.links[found, FIRST] = robot
        world.links[found, SECOND] = other
        found += 1
    return found, touching


@inline(counts=False, inner=True)
def touch(world, robot, touching):
    """List a robot that touches something, once; return how many are listed."""
    if world.robots[TOUCHES, robot] > 0.0:
        return touching
    world.robots[TOUCHES, robot] = 1.0
    world.lists[TOUCHING, touching] = robot
    world.lists[LEADER, robot] = robot
    world.lists[LEVEL, robot] = 0
    return touching + 1


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
    contact[FRICTION] = BETWEEN_ROBOTS
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
    contact[FRICTION] = WITH_WALL
    return True
