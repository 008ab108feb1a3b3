"""Compute the readings of e-puck robots: proximity, light, ground, and messages of neighbours.

docs/epuck.md has the equations. Angles of sensors are those of their rays for proximity, and the
nominal ones, which controllers use, for light.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

import numpy as np

from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.lanes import (
    LANES,
    any_of,
    fill,
    floor,
    list_true,
    load,
    select,
    store,
)
from zswarm.kernels.portable import PI, atan2, exp
from zswarm.kernels.random import draw_uniforms, skip
from zswarm.sims.epuck.walls import first_near, is_near, to_box
from zswarm.sims.epuck.world import (
    ANGLE,
    AUDIBLE,
    BEARING,
    BESIDE,
    BRIGHTNESS,
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
    NEAR,
    NOISY,
    PLACE_X,
    PLACE_Y,
    PROXIMITY,
    PROXIMITY_NOISE,
    RADIUS,
    RECEIVED,
    ROBOT_HEIGHT,
    SENDER,
    SHAPE,
    SINE,
    SIZE_X,
    SIZE_Y,
    WALL_HEIGHT,
    X,
    Y,
    unit_vectors,
)

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
WALL_Z = 0.08  # height of the outer walls
GROUND_AHEAD, GROUND_ASIDE = 0.03, 0.009  # of the centre


@inline(counts=False, inner=True, copied=False)
def sense(world):
    """Write the readings of all robots."""
    robots = world.robots
    for row in range(PROXIMITY, HEARD_Y + 1):
        for at in range(0, robots.shape[1], LANES):
            store(robots[row], at, fill(0.0))
    meet(world)
    draw_uniforms(world.stream, world.noise, NOISY, world.noise.shape[1])
    skip(world.stream, NOISY * world.number)
    for robot in range(world.number):
        see_walls(world, robot)
    for row in range(SENSORS):
        disturb(world, PROXIMITY + row, row, PROXIMITY_NOISE)
    if world.constants[INTENSITY] > 0.0:
        for robot in range(world.number):
            see_lamp(world, robot)
        for sensor in range(SENSORS):
            light(world, sensor)
    for row in range(SENSORS):
        disturb(world, LIGHT + row, SENSORS + row, LIGHT_NOISE)
    for sensor in range(3):
        see_floor(world, sensor)
        disturb(world, GROUND + sensor, 2 * SENSORS + sensor, GROUND_NOISE)


@inline(counts=False, inner=True)
def meet(world):
    """Let robots sense each other's bodies and receive each other's messages."""
    robots = world.robots
    meetings = world.meetings
    near, audible = list_meetings(world)
    for at in range(near):
        robot = meetings[NEAR, at]
        other = meetings[BESIDE, at]
        dx = robots[X, other] - robots[X, robot]
        dy = robots[Y, other] - robots[Y, robot]
        see_robot(world, robot, dx, dy)
        see_robot(world, other, -dx, -dy)
    for robot in range(world.number):
        for sensor in range(SENSORS):
            robots[PROXIMITY + sensor, robot] = world.rays[SENSORS * robot + sensor]
            world.rays[SENSORS * robot + sensor] = 0.0
    draw_uniforms(world.stream, world.chances, 2, audible)
    skip(world.stream, 2 * audible)
    lost = world.constants[LOSS]
    heard = 0
    for at in range(audible):  # without a branch, which no processor could predict
        meetings[RECEIVED, heard] = at
        hears = world.chances[0, at] >= lost
        heard += 1 if hears | (world.chances[1, at] >= lost) else 0
    for index in range(heard):
        at = meetings[RECEIVED, index]
        robot = meetings[AUDIBLE, at]
        other = meetings[SENDER, at]
        dx = robots[X, other] - robots[X, robot]
        dy = robots[Y, other] - robots[Y, robot]
        if not hidden(world, robot, other, dx, dy):
            distance = sqrt(dx * dx + dy * dy)
            if world.chances[0, at] >= lost:
                hear(robots, robot, dx, dy, distance)
            if world.chances[1, at] >= lost:
                hear(robots, other, -dx, -dy, distance)


@inline(counts=False, inner=True)
def list_meetings(world):
    """List the pairs of robots that may sense each other's bodies, and those in range.

    Returns:
        their numbers.
    """
    robots = world.robots
    meetings = world.meetings
    reach = RING + RAY + RADIUS
    hearing = world.hearing
    near = 0
    audible = 0
    for robot in range(world.number):
        x = robots[X, robot]
        y = robots[Y, robot]
        for at in range((robot + 1) // LANES * LANES, robots.shape[1], LANES):
            dx = load(robots[X], at) - x
            dy = load(robots[Y], at) - y
            squares = dx * dx + dy * dy
            later = load(world.places, at) > float(robot)
            store(meetings[NEAR], near, fill(np.int32(robot)))
            which = (squares < reach * reach) & later
            near += list_true(which, at, meetings[BESIDE], near)
            store(meetings[AUDIBLE], audible, fill(np.int32(robot)))
            which = (squares < hearing * hearing) & later
            audible += list_true(which, at, meetings[SENDER], audible)
    return near, audible


@inline(counts=False, inner=True)
def see_robot(world, robot, dx, dy):
    """Raise the proximity readings, one in each lane, whose rays hit a robot at an offset."""
    robots = world.robots
    ahead = dx * robots[COSINE, robot] + dy * robots[SINE, robot]
    aside = dy * robots[COSINE, robot] - dx * robots[SINE, robot]
    rays_x = load(RAY_X, 0)
    rays_y = load(RAY_Y, 0)
    along = rays_x * ahead + rays_y * aside
    across = rays_x * aside - rays_y * ahead
    chord = RADIUS * RADIUS - across * across
    hit = chord > 0.0
    distance = along - sqrt(select(hit, chord, 0.0)) - RING
    hit = hit & (distance >= 0.0) & (distance < RAY)
    value = (distance * SQUARE + LINEAR) * distance + CONSTANT
    value = select(value < 1.0, value, 1.0)
    reading = load(world.rays, SENSORS * robot)
    store(world.rays, SENSORS * robot, select(hit & (value > reading), value, reading))


@inline(counts=False, inner=True)
def hidden(world, robot, other, dx, dy):
    """Return whether a third body is between two robots."""
    robots = world.robots
    x = robots[X, robot]
    y = robots[Y, robot]
    square = dx * dx + dy * dy
    for at in range(0, robots.shape[1], LANES):
        third_x = load(robots[X], at) - x
        third_y = load(robots[Y], at) - y
        along = third_x * dx + third_y * dy
        across = third_y * dx - third_x * dy
        chord = RADIUS * RADIUS * square - across * across
        may = (chord > 0.0) & (along > 0.0) & (along < square + square)
        may = may & (load(world.places, at) != float(other))
        if any_of(may):
            crossing = along - sqrt(select(may, chord, 0.0) * square)
            if any_of(may & (crossing >= 0.0) & (crossing < square)):
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
    """Raise the proximity readings whose rays hit walls."""
    robots = world.robots
    x = robots[X, robot]
    y = robots[Y, robot]
    for wall in range(first_near(world, x, y, RING + RAY), world.walls.shape[0]):
        box = world.walls[wall]
        if is_near(box, x, y, RING + RAY):
            see_wall(robots, robot, box)


@inline(counts=False, inner=True)
def see_wall(robots, robot, box):
    """Raise the proximity readings whose rays hit a wall."""
    x = robots[X, robot]
    y = robots[Y, robot]
    cosine = robots[COSINE, robot]
    sine = robots[SINE, robot]
    for sensor in range(SENSORS):
        ray_x = RAY_X[sensor] * cosine - RAY_Y[sensor] * sine
        ray_y = RAY_X[sensor] * sine + RAY_Y[sensor] * cosine
        part = to_box(box, x + RING * ray_x, y + RING * ray_y, RAY * ray_x, RAY * ray_y)
        if part < 1.0:
            distance = part * RAY
            value = (SQUARE * distance + LINEAR) * distance + CONSTANT
            row = PROXIMITY + sensor
            robots[row, robot] = max(robots[row, robot], min(value, 1.0))


@inline(counts=False, inner=True)
def disturb(world, row, noise, kind):
    """Add uniform noise to a reading of all robots, and limit it to 0..1."""
    most = world.constants[kind]
    readings = world.robots[row]
    for at in range(0, readings.shape[0], LANES):
        value = load(readings, at) + most * (2.0 * load(world.noise[noise], at) - 1.0)
        value = select(value > 0.0, value, 0.0)
        store(readings, at, select(value < 1.0, value, 1.0))


@inline(counts=False, inner=True)
def see_lamp(world, robot):
    """Write the brightness of the lamp, and its bearing."""
    robots = world.robots
    lamp = world.constants
    dx = lamp[LAMP_X] - robots[X, robot]
    dy = lamp[LAMP_Y] - robots[Y, robot]
    square = dx * dx + dy * dy
    robots[BRIGHTNESS, robot] = 0.0
    robots[BEARING, robot] = 0.0
    if not dimmed(world, robot, dx, dy, sqrt(square)):
        distance = sqrt(square + lamp[LAMP_Z] * lamp[LAMP_Z]) / lamp[INTENSITY]
        if distance <= FARTHEST:
            robots[BRIGHTNESS, robot] = exp(-DECAY * distance)
        robots[BEARING, robot] = atan2(dy, dx) - robots[ANGLE, robot]


@inline(counts=False, inner=True)
def light(world, sensor):
    """Write the light reading of a sensor of all robots."""
    robots = world.robots
    for at in range(0, robots.shape[1], LANES):
        off = (load(robots[BEARING], at) - ANGLES[sensor]) / (2.0 * PI)
        off = off - floor(off + 0.5)
        off = select(off < 0.0, 0.0 - off, off) * (2.0 * PI)
        value = load(robots[BRIGHTNESS], at) * (1.0 - 2.0 * off / PI)
        store(robots[LIGHT + sensor], at, select(off < 0.5 * PI, value, 0.0))


@inline(counts=False, inner=True)
def dimmed(world, robot, dx, dy, distance):
    """Return whether a robot or an inner wall hides the lamp from a robot's place on the floor."""
    robots = world.robots
    x = robots[X, robot]
    y = robots[Y, robot]
    # Where the ray is as high as a robot; it is higher from there on.
    farthest = distance * ROBOT_HEIGHT / world.constants[LAMP_Z]
    reach = farthest + RADIUS
    for at in range(0, robots.shape[1], LANES):
        other_x = load(robots[X], at) - x
        other_y = load(robots[Y], at) - y
        near = other_x * other_x + other_y * other_y <= reach * reach
        near = near & (load(world.places, at) != float(robot))
        if any_of(near):
            along = (other_x * dx + other_y * dy) / distance
            across = (other_y * dx - other_x * dy) / distance
            chord = RADIUS * RADIUS - across * across
            near = near & (chord > 0.0)
            crossing = along - sqrt(select(near, chord, 0.0))
            if any_of(near & (crossing >= 0.0) & (crossing <= farthest)):
                return True
    # Where the ray is as high as a wall; the lamp may be outside of the outer walls.
    low = WALL_Z / world.constants[LAMP_Z]
    for wall in range(
        first_near(world, x + low * dx, y + low * dy, 0.0), len(world.walls)
    ):
        part = to_box(world.walls[wall], x, y, dx, dy)
        if part * world.constants[LAMP_Z] <= world.walls[wall][WALL_HEIGHT]:
            return True
    return False


@inline(counts=False, inner=True)
def see_floor(world, sensor):
    """Write a ground reading of all robots: right, centre or left."""
    robots = world.robots
    aside = GROUND_ASIDE * (sensor - 1)
    for at in range(0, robots.shape[1], LANES):
        cosine = load(robots[COSINE], at)
        sine = load(robots[SINE], at)
        x = load(robots[X], at) + GROUND_AHEAD * cosine - aside * sine
        y = load(robots[Y], at) + GROUND_AHEAD * sine + aside * cosine
        store(robots[GROUND + sensor], at, grey_at(world.floor, x, y))


@inline(counts=False, inner=True)
def grey_at(floor, x, y):
    """Return the grey of the floor at lanes of points, from 0, black, to 1, white."""
    grey = fill(MIDDLE_GREY)
    for place in range(floor.shape[0] - 1, -1, -1):
        grey = select(contains(floor[place], x, y), floor[place, GREY], grey)
    return grey


@inline(counts=False, inner=True)
def contains(place, x, y):
    """Return whether a disc or rectangle of the floor contains lanes of points."""
    dx = x - place[PLACE_X]
    dy = y - place[PLACE_Y]
    if place[SHAPE] == DISC:
        return dx * dx + dy * dy <= place[SIZE_X] * place[SIZE_X]
    wide = (dx < place[SIZE_X]) & (dx > -place[SIZE_X])
    return wide & (dy < place[SIZE_Y]) & (dy > -place[SIZE_Y])
