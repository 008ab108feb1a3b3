"""Bodies of frames as ROS messages, and back; rospy, rclpy and rosbags have the same fields."""

from __future__ import annotations

import array
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import frames

SECOND = 1_000_000_000  # ns
ZERO = ""  # in place of a field that a type lacks
HEADER = "header.stamp"
STAMPS = (HEADER, "clock")
# Per type, the layout of a body and the field of each of its numbers.
FIELDS = {
    frames.LASER_SCAN: (
        frames.SCAN,  # the ranges follow
        (HEADER, "angle_min", "angle_max", "angle_increment", "range_min", "range_max"),
    ),
    frames.ODOMETRIES: (
        frames.ODOMETRY,
        (
            HEADER,
            "pose.pose.position.x",
            "pose.pose.position.y",
            "pose.pose.orientation.z",
            "pose.pose.orientation.w",
            "twist.twist.linear.x",
            "twist.twist.angular.z",
        ),
    ),
    frames.TWIST: (frames.VELOCITY, (ZERO, "linear.x", "angular.z")),
    frames.TWIST_STAMPED: (
        frames.VELOCITY,
        (HEADER, "twist.linear.x", "twist.angular.z"),
    ),
    frames.CLOCKS: (frames.CLOCK, ("clock",)),
    frames.SEED: (frames.RESET, ("data",)),
}


class Conversion:
    """To messages of one library, and from them."""

    def __init__(
        self,
        new: Callable[[str], Any],
        stamp: tuple[str, str] = ("sec", "nanosec"),
        floats: Callable[[bytes], Any] = lambda raw: array.array("f", raw),
    ) -> None:
        """Take what differs between libraries.

        Args:
            new: returns an empty message of a type, such as ``nav_msgs/Odometry``.
            stamp: names of seconds and nanoseconds in a stamp.
            floats: returns a list of float32, from their bytes.
        """
        self._new, self._stamp, self._floats = new, stamp, floats

    def body(self, kind: str) -> Callable[[Any], bytes]:
        """Return a function from messages of a type to bodies."""
        layout, fields = FIELDS[kind]
        readers = [self._reader(field) for field in fields]

        def convert(message: Any) -> bytes:
            body: bytes = layout.pack(*[read(message) for read in readers])
            if kind == frames.LASER_SCAN:
                body += array.array("f", message.ranges).tobytes()
            return body

        return convert

    def message(self, topic: dict[str, Any]) -> Callable[[bytes], Any]:
        """Return a function from bodies to messages of a topic."""
        kind = topic["type"]
        layout, fields = FIELDS[kind]
        writers = [self._writer(field) for field in fields]

        def convert(body: bytes) -> Any:
            message = self._new(kind)
            for write, number in zip(writers, layout.unpack_from(body)):  # noqa: B905  Python 3.8
                write(message, number)
            if HEADER in fields:
                message.header.frame_id = topic["frame"]
            if kind == frames.ODOMETRIES:
                message.child_frame_id = topic["child_frame"]
            if kind == frames.LASER_SCAN:
                message.ranges = self._floats(body[layout.size :])
            return message

        return convert

    def _reader(self, field: str) -> Callable[[Any], Any]:
        """Return a function that reads a field of a message."""
        if field == ZERO:
            return lambda _: 0
        if field not in STAMPS:
            return attrgetter(field)
        parts = attrgetter(*[f"{field}.{part}" for part in self._stamp])

        def read(message: Any) -> int:
            seconds, nanoseconds = parts(message)
            return int(seconds * SECOND + nanoseconds)

        return read

    def _writer(self, field: str) -> Callable[[Any, Any], None]:
        """Return a function that sets a field of a message."""
        if field == ZERO:
            return lambda *_: None
        parent, _, name = field.rpartition(".")
        owner: Callable[[Any], Any] = (
            attrgetter(parent) if parent else lambda message: message
        )
        if field not in STAMPS:
            return lambda message, number: setattr(owner(message), name, number)
        seconds, nanoseconds = self._stamp

        def write(message: Any, number: int) -> None:
            stamp = getattr(owner(message), name)
            setattr(stamp, seconds, number // SECOND)
            setattr(stamp, nanoseconds, number % SECOND)

        return write
