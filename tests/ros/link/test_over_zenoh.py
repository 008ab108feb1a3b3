"""Without ROS installed: the bytes, keys and tokens that nodes with rmw_zenoh have."""

import json
import queue
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from tests.repository import REPOSITORY
from zswarm.ros.link import bridges, graph
from zswarm.ros.link.over_zenoh import ATTACHMENT, ZenohNode, open_session

# Its programs import each other so, in other Pythons.
sys.path.append(str(Path(bridges.__file__).parent))

from by_zenoh import empty, spelled  # type: ignore[import-not-found]
from conversion import Conversion  # type: ignore[import-not-found]

# Made by robots/ros2_bytes.py.
GOLDEN = json.loads((REPOSITORY / "tests" / "golden" / "ros2_bytes.json").read_text())
TOPIC = {"frame": "robot_1/ray", "child_frame": "robot_1/hub"}
TWIST = "geometry_msgs/msg/Twist"
LITTLE_ENDIAN_CDR = b"\x00\x01\x00\x00"
TIMEOUT_S = 20


@pytest.fixture
def node() -> Iterator[ZenohNode]:
    with open_session([], []) as session:
        yield ZenohNode(session, "robot", domain=7, distribution="kilted")


@pytest.mark.parametrize("kind", GOLDEN)
def test_bytes_and_hashes_are_those_of_ros_2(kind: str, node: ZenohNode) -> None:
    known = GOLDEN[kind]
    conversion = Conversion(
        lambda name: empty(node.store, spelled(name)),
        floats=lambda raw: np.frombuffer(raw, np.float32),
    )
    message = conversion.message({**TOPIC, "type": kind})(bytes.fromhex(known["body"]))
    assert bytes(node.store.serialize_cdr(message, spelled(kind))).hex() == known["cdr"]
    assert node.store.hash_rihs01(spelled(kind)) == known["hash"]
    back = node.store.deserialize_cdr(bytes.fromhex(known["cdr"]), spelled(kind))
    assert conversion.body(kind)(back).hex() == known["body"]


def test_numbers_are_at_the_offsets_that_ros_expects(node: ZenohNode) -> None:
    """Poses, the quaternion's z and w, velocities and stamps are in their fields."""

    def message(kind: str) -> Any:
        return node.store.deserialize_cdr(
            bytes.fromhex(GOLDEN[kind]["cdr"]), spelled(kind)
        )

    odometry = message("nav_msgs/Odometry")
    place, speed = odometry.pose.pose, odometry.twist.twist
    assert (
        place.position.x,
        place.position.y,
        place.orientation.z,
        place.orientation.w,
    ) == (
        0.1,
        -2.5,
        0.6,
        0.8,
    )
    assert (speed.linear.x, speed.angular.z) == (0.22, -1 / 3)
    assert (odometry.header.frame_id, odometry.child_frame_id) == (
        "robot_1/ray",
        "robot_1/hub",
    )
    scan = message("sensor_msgs/LaserScan")
    assert (scan.header.stamp.sec, scan.header.stamp.nanosec) == (
        1_234_567_890,
        123_456_789,
    )
    assert (scan.angle_min, scan.angle_max, scan.range_min, scan.range_max) == (
        -1.5,
        1.5,
        0.0,
        4.0,
    )
    assert scan.angle_increment == np.float32(0.1)
    assert scan.ranges[3] == 3.25
    stamped = message("geometry_msgs/TwistStamped")
    assert (stamped.header.stamp.sec, stamped.header.stamp.nanosec) == (2, 999_999_999)
    assert (stamped.twist.linear.x, stamped.twist.angular.z) == (0.1, -2.84)
    assert message("rosgraph_msgs/Clock").clock.sec == 60
    assert message("std_msgs/UInt64").data == 2**64 - 1


def test_a_key_has_domain_topic_type_and_hash(node: ZenohNode) -> None:
    assert node.key("/robot_1/cmd_vel", TWIST) == (
        f"7/robot_1/cmd_vel/geometry_msgs::msg::dds_::Twist_/{GOLDEN['geometry_msgs/Twist']['hash']}"
    )


def test_humble_has_no_hashes() -> None:
    with open_session([], []) as session:
        node = ZenohNode(session, "robot", distribution="humble")
        assert (
            node.key("/cmd_vel", TWIST)
            == "0/cmd_vel/geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported"
        )


def test_an_unknown_distribution_is_named() -> None:
    with (
        open_session([], []) as session,
        pytest.raises(
            ValueError, match=r"no distribution 'noetic' of ROS 2; known are .*humble"
        ),
    ):
        ZenohNode(session, "robot", distribution="noetic")


def test_liveliness_tokens_are_declared_and_messages_are_numbered() -> None:
    """Tokens, keys and attachments are as in rmw_zenoh's design."""
    samples: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    with (
        graph.private("zenoh") as here,
        open_session([], here.connect) as watching,
        open_session(here.connect, []) as session,
    ):
        node = ZenohNode(session, "robot", domain=7)
        watching.declare_subscriber("7/**", samples.put)
        publisher = node.publisher("/robot_1/cmd_vel", TWIST, reliable=False)
        node.subscribe("/scan", "sensor_msgs/msg/LaserScan", print)
        tokens = wait_for_tokens(watching, 3)
        zid, hashed = str(session.info.zid()), GOLDEN["geometry_msgs/Twist"]["hash"]
        assert f"@ros2_lv/7/{zid}/0/0/NN/%/%/robot" in tokens
        assert (
            f"@ros2_lv/7/{zid}/0/1/MP/%/%/robot/%robot_1%cmd_vel/geometry_msgs::msg::dds_::Twist_/{hashed}/2::,1000:,:,:,,"
            in tokens
        )
        message = empty(node.store, TWIST)
        message.linear.x = 0.25
        for _ in range(2):
            publisher.publish(message)
        first, second = (samples.get(timeout=TIMEOUT_S) for _ in range(2))
        numbers = [
            ATTACHMENT.unpack(sample.attachment.to_bytes())
            for sample in (first, second)
            if sample.attachment
        ]
        assert [number for number, *_ in numbers] == [1, 2]
        assert len({gid for *_, gid in numbers}) == 1
        assert str(first.key_expr) == node.key("/robot_1/cmd_vel", TWIST)
        assert (
            node.store.deserialize_cdr(first.payload.to_bytes(), TWIST).linear.x == 0.25
        )
        node.close()
        assert wait_for_tokens(watching, 0) == []


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"hello",
        LITTLE_ENDIAN_CDR,
        LITTLE_ENDIAN_CDR + bytes(47),
        LITTLE_ENDIAN_CDR + bytes(64),
    ],
)
def test_invalid_messages_are_dropped(
    body: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    """No error is printed, because anybody may send anything."""
    came: queue.SimpleQueue[Any] = queue.SimpleQueue()
    with open_session([], []) as session:
        node = ZenohNode(session, "robot")
        node.subscribe("/cmd_vel", TWIST, came.put)
        session.put(node.key("/cmd_vel", TWIST), body)
        message = empty(node.store, TWIST)
        message.linear.x = 1.0
        node.publisher("/cmd_vel", TWIST).publish(message)
        assert came.get(timeout=TIMEOUT_S).linear.x == 1.0  # the first that came
    assert capfd.readouterr() == ("", "")


def wait_for_tokens(session: zenoh.Session, count: int) -> list[str]:
    """Return all tokens of the domain, once there are this many."""
    for _ in range(TIMEOUT_S * 20):
        replies = session.liveliness().get("@ros2_lv/7/**")
        found = [str(reply.ok.key_expr) for reply in replies if reply.ok]
        if len(found) == count:
            return found
        threading.Event().wait(0.05)
    raise AssertionError(f"{count} tokens were expected: {found}")
