"""Messages as bodies of frames, and back; floats keep every bit."""

import struct
from typing import Any

import numpy as np

from zswarm.robots.profiles.profile import SHARED, Channel, Profile
from zswarm.ros.link.bridges import frames
from zswarm.ros.link.messages import Clock, Message, Odometry, ResetWorld, Scan, Velocity

LITTLE = np.dtype("<f4")
POSE = ("stamp_ns", "x", "y", "z", "w", "linear", "angular")
ANGLES = ("angle_min", "angle_max", "angle_increment")
# Per channel the type of its messages, the layout of a body, and the field of each of its numbers.
LAYOUTS: dict[Channel, tuple[type[Message], struct.Struct, tuple[str, ...]]] = {
    "scan": (Scan, frames.SCAN, ("stamp_ns", *ANGLES, "range_min", "range_max")),
    "odometry": (Odometry, frames.ODOMETRY, POSE),
    "ground_truth": (Odometry, frames.ODOMETRY, POSE),
    "velocity": (Velocity, frames.VELOCITY, ("stamp_ns", "linear", "angular")),
    "clock": (Clock, frames.CLOCK, ("stamp_ns",)),
    "reset": (ResetWorld, frames.RESET, ("seed",)),
}


def topic(message: Message) -> tuple[Channel, int]:
    """Return channel and robot of a message."""
    match message:
        case Scan():
            return "scan", message.robot
        case Odometry():
            return "ground_truth" if message.truth else "odometry", message.robot
        case Velocity():
            return "velocity", message.robot
        case Clock():
            return "clock", 0
        case ResetWorld():
            return "reset", 0


def ros_type(profile: Profile, channel: Channel) -> str:
    """Return the ROS type of a channel's messages."""
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
    """Return the body of a message."""
    channel, _ = topic(message)
    _, layout, names = LAYOUTS[channel]
    body = layout.pack(*[getattr(message, name) for name in names])
    if isinstance(message, Scan):
        body += message.ranges.astype(LITTLE, copy=False).tobytes()
    return body


def decode(channel: Channel, robot: int, body: bytes) -> Message:
    """Return a message of a channel."""
    kind, layout, names = LAYOUTS[channel]
    fields: dict[str, Any] = dict(zip(names, layout.unpack_from(body), strict=True))
    if channel not in SHARED:
        fields["robot"] = robot
    if channel == "ground_truth":
        fields["truth"] = True
    if channel == "reset" and len(body) > layout.size:
        (fields["stamp_ns"],) = frames.CLOCK.unpack_from(body, layout.size)
    if channel == "scan":
        fields["ranges"] = np.frombuffer(body, LITTLE, offset=layout.size).astype(
            np.float32
        )
    return kind(**fields)
