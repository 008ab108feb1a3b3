"""What a link and its bridge say to each other, on the bridge's standard input and output: frames.

Each frame is ``HEAD`` (length of the body, number of the topic) and a body by the topic's type, little-endian. The first frame to
a bridge is the set-up in JSON; the first from it says that it is there. Bridges run in other Pythons, where zswarm is not
installed: these files need the standard library of Python 3.8 alone.
"""

from __future__ import annotations

import json
import os
import select
import struct
import sys
import threading
from collections.abc import Callable
from typing import Any, NoReturn

HEAD = struct.Struct("<IH")
LARGEST = 1 << 24  # bytes of a body: more is none of ours
CONTROL = 0xFFFF  # no topic: to a bridge the set-up, then questions who is connected; from it b"" once, then the answers
COUNT = struct.Struct("<H")  # of an answer, per topic: how many are connected at the other end
CHUNK = 1 << 16
REFUSED = 2  # exit code: what was given or installed does not do; the last line of standard error says why
LETTING_GO_S = 2.0  # a bridge whose parent is gone ends by itself within that

# Bodies. Stamps are nanoseconds.
SCAN = struct.Struct("<q5f")  # stamp; angles of the first and last ray, between two; shortest, longest range; then float32 ranges
ODOMETRY = struct.Struct("<q6d")  # stamp, x, y, z and w of the quaternion, linear, angular
VELOCITY = struct.Struct("<q2d")  # stamp (0 in a Twist), linear, angular
CLOCK = struct.Struct("<q")
RESET = struct.Struct("<Q")  # seed

LASER_SCAN, ODOMETRIES, CLOCKS = "sensor_msgs/LaserScan", "nav_msgs/Odometry", "rosgraph_msgs/Clock"
TWIST, TWIST_STAMPED = "geometry_msgs/Twist", "geometry_msgs/TwistStamped"
SEED, EMPTY = "std_msgs/UInt64", "std_srvs/Empty"  # the second is a service


def frame(topic: int, body: bytes) -> bytes:
    """A frame."""
    return HEAD.pack(len(body), topic) + body


def taken(rest: bytearray) -> list[tuple[int, bytes]]:
    """Topics and bodies of the whole frames at the beginning of what was read; they are taken from it.

    Raises:
        ValueError: it is no frame.
    """
    found, at, head = [], 0, HEAD.size
    while len(rest) >= at + head:
        length, topic = HEAD.unpack_from(rest, at)
        if length > LARGEST:
            raise ValueError(f"a frame of {length} bytes")
        if len(rest) < at + head + length:
            break
        found.append((topic, bytes(rest[at + head : at + head + length])))
        at += head + length
    del rest[:at]
    return found


class Pipe:
    """A bridge's end. What is printed goes to standard error from now on."""

    def __init__(self) -> None:
        self._output = os.dup(1)
        os.dup2(2, 1)
        self._speaking = threading.Lock()
        self._rest = bytearray()
        threading.Thread(target=_end_with_parent, daemon=True).start()

    def set_up(self) -> dict[str, Any]:
        """The set-up: nothing else comes before the bridge says that it is there."""
        ((_, body),) = self._next()
        found: dict[str, Any] = json.loads(body)
        return found

    def publish(self, sending: dict[int, Callable[[bytes], object]], connected: list[Callable[[], int]]) -> None:
        """Say that the bridge is there; publish what comes, and answer who is connected, until the parent closes the pipe."""
        self.say(frame(CONTROL, b""))
        while came := self._next():
            for topic, body in came:
                if topic == CONTROL:
                    self.say(frame(topic, b"".join(COUNT.pack(count()) for count in connected)))
                else:
                    sending[topic](body)

    def say(self, frames: bytes) -> None:
        """Write frames; waits while the parent reads none."""
        with self._speaking:
            rest = memoryview(frames)
            while rest:
                try:
                    rest = rest[os.write(self._output, rest) :]
                except BrokenPipeError:
                    os._exit(0)  # the parent is gone

    def _next(self) -> list[tuple[int, bytes]]:
        """What comes next, at least one frame; none when the parent closed the pipe."""
        while not (found := taken(self._rest)):
            chunk = os.read(0, CHUNK)
            if not chunk:
                return []
            self._rest += chunk
        return found


def refuse(why: str) -> NoReturn:
    """End this bridge: what was given or installed does not do."""
    print(why, file=sys.stderr, flush=True)  # noqa: T201  the parent reads it
    os._exit(REFUSED)


def _end_with_parent() -> None:
    """End, at the latest a while after the parent closed the pipe or died: the thread that reads it may hang in ROS."""
    hung_up = select.poll()
    hung_up.register(0, 0)
    hung_up.poll()
    threading.Event().wait(LETTING_GO_S)
    os._exit(0)
