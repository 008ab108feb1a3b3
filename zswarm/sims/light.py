"""A robot seeks a light, exactly as FREVO's ``Light``.

FREVO is at github.com/smartgrids-aau/Frevo; this is its version 1.5.

Every constant and every order of operations is FREVO's, with its default fitness. Sine, cosine and
arc tangent are ours and may differ in the last bits. FREVO's two other fitness functions, which
count the cells that the robot crossed, are not offered.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, within
from zswarm.kernels.jit import inline
from zswarm.kernels.portable import PI, atan2, cos, exp, remainder, sin
from zswarm.kernels.random import draw_java, skip_java, start_java
from zswarm.sims.simulator import Body, Frame, Ray, Rectangle
from zswarm.sims.trial import OneAgent, problem, world

SIDE, DIAMETER, WHEEL = 200.0, 10.0, 5.0  # of the room, the robot, its wheels
FASTEST = 12.0  # rad/s, of a wheel
STEP_S = 0.1
SIGHT, FIELD_OF_VIEW = 70.0, 45.0  # of a sensor: reach, and degrees
# A light is placed on a circle of this radius, with up to 24 added in x and in y.
NEAREST_LIGHT, SPREAD = 80.0, 25
TOUCH = DIAMETER / 2.0 + 1.0
RADIANS, DEGREES = PI / 180.0, 180.0 / PI
E = 2.718281828459045

X, Y, HEADING, LIGHT_X, LIGHT_Y = range(5)  # ``state``; HEADING: degrees, 0 up, clockwise
DECISIONS, FOUND = range(2)  # ``counts``
STEPS, SEED, HEADING_SEED = range(3)  # ``rules``

JavaSeed = Annotated[int, Meta(ge=0, lt=2**48)]


class LightSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    steps: Annotated[int, within(1, 1_000_000, "steps of a trial, of .1 s")] = 300
    seed: Annotated[
        JavaSeed, about("seed of the first light; trials have `seed`, `seed` + 1, ...")
    ] = 1234
    heading_seed: Annotated[
        JavaSeed,
        about("seed of the generator of the robot's first headings"),
    ] = 1


class Light(OneAgent):
    """A robot on two wheels finds a light, which its two sensors see up to 70 away, and touches it.

    The room is 200 wide, x to the right and y downwards from its middle; headings are degrees, 0
    up, clockwise. The robot is a disc with a diameter of 10 and wheels of 5, which turn at -12 to
    12 rad/s. A sensor is on the left edge of the robot and one on the right edge; both look ahead,
    and angle and distance of a light are measured from them.

    Observation: (2,) float32, left and right: 1 - distance / 70 for a light less than 22.5 degrees
        off the heading and up to 70 away; else 1, as if it were touched: FREVO reads no light in
        view as distance 0.
    Action: (2,) float32 for the left and right wheel: 0 full speed back, 0.5 stop, 1 full speed
    ahead; not limited.
    Turns: the robot. In a step of t = 0.1 s, with wheels at l and r, the heading grows by
        degrees((l - r) t / 2); then the robot moves by 1.25 (l + r) t in that direction, unless it
        would be outside the room.
    Start: the robot in the middle. The light comes from Java's Random(trial's seed): angle =
        nextInt(360) degrees, then x = (80 + nextInt(25)) cos, y = (80 + nextInt(25)) sin; a few
        lights are so far behind a wall that they cannot be touched. The heading is nextInt(360) of
        the word of Random(``heading_seed``) with index trial's seed - ``seed``.
    End: after ``steps`` + 1 steps (the first does not count), or when the centres of robot and
    light are up to 6 apart.
    Fitness: (0.3 if the light was touched) + 0.4 e^(unused / steps - 1) + 0.3 e^(-d / 70), the last
        part 0 for d above 70, where unused counts the steps not needed and d is the distance at the
        end. 0.147 for a robot that does nothing, always below 1.
    Metrics: ``found``: 1 or 0; ``steps`` before the one in which it was found, or ``steps``;
        ``distance`` to the light, ``x`` and ``y`` of the robot at the end.
    Trial seeds: ``seed``, ``seed`` + 1, ... of the settings, as in FREVO.
    """

    settings_type = LightSettings
    metrics = ("found", "steps", "distance", "x", "y")
    sensors, actuators = ("light_left", "light_right"), ("left", "right")
    inputs, outputs = len(sensors), len(actuators)
    settings: LightSettings

    def __init__(self, settings: LightSettings) -> None:
        super().__init__(settings)
        rules = [settings.steps, settings.seed, settings.heading_seed]
        self.world = world(rules=rules, state=5, counts=2)

    def fixed_seeds(self, trials: int) -> Sequence[int]:
        """Return consecutive seeds from the settings' ``seed`` on."""
        return range(self.settings.seed, self.settings.seed + trials)

    def frame(self) -> Frame:
        """Draw the room with a rim, in which lights can be, too."""
        rim = 10.0
        middle = SIDE / 2 + rim
        whole = SIDE + 2 * rim
        x, y, heading, light_x, light_y = self.world.state.tolist()
        places = [
            Rectangle("wall", rim - 1, rim - 1, SIDE + 2, 1.0),
            Rectangle("wall", rim - 1, rim + SIDE, SIDE + 2, 1.0),
            Rectangle("wall", rim - 1, rim, 1.0, SIDE),
            Rectangle("wall", rim + SIDE, rim, 1.0, SIDE),
            Rectangle("light", middle + light_x - 2.5, middle + light_y - 2.5, 5.0, 5.0),
        ]
        kind = "robot at the light" if self.world.counts[FOUND] else "robot"
        robot = Body(
            kind, middle + x, middle + y, DIAMETER / 2, (heading - 90.0) * RADIANS
        )
        rays = [
            Ray(sensor, 0.0, SIGHT, 0.0, FIELD_OF_VIEW * RADIANS, aside)
            for sensor, aside in enumerate((-DIAMETER / 2, DIAMETER / 2))
        ]
        return Frame(whole, whole, places, [robot], rays=rays)


@inline(counts=False)
def start(world, seed):
    """Draw the robot's heading, and the light of a seed."""
    state = world.state
    stream = world.stream
    start_java(stream, np.uint64(world.rules[HEADING_SEED]))
    skip_java(stream, seed - np.uint64(world.rules[SEED]))
    state[X] = 0.0
    state[Y] = 0.0
    state[HEADING] = np.float64(draw_java(stream, 360))
    start_java(stream, seed)
    angle = np.float64(draw_java(stream, 360)) * RADIANS
    state[LIGHT_X] = (NEAREST_LIGHT + np.float64(draw_java(stream, SPREAD))) * cos(angle)
    state[LIGHT_Y] = (NEAREST_LIGHT + np.float64(draw_java(stream, SPREAD))) * sin(angle)
    world.counts[:] = 0


@inline(counts=False)
def observe(world, observation):
    """Write what the sensors read; without a light in view that is 1."""
    heading = clockwise(world.state[HEADING])
    observation[0] = np.float32(
        1.0 - visible_distance(world.state, heading, -90.0) / SIGHT
    )
    observation[1] = np.float32(
        1.0 - visible_distance(world.state, heading, 90.0) / SIGHT
    )


@inline(counts=False)
def clockwise(angle):
    """Reduce an angle in degrees to 0..360."""
    rest = remainder(angle, 360.0)
    return rest if angle >= 0.0 else 360.0 + rest


@inline(counts=False)
def visible_distance(state, heading, aside):
    """Return the distance of the light from the sensor at an angle, or 0 if it is not in view."""
    towards = (heading + aside) * RADIANS
    dx = state[LIGHT_X] - (state[X] + sin(towards) * (DIAMETER / 2.0))
    dy = state[LIGHT_Y] - (state[Y] - cos(towards) * (DIAMETER / 2.0))
    distance = np.sqrt(dx * dx + dy * dy)
    angle = clockwise(atan2(dx, -dy) * DEGREES)
    off = remainder(heading, 360.0) - remainder(angle, 360.0)
    if off > 180.0:
        off -= 360.0
    if off < -180.0:
        off += 360.0
    return distance if abs(off) < FIELD_OF_VIEW / 2.0 and distance <= SIGHT else 0.0


@inline(counts=False)
def act(world, action):
    """Turn, then drive."""
    state = world.state
    counts = world.counts
    left = np.float64(action[0]) * 2.0 * FASTEST - FASTEST
    right = np.float64(action[1]) * 2.0 * FASTEST - FASTEST
    turning = WHEEL / 2.0 / DIAMETER * (left - right) * 2.0
    state[HEADING] += turning * STEP_S * DEGREES
    towards = state[HEADING] * RADIANS
    speed = WHEEL / 4.0 * (left + right)
    x = state[X] + speed * sin(towards) * STEP_S
    y = state[Y] - speed * cos(towards) * STEP_S
    most = SIDE / 2.0 - DIAMETER / 2.0
    if not (abs(x) > most or abs(y) > most):
        state[X] = x
        state[Y] = y
    counts[DECISIONS] += 1
    if light_distance(state) <= TOUCH:
        counts[FOUND] = 1


@inline(counts=False)
def light_distance(state):
    """Return the distance from the robot to the light."""
    dx = state[LIGHT_X] - state[X]
    dy = state[LIGHT_Y] - state[Y]
    return np.sqrt(dx * dx + dy * dy)


@inline(counts=False)
def is_over(world):
    """Return whether the trial ends; the first step does not count and ends nothing."""
    decisions = world.counts[DECISIONS]
    return decisions > world.rules[STEPS] or (world.counts[FOUND] != 0 and decisions >= 2)


@inline(counts=False)
def judge(world, fitness, metrics):
    """Write fitness and metrics of a trial that ended."""
    state = world.state
    found = world.counts[FOUND]
    steps = world.rules[STEPS]
    needed = world.counts[DECISIONS] - 2 if found else steps  # FREVO counts from 0
    distance = light_distance(state)
    near = exp((SIGHT - distance) / SIGHT) / E if not distance > SIGHT else 0.0
    fast = exp((steps - needed) / np.float64(steps)) / E
    fitness[0] = (0.3 if found else 0.0) + 0.4 * fast + 0.3 * near
    metrics[0] = found
    metrics[1] = needed
    metrics[2] = distance
    metrics[3] = state[X]
    metrics[4] = state[Y]


Light.problem = problem("play_light", start, observe, act, is_over, judge)
