"""Messages to bodies of frames and back; every bit of their floats is kept."""

import numpy as np

from zswarm.ros.bridges import frames
from zswarm.ros.messages import Clock, Message, Odometry, Reset, Scan, Velocity
from zswarm.ros.profiles import Channel, Profile

LITTLE = np.dtype("<f4")


def topic(message: Message) -> tuple[Channel, int]:
    """Channel and robot of a message."""
    match message:
        case Scan():
            return "scan", message.robot
        case Odometry():
            return "ground_truth" if message.truth else "odometry", message.robot
        case Velocity():
            return "velocity", message.robot
        case Clock():
            return "clock", 0
        case Reset():
            return "reset", 0


def ros_type(profile: Profile, channel: Channel) -> str:
    """The type of a channel's messages in ROS."""
    match channel:
        case "velocity":
            return frames.TWIST_STAMPED if profile.velocity.stamped else frames.TWIST
        case "scan":
            return frames.LASER_SCAN
        case "odometry" | "ground_truth":
            return frames.ODOMETRIES
        case "clock":
            return frames.CLOCKS
        case "reset":
            return frames.EMPTY if profile.reset.service else frames.SEED


def encode(message: Message) -> bytes:
    """The body of a message.

    Raises:
        struct.error: a number is too large for its field.
    """
    match message:
        case Scan():
            head = frames.SCAN.pack(
                message.stamp_ns, message.angle_min, message.angle_max, message.angle_increment, message.range_min,
                message.range_max,
            )  # fmt: skip
            return head + message.ranges.astype(LITTLE, copy=False).tobytes()
        case Odometry():
            return frames.ODOMETRY.pack(
                message.stamp_ns, message.x, message.y, message.z, message.w, message.linear, message.angular
            )  # fmt: skip
        case Velocity():
            return frames.VELOCITY.pack(message.stamp_ns, message.linear, message.angular)
        case Clock():
            return frames.CLOCK.pack(message.stamp_ns)
        case Reset():
            return frames.RESET.pack(message.seed)


def decode(channel: Channel, robot: int, body: bytes) -> Message:
    """A message of a channel."""
    match channel:
        case "scan":
            stamp_ns, first, last, between, shortest, longest = frames.SCAN.unpack_from(body)
            return Scan(
                robot=robot, stamp_ns=stamp_ns, ranges=_ranges(body), angle_min=first,
                angle_max=last, angle_increment=between, range_min=shortest, range_max=longest,
            )  # fmt: skip
        case "odometry" | "ground_truth":
            stamp_ns, x, y, z, w, linear, angular = frames.ODOMETRY.unpack(body)
            return Odometry(
                robot=robot, stamp_ns=stamp_ns, x=x, y=y, z=z, w=w, linear=linear, angular=angular,
                truth=channel == "ground_truth",
            )  # fmt: skip
        case "velocity":
            stamp_ns, linear, angular = frames.VELOCITY.unpack(body)
            return Velocity(robot=robot, stamp_ns=stamp_ns, linear=linear, angular=angular)
        case "clock":
            return Clock(stamp_ns=frames.CLOCK.unpack(body)[0])
        case "reset":
            return Reset(seed=frames.RESET.unpack(body)[0])


def _ranges(body: bytes) -> np.ndarray:
    """(rays,) float32 of a scan's body, to be written to."""
    return np.frombuffer(body, LITTLE, offset=frames.SCAN.size).astype(np.float32)
