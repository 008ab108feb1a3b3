"""Compute the readings of e-puck robots: proximity, light, ground, and messages of neighbours.

docs/epuck.md has the equations. Angles of sensors are those of their rays for proximity, and the
nominal ones, which controllers use, for light.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

import numpy as np

from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.portable import PI, atan2, exp
from zswarm.kernels.random import draw_uniform
from zswarm.sims.epuck.walls import first_near, is_near, to_box
from zswarm.sims.epuck.world import (
    ANGLE,
    COSINE,
    DISC,
    GREY,
    GROUND,
    GROUND_NOISE,
    HEARD,
    HEARD_X,
    HEARD_Y,
    INTENSITY,
    LAMP_X,
    LAMP_Y,
    LAMP_Z,
    LIGHT,
    LIGHT_NOISE,
    LOSS,
    MIDDLE_GREY,
    PLACE_X,
    PLACE_Y,
    PROXIMITY,
    PROXIMITY_NOISE,
    RADIUS,
    ROBOT_HEIGHT,
    SHAPE,
    SINE,
    SIZE_X,
    SIZE_Y,
    WALL_HEIGHT,
    X,
    Y,
    unit_vectors,
)
from zswarm.sims.toolbox import disturbed

SENSORS = 8  # of proximity, and of light
RING = RADIUS + 0.001  # where rays of proximity sensors start
RAY = float(np.float32(0.05))
RAY_X, RAY_Y = unit_vectors([PI / 16 + sensor * PI / 4 for sensor in range(SENSORS)])
# The reading at a distance d: (SQUARE d + LINEAR) d + CONSTANT.
SQUARE, LINEAR, CONSTANT = map(float, map(np.float32, (298.701, -36.8961, 1.08212)))
# Nominal angles are pi divided by these.
DIVISORS = 10.5884, 3.5999, 2.0, 1.2, 0.8571, 0.6667, 0.5806, 0.5247
ANGLES = np.array([PI / float(np.float32(divisor)) for divisor in DIVISORS])
ANGLES_X, ANGLES_Y = unit_vectors(ANGLES.tolist())
FARTHEST = 2.5  # distance / intensity at which a lamp is seen
DECAY = 2.0  # of light, per distance / intensity
GROUND_AHEAD, GROUND_ASIDE = 0.03, 0.009  # of the centre


@inline(counts=False, inner=True, copied=False)
def sense(world):
    """Write the readings of all robots."""
    robots = world.robots
    for row in range(PROXIMITY, HEARD_Y + 1):
        robots[row] = 0.0
    meet(world)
    for robot in range(world.number):
        see_walls(world, robot)
        see_lamp(world, robot)
        see_floor(world, robot)


@inline(counts=False, inner=True)
def meet(world):
    """Let robots sense each other's bodies and receive each other's messages."""
    robots = world.robots
    near = RING + RAY + RADIUS
    hearing = world.hearing
    reach = max(near, hearing)
    for robot in range(world.number):
        for other in range(robot + 1, world.number):
            dx = robots[X, other] - robots[X, robot]
            dy = robots[Y, other] - robots[Y, robot]
            square = dx * dx + dy * dy
            if square >= reach * reach:
                continue
            if square < near * near:
                see_robot(robots, robot, dx, dy)
                see_robot(robots, other, -dx, -dy)
            if square < hearing * hearing:
                lost = world.constants[LOSS]
                hears = draw_uniform(world.stream) >= lost
                is_heard = draw_uniform(world.stream) >= lost
                if (hears or is_heard) and not hidden(world, robot, other, dx, dy):
                    distance = sqrt(square)
                    if hears:
                        hear(robots, robot, dx, dy, distance)
                    if is_heard:
                        hear(robots, other, -dx, -dy, distance)


@inline(counts=False, inner=True)
def see_robot(robots, robot, dx, dy):
    """Raise the proximity readings whose rays hit a robot at an offset."""
    ahead = dx * robots[COSINE, robot] + dy * robots[SINE, robot]
    aside = dy * robots[COSINE, robot] - dx * robots[SINE, robot]
    for sensor in range(SENSORS):
        along = ahead * RAY_X[sensor] + aside * RAY_Y[sensor]
        across = aside * RAY_X[sensor] - ahead * RAY_Y[sensor]
        chord = RADIUS * RADIUS - across * across
        if chord > 0.0:
            distance = along - sqrt(chord) - RING
            if 0.0 <= distance < RAY:
                value = (SQUARE * distance + LINEAR) * distance + CONSTANT
                row = PROXIMITY + sensor
                robots[row, robot] = max(robots[row, robot], min(value, 1.0))


@inline(counts=False, inner=True)
def hidden(world, robot, other, dx, dy):
    """Return whether a third body is between two robots."""
    robots = world.robots
    x = robots[X, robot]
    y = robots[Y, robot]
    square = dx * dx + dy * dy
    for third in range(world.number):
        if third in (robot, other):
            continue
        third_x = robots[X, third] - x
        third_y = robots[Y, third] - y
        along = third_x * dx + third_y * dy
        across = third_y * dx - third_x * dy
        chord = RADIUS * RADIUS * square - across * across
        if chord > 0.0:
            crossing = along - sqrt(chord * square)
            if 0.0 <= crossing < square:
                return True
    for wall in range(world.outer_walls, world.walls.shape[0]):
        if to_box(world.walls[wall], x, y, dx, dy) < 1.0:
            return True
    return False


@inline(counts=False, inner=True)
def hear(robots, robot, dx, dy, distance):
    """Count a message, and add its vector: 1 / (1 + the distance of the bodies in cm) long."""
    ahead = dx * robots[COSINE, robot] + dy * robots[SINE, robot]
    aside = dy * robots[COSINE, robot] - dx * robots[SINE, robot]
    robots[HEARD, robot] += 1.0
    if aside == 0.0 and ahead > 0.0:  # a bearing of exactly 0 is ignored
        return
    weight = 1.0 / (1.0 + (100.0 * distance - 7.0)) / distance
    robots[HEARD_X, robot] += weight * ahead
    robots[HEARD_Y, robot] += weight * aside


@inline(counts=False, inner=True)
def see_walls(world, robot):
    """Raise the proximity readings whose rays hit walls; add noise to all."""
    robots = world.robots
    x = robots[X, robot]
    y = robots[Y, robot]
    cosine = robots[COSINE, robot]
    sine = robots[SINE, robot]
    for wall in range(first_near(world, x, y, RING + RAY), world.walls.shape[0]):
        box = world.walls[wall]
        if not is_near(box, x, y, RING + RAY):
            continue
        for sensor in range(SENSORS):
            ray_x = RAY_X[sensor] * cosine - RAY_Y[sensor] * sine
            ray_y = RAY_X[sensor] * sine + RAY_Y[sensor] * cosine
            part = to_box(
                box, x + RING * ray_x, y + RING * ray_y, RAY * ray_x, RAY * ray_y
            )
            if part < 1.0:
                distance = part * RAY
                value = (SQUARE * distance + LINEAR) * distance + CONSTANT
                row = PROXIMITY + sensor
                robots[row, robot] = max(robots[row, robot], min(value, 1.0))
    for sensor in range(SENSORS):
        disturb(world, PROXIMITY + sensor, robot, PROXIMITY_NOISE)


@inline(counts=False, inner=True)
def disturb(world, row, robot, kind):
    """Add uniform noise to a reading, and limit it to 0..1."""
    most = world.constants[kind]
    world.robots[row, robot] = disturbed(world.robots[row, robot], most, world.stream)


@inline(counts=False, inner=True)
def see_lamp(world, robot):
    """Write the light readings."""
    robots = world.robots
    lamp = world.constants
    dx = lamp[LAMP_X] - robots[X, robot]
    dy = lamp[LAMP_Y] - robots[Y, robot]
    square = dx * dx + dy * dy
    if lamp[INTENSITY] > 0.0 and not dimmed(world, robot, dx, dy, sqrt(square)):
        distance = sqrt(square + lamp[LAMP_Z] * lamp[LAMP_Z]) / lamp[INTENSITY]
        brightness = exp(-DECAY * distance) if distance <= FARTHEST else 0.0
        bearing = atan2(dy, dx) - robots[ANGLE, robot]
        for sensor in range(SENSORS):
            off = (bearing - ANGLES[sensor]) / (2.0 * PI)
            off = abs(off - np.floor(off + 0.5)) * (2.0 * PI)
            if off < 0.5 * PI:
                robots[LIGHT + sensor, robot] = brightness * (1.0 - 2.0 * off / PI)
    for sensor in range(SENSORS):
        disturb(world, LIGHT + sensor, robot, LIGHT_NOISE)


@inline(counts=False, inner=True)
def dimmed(world, robot, dx, dy, distance):
    """Return whether a robot or an inner wall hides the lamp from a robot's place on the floor."""
    robots = world.robots
    x = robots[X, robot]
    y = robots[Y, robot]
    # Where the ray is as high as a robot; it is higher from there on.
    farthest = distance * ROBOT_HEIGHT / world.constants[LAMP_Z]
    reach = farthest + RADIUS
    for other in range(world.number):
        if other == robot:
            continue
        other_x = robots[X, other] - x
        other_y = robots[Y, other] - y
        if other_x * other_x + other_y * other_y > reach * reach:
            continue
        along = (other_x * dx + other_y * dy) / distance
        across = (other_y * dx - other_x * dy) / distance
        chord = RADIUS * RADIUS - across * across
        if chord > 0.0:
            crossing = along - sqrt(chord)
            if 0.0 <= crossing <= farthest:
                return True
    for wall in range(world.outer_walls, world.walls.shape[0]):
        part = to_box(world.walls[wall], x, y, dx, dy)
        if part * world.constants[LAMP_Z] <= world.walls[wall][WALL_HEIGHT]:
            return True
    return False


@inline(counts=False, inner=True)
def see_floor(world, robot):
    """Write the ground readings: right, centre and left."""
    robots = world.robots
    cosine = robots[COSINE, robot]
    sine = robots[SINE, robot]
    for sensor in range(3):
        aside = GROUND_ASIDE * (sensor - 1)
        x = robots[X, robot] + GROUND_AHEAD * cosine - aside * sine
        y = robots[Y, robot] + GROUND_AHEAD * sine + aside * cosine
        robots[GROUND + sensor, robot] = grey_at(world.floor, x, y)
        disturb(world, GROUND + sensor, robot, GROUND_NOISE)


@inline(counts=False, inner=True)
def grey_at(floor, x, y):
    """Return the grey of the floor at a point, from 0, black, to 1, white."""
    for place in range(floor.shape[0]):
        dx = x - floor[place, PLACE_X]
        dy = y - floor[place, PLACE_Y]
        if floor[place, SHAPE] == DISC:
            inside = dx * dx + dy * dy <= floor[place, SIZE_X] * floor[place, SIZE_X]
        else:
            inside = abs(dx) < floor[place, SIZE_X] and abs(dy) < floor[place, SIZE_Y]
        if inside:
            return floor[place, GREY]
    return MIDDLE_GREY
