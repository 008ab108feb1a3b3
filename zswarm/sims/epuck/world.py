"""Define the state of a trial with e-puck robots, and the constants of the robot.

Lengths are in m, angles in radians, counterclockwise, and all numbers are float64. Constants that
the reference model stores as C floats have the value of the float.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from zswarm.kernels.jit import interpreted
from zswarm.kernels.portable import cos, sin
from zswarm.kernels.signatures import (
    Float64Rows,
    Float64s,
    Int32Rows,
    Int64Rows,
    Int64s,
    UInt64s,
)

STEP_S = 0.1  # a controller decides once in each
RADIUS = float(np.float32(0.035))
MASS = float(np.float32(0.4))  # kg
WHEEL_DISTANCE = float(np.float32(0.053))
ROBOT_HEIGHT = 0.076

# ``robots``: a row for each; velocities in m/s and rad/s.
X, Y, ANGLE, COSINE, SINE, SPEED_X, SPEED_Y, SPIN = range(8)
# The target velocity of this step, and the impulses of the motors in the last substep.
TARGET_X, TARGET_Y, TARGET_SPIN, PUSH_X, PUSH_Y, PUSH_SPIN = range(8, 14)
LEFT, RIGHT = range(14, 16)  # commands for the next step, m/s
PROXIMITY, LIGHT, GROUND = (
    16,
    24,
    32,
)  # 8, 8 and 3 readings: right, centre and left of the floor
HEARD, HEARD_X, HEARD_Y = range(
    35, 38
)  # messages of this step, and the sum of their vectors
CARRIES, TOUCHES = range(38, 40)
BRIGHTNESS, BEARING = range(40, 42)  # of the lamp
ROBOT_ROWS = 42
FAR_AWAY = 1e6  # m, where spare lanes are
NOISY = 19  # readings of a robot with noise: proximity, light, ground

# ``walls``: boxes, a row for each.
CENTRE_X, CENTRE_Y, WALL_COSINE, WALL_SINE, HALF_LENGTH, HALF_WIDTH, WALL_HEIGHT = range(
    7
)
WALL_COLUMNS = 7

# ``floor``: discs and rectangles, a row for each; the first that contains a point gives its grey.
SHAPE, PLACE_X, PLACE_Y, SIZE_X, SIZE_Y, GREY = range(6)
DISC, RECTANGLE = range(2)
BLACK, WHITE = 0.0, 1.0
MIDDLE_GREY = 127 / 255

# ``constants``: of noise; place and intensity of the lamp.
WHEEL_NOISE, PROXIMITY_NOISE, LIGHT_NOISE, GROUND_NOISE, LOSS = range(5)
LAMP_X, LAMP_Y, LAMP_Z, INTENSITY = range(5, 9)

# ``counts``: of the trial.
STEP_NUMBER, SUBSTEP = range(2)
COUNTS = 2

# ``meetings``: the robots of pairs that may sense each other's bodies, and of pairs in range; of
# these, the indices of those in which at least one message is not lost.
NEAR, BESIDE, AUDIBLE, SENDER, RECEIVED, MEETING_ROWS = range(6)

# ``memory``: sums of the vectors of messages by step, then black and white readings.
MEMORY = 11  # steps for which a robot remembers messages
VOTES = 5  # steps for which it remembers the floor
FIRST_VOTE, MEMORY_ROWS = 2 * MEMORY, 2 * (MEMORY + VOTES)

# ``impulses``: of a pair, along and across the normal, and the last substep in which it touched.
ALONG, ACROSS, TOUCHED, IMPULSE_COLUMNS = range(4)

# ``lists``: robots that touch something, and those that still change; for each robot the one that
# stands for its group, the level of its next contact, and the number of its group; for each contact
# its level, and its place by levels; where levels start.
TOUCHING, ACTIVE, LEADER, LEVEL, GROUPS, LEVELS, ORDER, LEVEL_STARTS, LISTS = range(9)

# ``changes``: the largest of the impulses of a group, in the last iteration and so far in this.
BEFORE, NOW, CHANGE_ROWS = range(3)


class EpuckWorld(NamedTuple):
    """The settings of a problem, and the state of a trial."""

    mission: int
    steps: int
    number: int  # of robots
    model: int  # reference model: 1 for 1.1, 2 for 1.2, 3 for that of machines
    outer_walls: (
        int  # the first of ``walls``, which hide nothing because the arena is convex
    )
    free: float  # m, the radius of the disc around the middle without outer walls
    hearing: float  # m, the range of messages
    around: float  # m, the radius of the disc in which robots start
    start: int  # the way in which they start, see ``arenas``
    sector_from: float  # the angles between which they start
    sector_to: float
    spots: int  # the first discs of ``floor`` that are homes or nests
    at_end: int  # 1 if only the last step counts
    constants: Float64s
    walls: Float64Rows
    floor: Float64Rows
    greys: Float64Rows  # (3, quantiles) recorded readings of a grey floor
    places: Float64s  # the numbers 0, 1, 2 and so on, for each robot and spare lane
    robots: Float64Rows  # (ROBOT_ROWS, robots and spare lanes, which are far away)
    meetings: Int32Rows  # (MEETING_ROWS, pairs of robots, and spare lanes)
    chances: Float64Rows  # (2, pairs of robots), random numbers of messages
    rays: Float64s  # proximity readings, robot after robot; 0 between steps
    memory: Float64Rows  # (MEMORY_ROWS, robots and spare lanes)
    noise: Float64Rows  # (NOISY, robots and spare lanes), random numbers of this step
    seen: Float64Rows  # (sensors, robots and spare lanes), what controllers see
    pairs: Int64Rows  # robot, and robot or wall, that may touch in this step
    contacts: Float64Rows  # that touch in this substep, see ``contacts``
    links: Int64Rows  # the robots and groups of these contacts
    bodies: Float64Rows  # the robots that touch something, see ``impulses``
    impulses: Float64Rows  # (pairs, IMPULSE_COLUMNS)
    lists: Int64Rows  # (LISTS, pairs)
    changes: Float64Rows  # (CHANGE_ROWS, robots)
    tally: Float64s  # the score; the counters of grid exploration
    counts: Int64s
    stream: UInt64s


def unit_vectors(angles: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the cosines and the sines of angles, without loading the compiler."""
    with interpreted():
        return np.array([cos(one) for one in angles]), np.array(
            [sin(one) for one in angles]
        )
