"""Links over Zenoh, and errors where something is missing; for ROS: test_ros_links."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from zswarm.errors import ConfigError, EvaluationError
from zswarm.robots.profiles import profile as profiles
from zswarm.ros.link import graph
from zswarm.ros.link.link import Link
from zswarm.ros.link.messages import Clock, ResetWorld, Scan, Velocity

PROFILE = profiles.read("stage_ros2")
TIMEOUT_S = 30


@pytest.fixture
def here() -> Iterator[graph.RosGraph]:
    with graph.private("zenoh") as private:
        yield private


def test_messages_go_both_ways_between_two_sides(here: graph.RosGraph) -> None:
    """Messages of different topics may arrive in any order, as in ROS."""
    scan = Scan(
        robot=1,
        stamp_ns=10**9 + 1,
        ranges=np.array([1.5, np.inf, 0.1], np.float32),
        angle_min=-1,
        angle_max=1,
        angle_increment=1,
        range_min=0,
        range_max=4,
    )
    with (
        Link(here.dialled(), PROFILE, robots=2, side="simulation") as simulation,
        Link(here, PROFILE, robots=2, side="controllers") as controllers,
    ):
        controllers.ready(TIMEOUT_S)
        simulation.ready(TIMEOUT_S)
        controllers.send(
            [
                ResetWorld(seed=2**64 - 1),
                Velocity(robot=1, stamp_ns=0, linear=0.1, angular=-0.0),
            ]
        )
        came = {
            type(message): message
            for message in (simulation.receive(TIMEOUT_S), simulation.receive(TIMEOUT_S))
        }
        assert came == {
            ResetWorld: ResetWorld(seed=2**64 - 1),
            Velocity: Velocity(robot=1, stamp_ns=0, linear=0.1, angular=-0.0),
        }
        simulation.send([scan, Clock(stamp_ns=7)])
        came = {
            type(message): message
            for message in (
                controllers.receive(TIMEOUT_S),
                controllers.receive(TIMEOUT_S),
            )
        }
        assert came[Clock] == Clock(stamp_ns=7)
        assert isinstance(seen := came[Scan], Scan)
        assert (seen.robot, seen.stamp_ns, seen.ranges.tobytes()) == (
            1,
            10**9 + 1,
            scan.ranges.tobytes(),
        )
        assert controllers.receive(0.0) is None
        with pytest.raises(
            ValueError, match="clock of robot 0 is not published by this link"
        ):
            controllers.send([Clock(stamp_ns=1)])


def test_missing_nodes_are_named(here: graph.RosGraph) -> None:
    with (
        Link(
            here, PROFILE, robots=1, side="controllers", channels=("scan", "velocity")
        ) as link,
        pytest.raises(
            EvaluationError,
            match=r"^no node subscribes to /cmd_vel; no node publishes /base_scan after 0\.2 s$",
        ),
    ):
        link.ready(0.2)


def test_one_of_several_channels_may_be_enough(here: graph.RosGraph) -> None:
    with (
        Link(here.dialled(), PROFILE, robots=1, side="simulation") as simulation,
        Link(
            here, PROFILE, robots=1, side="controllers", channels=("scan", "ground_truth")
        ),
    ):
        simulation.ready(TIMEOUT_S, ["scan"], either=["odometry", "ground_truth"])
        with pytest.raises(
            EvaluationError, match=r"^no node subscribes to /odom after 0\.2 s$"
        ):
            simulation.ready(0.2, ["scan"], either=["odometry"])


def test_a_bridge_that_is_killed_is_named(here: graph.RosGraph) -> None:
    with Link(here, PROFILE, robots=1, side="controllers") as link:
        os.kill(bridges()[0], signal.SIGKILL)
        with pytest.raises(
            EvaluationError, match=r"^the zenoh bridge was killed by signal 9"
        ):
            link.receive(TIMEOUT_S)
    assert bridges() == []


def test_closing_a_link_leaves_no_processes(here: graph.RosGraph) -> None:
    link = Link(here, PROFILE, robots=1, side="controllers")
    assert len(bridges()) == 1
    link.close()
    link.close()
    assert bridges() == []


@pytest.mark.parametrize(
    ("kind", "profile", "said"),
    [
        (
            "rospy",
            "stage_ros2",
            r"the link rospy speaks ROS 1, and the profile \(Stage in ROS 2: .*\) is of ROS 2",
        ),
        (
            "zenoh",
            "stageros",
            r"the link zenoh speaks ROS 2, and the profile \(.*\) is of ROS 1",
        ),
    ],
)
def test_a_profile_of_another_ros_version_is_refused(
    kind: graph.LinkKind, profile: str, said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        Link(
            graph.RosGraph(link=kind),
            profiles.read(profile),
            robots=1,
            side="controllers",
        )


def test_services_are_refused_over_zenoh(here: graph.RosGraph) -> None:
    stage = msgspec.structs.replace(
        PROFILE, reset=profiles.ResetTopic(name="/reset_positions", service=True)
    )
    with pytest.raises(
        ConfigError,
        match=r"^the link zenoh calls no services: use a profile whose reset is a topic",
    ):
        Link(here, stage, robots=1, side="controllers")


def test_an_endpoint_in_use_is_reported(here: graph.RosGraph) -> None:
    with (
        Link(here.dialled(), PROFILE, robots=1, side="simulation"),
        pytest.raises(ConfigError, match=r"^zenoh: .*Address already in use"),
    ):
        Link(here.dialled(), PROFILE, robots=1, side="simulation")


@pytest.mark.parametrize(
    ("kind", "variable", "profile", "said"),
    [
        (
            "rospy",
            "ZSWARM_ROS1_PYTHON",
            "stageros",
            r"rospy is missing: install it \(Debian: apt install ros-core\)",
        ),
        (
            "rclpy",
            "ZSWARM_ROS2_PYTHON",
            "stage_ros2",
            "rclpy is missing: source ROS 2's setup.bash, or name the Python",
        ),
    ],
)
def test_missing_ros_is_reported_with_a_fix(
    kind: graph.LinkKind,
    variable: str,
    profile: str,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """A Python without any packages stands in for one without ROS."""
    bare = tmp_path / "python"
    bare.write_text('#!/bin/sh\nexec /usr/bin/env python3 -S "$@"\n')
    bare.chmod(0o755)
    monkeypatch.setenv(variable, str(bare))
    monkeypatch.delenv("PYTHONPATH", raising=False)
    with pytest.raises(ConfigError, match=f"^{said}"):
        Link(
            graph.RosGraph(link=kind),
            profiles.read(profile),
            robots=1,
            side="controllers",
        )


def test_a_missing_python_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZSWARM_ROS2_PYTHON", "/nowhere/python")
    with pytest.raises(
        ConfigError,
        match=r"^/nowhere/python cannot be started for the rclpy bridge: No such file or direct",
    ):
        Link(graph.RosGraph(link="rclpy"), PROFILE, robots=1, side="controllers")


def test_two_private_domains_differ() -> None:
    with graph.private("rclpy") as one, graph.private("rclpy") as other:
        assert one.domain != other.domain
        expected = {
            "ROS_DOMAIN_ID": str(one.domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
        assert one.environment("kilted").items() >= expected.items()
        assert one.environment("humble")["ROS_LOCALHOST_ONLY"] == "1"


def bridges() -> list[int]:
    """Return the bridges that this process started."""
    found = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    return [
        int(child)
        for child in found
        if "by_zenoh" in Path(f"/proc/{child}/cmdline").read_text()
    ]
