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

from zswarm.ros import bridges
from zswarm.ros.over_zenoh import ATTACHMENT, Node, open_session

sys.path.append(str(Path(bridges.__file__).parent))  # its programs import each other so, in other Pythons

from by_zenoh import empty, spelled  # type: ignore[import-not-found]
from conversion import Conversion  # type: ignore[import-not-found]

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "ros2_bytes.json").read_text())  # robots/ros2_bytes.py made it
TOPIC = {"frame": "robot_1/ray", "child_frame": "robot_1/hub"}
TWIST = "geometry_msgs/msg/Twist"
TIMEOUT_S = 20


@pytest.fixture
def node() -> Iterator[Node]:
    with open_session([], []) as session:
        yield Node(session, "robot", domain=7, distribution="kilted")


@pytest.mark.parametrize("kind", GOLDEN)
def test_bytes_and_hashes_are_those_of_ros_2(kind: str, node: Node) -> None:
    known = GOLDEN[kind]
    conversion = Conversion(lambda name: empty(node.store, spelled(name)), floats=lambda raw: np.frombuffer(raw, np.float32))
    message = conversion.message({**TOPIC, "type": kind})(bytes.fromhex(known["body"]))
    assert bytes(node.store.serialize_cdr(message, spelled(kind))).hex() == known["cdr"]
    assert node.store.hash_rihs01(spelled(kind)) == known["hash"]
    back = node.store.deserialize_cdr(bytes.fromhex(known["cdr"]), spelled(kind))
    assert conversion.body(kind)(back).hex() == known["body"]


def test_a_key_has_domain_topic_type_and_hash(node: Node) -> None:
    assert node.key("/robot_1/cmd_vel", TWIST) == (
        f"7/robot_1/cmd_vel/geometry_msgs::msg::dds_::Twist_/{GOLDEN['geometry_msgs/Twist']['hash']}"
    )


def test_humble_has_no_hashes() -> None:
    with open_session([], []) as session:
        node = Node(session, "robot", distribution="humble")
        assert node.key("/cmd_vel", TWIST) == "0/cmd_vel/geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported"


def test_an_unknown_distribution_is_named() -> None:
    with (
        open_session([], []) as session,
        pytest.raises(ValueError, match=r"no distribution 'noetic' of ROS 2; known are .*humble"),
    ):
        Node(session, "robot", distribution="noetic")


def test_others_see_who_is_there_and_what_was_sent_is_numbered() -> None:
    """A session that knows nothing of nodes reads tokens, keys and attachments as rmw_zenoh's design has them."""
    samples: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    with open_session([], ["tcp/127.0.0.1:27447"]) as watching, open_session(["tcp/127.0.0.1:27447"], []) as session:
        node = Node(session, "robot", domain=7)
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
        numbers = [ATTACHMENT.unpack(sample.attachment.to_bytes()) for sample in (first, second) if sample.attachment]
        assert [number for number, *_ in numbers] == [1, 2]
        assert len({gid for *_, gid in numbers}) == 1
        assert str(first.key_expr) == node.key("/robot_1/cmd_vel", TWIST)
        assert node.store.deserialize_cdr(first.payload.to_bytes(), TWIST).linear.x == 0.25
        node.close()
        assert wait_for_tokens(watching, 0) == []


def test_what_is_no_message_is_dropped() -> None:
    came: queue.SimpleQueue[Any] = queue.SimpleQueue()
    with open_session([], []) as session:
        node = Node(session, "robot")
        node.subscribe("/cmd_vel", TWIST, came.put)
        session.put(node.key("/cmd_vel", TWIST), b"hello")
        node.publisher("/cmd_vel", TWIST).publish(empty(node.store, TWIST))
        assert came.get(timeout=TIMEOUT_S).linear.x == 0.0
        assert came.empty()


def wait_for_tokens(session: zenoh.Session, count: int) -> list[str]:
    """All tokens of the domain, as soon as there are so many."""
    for _ in range(TIMEOUT_S * 20):
        replies = session.liveliness().get("@ros2_lv/7/**")
        found = [str(reply.ok.key_expr) for reply in replies if reply.ok]
        if len(found) == count:
            return found
        threading.Event().wait(0.05)
    raise AssertionError(f"{count} tokens were expected: {found}")
