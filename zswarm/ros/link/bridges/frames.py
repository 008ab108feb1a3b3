"""Frames between a link and its bridge, on the bridge's standard input and output.

Each frame is ``HEAD`` (length of the body, number of the topic) and a body by the topic's type,
little-endian. The first frame to a bridge is its set-up as JSON; the first from it reports that it
is ready. Bridges run in other Pythons, where zswarm is not installed: these files need only the
standard library of Python 3.8.
"""

from __future__ import annotations

import importlib
import json
import os
import select
import struct
import sys
import threading
from collections.abc import Callable
from typing import Any, NoReturn

HEAD = struct.Struct("<IH")
MAX_BODY = 1 << 24  # bytes
# Not a topic. To a bridge: the set-up, then questions about connections. From it: answers.
CONTROL = 0xFFFF
# In an answer, per topic: how many are connected at the other end.
COUNT = struct.Struct("<H")
CHUNK = 1 << 16
REFUSED = 2  # exit code: the last line of standard error says what is wrong
LINGER_S = 2.0  # a bridge whose parent is gone ends within that

# Bodies. Stamps are nanoseconds.
# Stamp; angles of the first and last ray, between two; shortest, longest range; float32 ranges.
SCAN = struct.Struct("<q5f")
# Stamp, x, y, z and w of the quaternion, linear, angular.
ODOMETRY = struct.Struct("<q6d")
VELOCITY = struct.Struct("<q2d")  # stamp (0 in a Twist), linear, angular
CLOCK = struct.Struct("<q")
RESET = struct.Struct(
    "<Q"
)  # seed; a CLOCK may follow, where it reports that a service returned

LASER_SCAN, ODOMETRIES, CLOCKS = (
    "sensor_msgs/LaserScan",
    "nav_msgs/Odometry",
    "rosgraph_msgs/Clock",
)
TWIST, TWIST_STAMPED = "geometry_msgs/Twist", "geometry_msgs/TwistStamped"
SEED, EMPTY = "std_msgs/UInt64", "std_srvs/Empty"  # the second is a service


def frame(topic: int, body: bytes) -> bytes:
    """Return a frame."""
    return HEAD.pack(len(body), topic) + body


def take(data: bytearray) -> list[tuple[int, bytes]]:
    """Remove the whole frames at the beginning of data; return their topics and bodies."""
    found, at, head = [], 0, HEAD.size
    while len(data) >= at + head:
        length, topic = HEAD.unpack_from(data, at)
        if length > MAX_BODY:
            raise ValueError(f"a frame of {length} bytes")
        if len(data) < at + head + length:
            break
        found.append((topic, bytes(data[at + head : at + head + length])))
        at += head + length
    del data[:at]
    return found


class Pipe:
    """A bridge's end of the pipes. From now on, prints go to standard error."""

    def __init__(self) -> None:
        self._output = os.dup(1)
        os.dup2(2, 1)
        self._writing = threading.Lock()
        self._partial = bytearray()
        threading.Thread(target=_end_with_parent, daemon=True).start()

    def set_up(self) -> dict[str, Any]:
        """Return the set-up: nothing else arrives before the bridge is ready."""
        ((_, body),) = self._next()
        found: dict[str, Any] = json.loads(body)
        return found

    def publish(
        self,
        sending: dict[int, Callable[[bytes], object]],
        connected: list[Callable[[], int]],
    ) -> None:
        """Report that the bridge is ready; publish and answer until the parent closes the pipe."""
        self.write(frame(CONTROL, b""))
        while received := self._next():
            for topic, body in received:
                if topic == CONTROL:
                    counts = b"".join(COUNT.pack(count()) for count in connected)
                    self.write(frame(topic, counts))
                else:
                    sending[topic](body)

    def write(self, frames: bytes) -> None:
        """Write frames; wait while the parent reads none."""
        with self._writing:
            rest = memoryview(frames)
            while rest:
                try:
                    rest = rest[os.write(self._output, rest) :]
                except BrokenPipeError:
                    os._exit(0)  # the parent is gone

    def _next(self) -> list[tuple[int, bytes]]:
        """Return at least one frame; none when the parent closed the pipe."""
        while not (found := take(self._partial)):
            chunk = os.read(0, CHUNK)
            if not chunk:
                return []
            self._partial += chunk
        return found


def need(module: str, otherwise: str) -> Any:
    """Import a module that another Python may lack; refuse without it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        refuse(otherwise)


def refuse(why: str) -> NoReturn:
    """End this bridge, since it cannot do what it was set up for."""
    print(why, file=sys.stderr, flush=True)  # noqa: T201  the parent reads it
    os._exit(REFUSED)


def _end_with_parent() -> None:
    """End after the parent closed the pipe or died: the reading thread may hang in ROS."""
    hung_up = select.poll()
    hung_up.register(0, 0)
    hung_up.poll()
    threading.Event().wait(LINGER_S)
    os._exit(0)
