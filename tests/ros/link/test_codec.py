"""Messages keep every bit on their way through frames."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zswarm.robots.profiles import profile as profiles
from zswarm.ros.link import codec
from zswarm.ros.link.bridges import frames
from zswarm.ros.link.messages import Clock, Message, Odometry, ResetWorld, Scan, Velocity

STAMPS = st.integers(0, 2**62)
ROBOTS = st.integers(0, 200)
DOUBLES = st.floats()
SINGLES = st.floats(width=32, allow_nan=False)


def bits(number: float) -> bytes:
    return struct.pack("<d", number)


@given(
    STAMPS,
    ROBOTS,
    st.lists(st.integers(0, 2**32 - 1), max_size=400),
    st.lists(SINGLES, min_size=5, max_size=5),
)
def test_a_scan_keeps_every_bit(
    stamp: int, robot: int, ranges: list[int], numbers: list[float]
) -> None:
    """NaNs of any kind keep their bits, too."""
    first, last, between, shortest, longest = numbers
    scan = Scan(
        robot=robot,
        stamp_ns=stamp,
        ranges=np.array(ranges, np.uint32).view(np.float32),
        angle_min=first,
        angle_max=last,
        angle_increment=between,
        range_min=shortest,
        range_max=longest,
    )
    came = codec.decode("scan", robot, codec.encode(scan))
    assert isinstance(came, Scan)
    assert came.ranges.tobytes() == scan.ranges.tobytes()
    assert came.ranges.flags.writeable
    for name in ("angle_min", "angle_max", "angle_increment", "range_min", "range_max"):
        assert bits(getattr(came, name)) == bits(getattr(scan, name))
    assert (came.robot, came.stamp_ns) == (robot, stamp)


@given(STAMPS, ROBOTS, st.lists(DOUBLES, min_size=6, max_size=6), st.booleans())
def test_an_odometry_keeps_every_bit(
    stamp: int, robot: int, numbers: list[float], truth: bool
) -> None:
    x, y, z, w, linear, angular = numbers
    odometry = Odometry(
        robot=robot,
        stamp_ns=stamp,
        x=x,
        y=y,
        z=z,
        w=w,
        linear=linear,
        angular=angular,
        truth=truth,
    )
    channel, number = codec.topic(odometry)
    came = codec.decode(channel, number, codec.encode(odometry))
    assert isinstance(came, Odometry)
    assert (came.robot, came.stamp_ns, came.truth) == (robot, stamp, truth)
    assert [
        bits(n) for n in (came.x, came.y, came.z, came.w, came.linear, came.angular)
    ] == [bits(n) for n in numbers]


@pytest.mark.parametrize(
    "message",
    [
        Velocity(robot=3, stamp_ns=5, linear=math.pi, angular=-0.0),
        Clock(stamp_ns=2**61),
        ResetWorld(seed=2**64 - 1),
        ResetWorld(seed=0),
    ],
)
def test_other_messages_round_trip(message: Message) -> None:
    assert codec.decode(*codec.topic(message), codec.encode(message)) == message


@given(
    st.lists(st.tuples(st.integers(0, 0xFFFF), st.binary(max_size=50))),
    st.integers(1, 30),
)
def test_frames_are_reassembled_from_any_chunks(
    sent: list[tuple[int, bytes]], chunk: int
) -> None:
    stream = b"".join(frames.frame(topic, body) for topic, body in sent)
    rest, came = bytearray(), []
    for at in range(0, len(stream), chunk):
        rest += stream[at : at + chunk]
        came += frames.take(rest)
    assert came == sent
    assert not rest


def test_invalid_frames_are_refused() -> None:
    with pytest.raises(ValueError, match="a frame of 1819043176 bytes"):
        frames.take(bytearray(b"hello, this is no frame"))


def test_stamped_velocities_and_services_have_their_types() -> None:
    plain = profiles.read("stage_ros2")
    assert codec.ros_type(plain, "velocity") == "geometry_msgs/Twist"
    assert (
        codec.ros_type(profiles.read("turtlebot3-jazzy"), "velocity")
        == "geometry_msgs/TwistStamped"
    )
    assert codec.ros_type(plain, "reset") == "std_msgs/UInt64"
