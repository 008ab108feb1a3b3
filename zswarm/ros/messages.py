"""What robots and a simulation say to each other, as structs; ``link`` carries them.

Floats keep their bits on the way. Stamps are nanoseconds of the simulation's clock (of a robot: of its own).
"""

import msgspec
import numpy as np


class Scan(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """What a laser scanner saw: sensor_msgs/LaserScan.

    The angles are of the first and the last ray, radians, counter-clockwise from straight ahead; lengths are metres.
    """

    robot: int
    stamp_ns: int
    ranges: np.ndarray  # (rays,) float32; where nothing was hit drivers put different things: sims/robot_interface.py
    angle_min: float
    angle_max: float
    angle_increment: float
    range_min: float
    range_max: float


class Odometry(msgspec.Struct, frozen=True, kw_only=True):
    """Where a robot is: nav_msgs/Odometry.

    ``x`` and ``y`` are metres, ``z`` and ``w`` of the heading's quaternion (sine and cosine of half the angle), speeds m/s ahead
    and rad/s to the left.
    """

    robot: int
    stamp_ns: int
    x: float
    y: float
    z: float
    w: float
    linear: float = 0.0
    angular: float = 0.0
    truth: bool = False  # from the simulation itself (ground truth), not from wheels


class Velocity(msgspec.Struct, frozen=True, kw_only=True):
    """How a robot is to drive: geometry_msgs/Twist, or TwistStamped where the profile says so.

    ``stamp_ns`` is lost in a Twist: it comes as 0.
    """

    robot: int
    stamp_ns: int
    linear: float  # m/s ahead
    angular: float  # rad/s to the left


class Clock(msgspec.Struct, frozen=True, kw_only=True):
    """The simulation's time: rosgraph_msgs/Clock."""

    stamp_ns: int


class Reset(msgspec.Struct, frozen=True, kw_only=True):
    """Begin a trial: std_msgs/UInt64 on ``/zswarm/reset``, or a service without arguments (Stage's reset_positions): 0 then."""

    seed: int = 0  # of the trial, below 2^64


Message = Scan | Odometry | Velocity | Clock | Reset
