"""Bodies of frames to messages of ROS and back, for all bridges: messages have the same fields in rospy, rclpy and rosbags."""

from __future__ import annotations

import array
from collections.abc import Callable
from typing import Any

import frames

SECOND = 1_000_000_000  # ns


class Conversion:
    """To messages of one library, and from them."""

    def __init__(
        self,
        new: Callable[[str], Any],
        stamp: tuple[str, str] = ("sec", "nanosec"),
        floats: Callable[[bytes], Any] = lambda raw: array.array("f", raw),
    ) -> None:
        """Args are what differs.

        Args:
            new: an empty message of a type, such as ``nav_msgs/Odometry``.
            stamp: names of seconds and nanoseconds in a stamp.
            floats: a list of float32, from their bytes.
        """
        self._new, self._stamp, self._floats = new, stamp, floats
        self._bodies = {
            frames.LASER_SCAN: self._from_scan,
            frames.ODOMETRIES: self._from_odometry,
            frames.TWIST: lambda message: frames.VELOCITY.pack(0, message.linear.x, message.angular.z),
            frames.TWIST_STAMPED: self._from_twist_stamped,
            frames.CLOCKS: lambda message: frames.CLOCK.pack(self._nanoseconds(message.clock)),
            frames.SEED: lambda message: frames.RESET.pack(message.data),
        }
        self._messages = {
            frames.LASER_SCAN: self._to_scan,
            frames.ODOMETRIES: self._to_odometry,
            frames.TWIST: self._to_twist,
            frames.TWIST_STAMPED: self._to_twist_stamped,
            frames.CLOCKS: self._to_clock,
            frames.SEED: self._to_seed,
        }

    def body(self, kind: str) -> Callable[[Any], bytes]:
        """A function from messages of a type to bodies."""
        return self._bodies[kind]

    def message(self, topic: dict[str, Any]) -> Callable[[bytes], Any]:
        """A function from bodies to messages of a topic."""
        made = self._messages[topic["type"]]
        return lambda body: made(topic, body)

    def _nanoseconds(self, stamp: Any) -> int:
        seconds, nanoseconds = self._stamp
        return int(getattr(stamp, seconds) * SECOND + getattr(stamp, nanoseconds))

    def _set(self, stamp: Any, stamp_ns: int) -> None:
        for name, value in zip(self._stamp, divmod(stamp_ns, SECOND)):  # noqa: B905  Python 3.8 has no strict
            setattr(stamp, name, value)

    def _headed(self, topic: dict[str, Any], stamp_ns: int) -> Any:
        message = self._new(topic["type"])
        self._set(message.header.stamp, stamp_ns)
        message.header.frame_id = topic["frame"]
        return message

    def _from_scan(self, message: Any) -> bytes:
        head: bytes = frames.SCAN.pack(
            self._nanoseconds(message.header.stamp), message.angle_min, message.angle_max, message.angle_increment,
            message.range_min, message.range_max,
        )  # fmt: skip
        return head + array.array("f", message.ranges).tobytes()

    def _to_scan(self, topic: dict[str, Any], body: bytes) -> Any:
        stamp_ns, first, last, between, shortest, longest = frames.SCAN.unpack_from(body)
        message = self._headed(topic, stamp_ns)
        message.angle_min, message.angle_max, message.angle_increment = first, last, between
        message.range_min, message.range_max = shortest, longest
        message.ranges = self._floats(body[frames.SCAN.size :])
        return message

    def _from_odometry(self, message: Any) -> bytes:
        place, speed = message.pose.pose, message.twist.twist
        body: bytes = frames.ODOMETRY.pack(
            self._nanoseconds(message.header.stamp), place.position.x, place.position.y, place.orientation.z,
            place.orientation.w, speed.linear.x, speed.angular.z,
        )  # fmt: skip
        return body

    def _to_odometry(self, topic: dict[str, Any], body: bytes) -> Any:
        stamp_ns, x, y, z, w, linear, angular = frames.ODOMETRY.unpack(body)
        message = self._headed(topic, stamp_ns)
        message.child_frame_id = topic["child_frame"]
        place, speed = message.pose.pose, message.twist.twist
        place.position.x, place.position.y, place.orientation.z, place.orientation.w = x, y, z, w
        speed.linear.x, speed.angular.z = linear, angular
        return message

    def _to_twist(self, topic: dict[str, Any], body: bytes) -> Any:
        message = self._new(topic["type"])
        _, message.linear.x, message.angular.z = frames.VELOCITY.unpack(body)
        return message

    def _from_twist_stamped(self, message: Any) -> bytes:
        speed = message.twist
        body: bytes = frames.VELOCITY.pack(self._nanoseconds(message.header.stamp), speed.linear.x, speed.angular.z)
        return body

    def _to_twist_stamped(self, topic: dict[str, Any], body: bytes) -> Any:
        stamp_ns, linear, angular = frames.VELOCITY.unpack(body)
        message = self._headed(topic, stamp_ns)
        message.twist.linear.x, message.twist.angular.z = linear, angular
        return message

    def _to_clock(self, topic: dict[str, Any], body: bytes) -> Any:
        message = self._new(topic["type"])
        self._set(message.clock, frames.CLOCK.unpack(body)[0])
        return message

    def _to_seed(self, topic: dict[str, Any], body: bytes) -> Any:
        message = self._new(topic["type"])
        message.data = frames.RESET.unpack(body)[0]
        return message
