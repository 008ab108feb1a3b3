"""Links through real ROS: nothing is lost, order and bits are kept, and nothing is left behind."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.repository import REPOSITORY
from tests.ros.ros_here import LINKS, ROS_2, need
from zswarm.errors import ConfigError, EvaluationError
from zswarm.robots.profiles import profile as profiles
from zswarm.robots.profiles.profile import Channel, Profile
from zswarm.ros.link import graph
from zswarm.ros.link.link import Link
from zswarm.ros.link.messages import Clock, Message, Odometry, ResetWorld, Scan, Velocity

pytestmark = pytest.mark.robots
MESSAGES = 1000
ROBOTS = 4
TIMEOUT_S = 60
STAGE = profiles.read("turtlebot2-stage")
STAGE_2 = msgspec.structs.replace(profiles.read("stage_ros2"), reset=STAGE.reset)
GOLDEN = REPOSITORY / "tests" / "golden" / "ros2_bytes.json"
HOLDER = """
import sys
from zswarm.robots.profiles import profile as profiles
from zswarm.ros.link import graph
from zswarm.ros.link.link import Link
kind = sys.argv[1]
profile = profiles.read(sys.argv[2])
with graph.private(kind) as here, Link(here, profile, robots=2, side="controllers") as link:
    print("there", flush=True)
    link.receive(60)
"""


@pytest.fixture(params=LINKS)
def here(request: pytest.FixtureRequest) -> Iterator[graph.RosGraph]:
    need(request.param)
    with graph.private(request.param) as private:
        yield private


def profile(link: str) -> str:
    return "stageros" if link == "rospy" else "stage_ros2"


def scan(number: int) -> Scan:
    """Return a scan whose ranges include NaN, infinity and a subnormal number."""
    ranges = np.array([number / 3, np.inf, np.nan, -0.0, 1e-45, 3.4e38], np.float32)
    return Scan(
        robot=number % ROBOTS,
        stamp_ns=number * 10**8 + 1,
        ranges=ranges,
        angle_min=-1.25,
        angle_max=1.25,
        angle_increment=0.5,
        range_min=0.0,
        range_max=4.0,
    )


def odometry(number: int, *, truth: bool) -> Odometry:
    third = number / 3
    return Odometry(
        robot=number % ROBOTS,
        stamp_ns=number * 10**8 + 1,
        x=third,
        y=-third,
        z=0.6,
        w=-0.0,
        linear=0.1,
        angular=5e-324,
        truth=truth,
    )


def received(link: Link, count: int) -> list[Message]:
    """Wait for that many messages and return them."""
    found = []
    while len(found) < count:
        message = link.receive(TIMEOUT_S)
        assert message is not None, f"{len(found)} of {count} came"
        found.append(message)
    return found


def test_a_thousand_messages_each_way_are_all_there_in_order(
    here: graph.RosGraph,
) -> None:
    """Messages of one topic arrive in their order and with all their bits."""
    described = profiles.read(profile(here.link))
    with (
        Link(here.dialled(), described, robots=ROBOTS, side="simulation") as simulation,
        Link(here, described, robots=ROBOTS, side="controllers") as controllers,
    ):
        controllers.ready(TIMEOUT_S)
        simulation.ready(TIMEOUT_S)
        controllers.send(
            [
                Velocity(robot=n % ROBOTS, stamp_ns=0, linear=n / 3, angular=-0.0)
                for n in range(MESSAGES)
            ]
        )
        controllers.send([ResetWorld(seed=2**64 - 1)])
        sent = [
            Velocity(robot=n % ROBOTS, stamp_ns=0, linear=n / 3, angular=-0.0)
            for n in range(MESSAGES)
        ]
        came = received(simulation, MESSAGES + 1)
        assert [m for m in came if isinstance(m, ResetWorld)] == [
            ResetWorld(seed=2**64 - 1)
        ]
        for robot in range(ROBOTS):
            assert [
                m for m in came if isinstance(m, Velocity) and m.robot == robot
            ] == sent[robot::ROBOTS]
        for first in range(0, MESSAGES, 100):
            numbers = range(first, first + 100)
            simulation.send(
                [odometry(n, truth=truth) for n in numbers for truth in (True, False)]
            )
            simulation.send([Clock(stamp_ns=n) for n in numbers])
            simulation.send([scan(n) for n in numbers])
            check_hundred(received(controllers, 400), first)
        assert controllers.receive(0.1) is None


def check_hundred(came: list[Message], first: int) -> None:
    numbers = range(first, first + 100)
    assert [m.stamp_ns for m in came if isinstance(m, Clock)] == list(numbers)
    for robot in range(ROBOTS):
        own = [n for n in numbers if n % ROBOTS == robot]
        scans = [m for m in came if isinstance(m, Scan) and m.robot == robot]
        assert [m.stamp_ns for m in scans] == [scan(n).stamp_ns for n in own]
        assert [m.ranges.tobytes() for m in scans] == [
            scan(n).ranges.tobytes() for n in own
        ]
        for truth in (True, False):
            poses = [
                m
                for m in came
                if isinstance(m, Odometry) and m.truth is truth and m.robot == robot
            ]
            assert [repr(pose) for pose in poses] == [
                repr(odometry(n, truth=truth)) for n in own
            ]


def test_missing_nodes_are_named(here: graph.RosGraph) -> None:
    described = profiles.read(profile(here.link))
    with (
        Link(
            here, described, robots=2, side="controllers", channels=("scan", "velocity")
        ) as link,
        pytest.raises(
            EvaluationError,
            match=r"^no node subscribes to /robot_0/cmd_vel, /robot_1/cmd_vel; no node publishes /",
        ),
    ):
        link.ready(0.3)


def test_a_killed_bridge_is_named_and_replaced(
    here: graph.RosGraph,
) -> None:
    described = profiles.read(profile(here.link))
    for _ in range(2):
        with Link(here, described, robots=1, side="controllers") as link:
            (bridge,) = [
                child
                for child in below(os.getpid())
                if f"by_{here.link}" in command(child)
            ]
            os.kill(bridge, signal.SIGKILL)
            with pytest.raises(
                EvaluationError, match=f"^the {here.link} bridge was killed by signal 9"
            ):
                link.receive(TIMEOUT_S)


def test_nothing_remains_when_the_owner_of_a_link_is_killed(here: graph.RosGraph) -> None:
    holding = [sys.executable, "-c", HOLDER, here.link, profile(here.link)]
    with subprocess.Popen(holding, stdout=subprocess.PIPE, text=True) as holder:
        try:
            assert holder.stdout
            assert holder.stdout.readline() == "there\n"
            started = below(holder.pid)
            assert started
        finally:
            holder.kill()
    deadline = time.monotonic() + TIMEOUT_S
    while any(alive(child) for child in started):
        assert time.monotonic() < deadline, [
            command(child) for child in started if alive(child)
        ]
        time.sleep(0.05)


def test_a_master_that_does_not_answer_is_reported() -> None:
    need("rospy")
    nowhere = graph.RosGraph(link="rospy", master="http://127.0.0.1:9")
    with pytest.raises(
        ConfigError,
        match=r"^no ROS master answers at http://127\.0\.0\.1:9: start one \(roscore\)",
    ):
        Link(nowhere, profiles.read("stageros"), robots=1, side="controllers")


@pytest.mark.parametrize(
    ("link", "profile"), [("rospy", STAGE), ("rclpy", STAGE_2)], ids=["rospy", "rclpy"]
)
def test_a_service_without_arguments_begins_a_trial(
    link: graph.LinkKind, profile: Profile
) -> None:
    """Stage's reset_positions is such a service; it does not receive the seed.

    Controllers are told when a call returned.
    """
    need(link)
    with (
        graph.private(link) as here,
        Link(
            here, profile, robots=2, side="controllers", channels=("reset",)
        ) as controllers,
    ):
        with pytest.raises(
            EvaluationError,
            match=r"^no node offers the service /reset_positions after 0.1 s$",
        ):
            controllers.ready(0.1)
        with Link(
            here.dialled(), profile, robots=2, side="simulation", channels=("reset",)
        ) as simulation:
            controllers.ready(TIMEOUT_S)
            simulation.ready(TIMEOUT_S)
            controllers.send([ResetWorld(seed=7), ResetWorld(seed=8)])
            assert received(simulation, 2) == [ResetWorld(seed=0), ResetWorld(seed=0)]
            returned = received(controllers, 2)
            assert returned == [ResetWorld(seed=0), ResetWorld(seed=0)]


@pytest.mark.parametrize(
    ("link", "profile"), [("rospy", STAGE), ("rclpy", STAGE_2)], ids=["rospy", "rclpy"]
)
def test_a_service_that_returned_is_reported_with_the_next_time(
    link: graph.LinkKind, profile: Profile
) -> None:
    """Of the clock, published after the call: so until then it is not reported."""
    need(link)
    channels: tuple[Channel, ...] = ("reset", "clock")
    with (
        graph.private(link) as here,
        Link(
            here,
            profile,
            robots=1,
            side="controllers",
            channels=channels,
            stamped_resets=True,
        ) as controllers,
        Link(
            here.dialled(), profile, robots=1, side="simulation", channels=channels
        ) as simulation,
    ):
        controllers.ready(TIMEOUT_S)
        simulation.ready(TIMEOUT_S)
        for now in (0, 1000):
            simulation.send([Clock(stamp_ns=now + 1)])
            assert received(controllers, 1) == [Clock(stamp_ns=now + 1)]
            controllers.send([ResetWorld()])
            assert received(simulation, 1) == [ResetWorld()]
            assert controllers.receive(0.2) is None
            came: list[Message] = []
            stamp_ns = now + 1
            while not any(isinstance(message, ResetWorld) for message in came):
                stamp_ns += 1  # the first ones may be too early for the new connection
                simulation.send([Clock(stamp_ns=stamp_ns)])
                came += [message for message in [controllers.receive(0.5)] if message]
            (reset,) = [message for message in came if isinstance(message, ResetWorld)]
            assert now + 1 < reset.stamp_ns <= stamp_ns
            while controllers.receive(0.5) is not None:
                pass


def test_bytes_and_hashes_are_still_those_of_ros_2() -> None:
    """The package rclpy itself computes again what tests/ros compares with."""
    need("rclpy")
    known = json.loads(GOLDEN.read_text())
    bodies = json.dumps({kind: entry["body"] for kind, entry in known.items()})
    program = Path(__file__).parent / "ros2_bytes.py"
    done = subprocess.run(
        [ROS_2 / "bin" / "python", program],
        input=bodies,
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout) == known


def below(process: int) -> list[int]:
    """Return the processes that a process started."""
    return [
        int(child)
        for child in Path(f"/proc/{process}/task/{process}/children").read_text().split()
    ]


def command(process: int) -> str:
    return Path(f"/proc/{process}/cmdline").read_text() if alive(process) else ""


def alive(process: int) -> bool:
    """Whether it is there and did not end."""
    try:
        return (
            Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
        )
    except OSError:
        return False
