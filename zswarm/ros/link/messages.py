"""Messages between robots and a simulation, as structs; ``link`` carries them.

Floats keep their bits on the way. Stamps are nanoseconds of the simulation's clock, or a robot's.
"""

import msgspec
import numpy as np


class Scan(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """A laser scan: sensor_msgs/LaserScan.

    Angles are of the first and the last ray, radians, counter-clockwise from straight ahead;
    lengths are metres. Drivers differ in what they write where nothing was hit: see
    sims/robot_interface.py.
    """

    robot: int
    stamp_ns: int
    ranges: np.ndarray  # (rays,) float32
    angle_min: float
    angle_max: float
    angle_increment: float
    range_min: float
    range_max: float


class Odometry(msgspec.Struct, frozen=True, kw_only=True):
    """The pose and speed of a robot: nav_msgs/Odometry.

    ``x`` and ``y`` are metres, ``z`` and ``w`` of the heading's quaternion (sine and cosine of half
    the angle), speeds m/s ahead and rad/s to the left.
    """

    robot: int
    stamp_ns: int
    x: float
    y: float
    z: float
    w: float
    linear: float = 0.0
    angular: float = 0.0
    truth: bool = False  # from the simulation (ground truth), not from wheels


class Velocity(msgspec.Struct, frozen=True, kw_only=True):
    """A command to a robot: geometry_msgs/Twist, or TwistStamped if the profile has that.

    A Twist has no stamp: ``stamp_ns`` arrives as 0.
    """

    robot: int
    stamp_ns: int
    linear: float  # m/s ahead
    angular: float  # rad/s to the left


class Clock(msgspec.Struct, frozen=True, kw_only=True):
    """The simulation's time: rosgraph_msgs/Clock."""

    stamp_ns: int


class ResetWorld(msgspec.Struct, frozen=True, kw_only=True):
    """Begin a trial: std_msgs/UInt64, or a service without arguments (Stage's reset_positions)."""

    seed: int = 0  # of the trial, below 2^64; a service has none
    # Of a service that returned, if asked for: later than all that it changed.
    stamp_ns: int = 0


Message = Scan | Odometry | Velocity | Clock | ResetWorld
