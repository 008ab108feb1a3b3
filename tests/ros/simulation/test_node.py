"""The simulation node as a program: trials, silent robots, free-running, slots."""

import itertools
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from tests.robots.trials import built, by_network, by_policy
from tests.ros.ros_here import need
from tests.sims import robot_controllers
from zswarm import evaluate
from zswarm.errors import EvaluationError
from zswarm.robots.profiles import profile as profiles
from zswarm.ros.link import graph
from zswarm.ros.link.graph import RosGraph
from zswarm.ros.link.link import Link
from zswarm.ros.link.messages import Clock, Odometry, ResetWorld, Scan, Velocity
from zswarm.ros.simulation import simulation
from zswarm.sims.simulator import Turn

pytestmark = pytest.mark.robots

ROOM = {"robots": 2, "steps": 30, "map": "open"}


@pytest.fixture
def here() -> Iterator[RosGraph]:
    need("zenoh")
    with graph.private("zenoh") as private:
        yield private


@contextmanager
def node(
    here: RosGraph, *options: str, **settings: Any
) -> Iterator["subprocess.Popen[str]"]:
    """A node, ended with the block if it has not ended."""
    command = [
        sys.executable,
        "-m",
        "zswarm.ros.simulation.node",
        "--link",
        "zenoh",
        "--profile",
        "stage_ros2",
    ]
    for endpoint in here.dialled().listen:
        command += ["--listen", endpoint]
    with subprocess.Popen(
        [*command, "--settings", json.dumps({**ROOM, **settings}), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as started:
        try:
            yield started
        finally:
            started.kill()


def controllers(here: RosGraph) -> Link:
    return Link(
        here,
        profiles.read("stage_ros2"),
        robots=2,
        side="controllers",
        channels=["velocity", "scan", "odometry"],
    )


def test_a_trial_records_its_poses_and_its_outcome(
    here: RosGraph, tmp_path: Path
) -> None:
    """The velocities are those that drive the world in this process."""
    world = built("turtlebot-exit", **ROOM)
    turn: Turn | None = world.reset(5)
    poses = [world.poses.copy()]
    options = [
        "--seed",
        "5",
        "--poses",
        str(tmp_path / "poses.npy"),
        "--channels",
        "scan,odometry",
    ]
    with node(here, *options) as started, controllers(here) as link:
        link.ready(30.0)
        while turn is not None:
            seen: dict[str, set[int]] = {"Scan": set(), "Odometry": set()}
            while not all(robots == {0, 1} for robots in seen.values()):
                message = link.receive(20.0)
                assert isinstance(message, Scan | Odometry)
                seen[type(message).__name__].add(message.robot)
            link.send(
                [
                    Velocity(robot=robot, stamp_ns=0, linear=0.3, angular=robot - 0.5)
                    for robot in (0, 1)
                ]
            )
            turn = world.drive(np.array([0.3, 0.3]), np.array([-0.5, 0.5]))
            poses.append(world.poses.copy())
        said, errors = started.communicate(timeout=30)
    assert (started.returncode, errors) == (0, "")
    assert np.load(tmp_path / "poses.npy").tobytes() == np.stack(poses).tobytes()
    outcome = json.loads(said)
    assert (outcome["seed"], outcome["steps"], [outcome["fitness"]]) == (
        5,
        30,
        world.outcome().fitness,
    )


def test_a_robot_that_never_answers_is_named(here: RosGraph) -> None:
    with (
        node(
            here, "--seed", "5", "--channels", "scan,odometry", "--deadline-s", "5"
        ) as started,
        controllers(here) as link,
    ):
        link.ready(30.0)
        assert link.receive(20.0) is not None
        link.send([Velocity(robot=0, stamp_ns=0, linear=0.1, angular=0.0)])
        _, errors = started.communicate(timeout=30)
    assert started.returncode == 1
    assert (
        errors
        == "zswarm.ros.simulation.node: no velocity of robot 1 at 0.2 s within 5 s (deadline_s)\n"
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--settings", "{"], "--settings: expected JSON: "),
        (["--settings", '{"robots": 0}'], "--settings: robots: expected int >= 1"),
        (
            ["--channels", "scan,map"],
            "--channels: expected some of scan, odometry, ground_truth, not 'map'",
        ),
        (["--profile", "stages"], "no profile 'stages'"),
        (["--profile", "stageros"], "the link zenoh speaks ROS 2"),
    ],
)
def test_impossible_settings_are_reported_in_one_line(
    options: list[str], said: str
) -> None:
    command = [
        sys.executable,
        "-m",
        "zswarm.ros.simulation.node",
        "--link",
        "zenoh",
        "--profile",
        "stage_ros2",
        *options,
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith(f"zswarm.ros.simulation.node: {said}")


def test_a_free_running_simulation_stops_a_robot_without_commands(
    here: RosGraph,
) -> None:
    """After 0.2 s of its time, the profile's watchdog_s; its clock continues."""
    with node(
        here,
        "--mode",
        "free-running",
        "--rate",
        "5",
        "--channels",
        "scan,odometry",
        turn=1.0,
    ):
        used = ["velocity", "scan", "odometry", "clock", "reset"]
        with Link(
            here, profiles.read("stage_ros2"), robots=2, side="controllers", channels=used
        ) as link:
            link.ready(30.0)
            link.send([ResetWorld(seed=3)])
            moved, told, clock_ns = [], False, 0
            while clock_ns < 8_000_000_000:
                message = link.receive(20.0)
                if isinstance(message, Clock):
                    clock_ns = message.stamp_ns
                if isinstance(message, Odometry) and message.robot == 1:
                    if not told:
                        link.send(
                            [
                                Velocity(
                                    robot=1,
                                    stamp_ns=message.stamp_ns,
                                    linear=0.0,
                                    angular=1.0,
                                )
                            ]
                        )
                        told = True
                    moved.append(message.z)
    turning = [later != sooner for sooner, later in itertools.pairwise(moved)]
    assert any(turning), "it did what it was told"
    assert not any(turning[-5:]), "and then stands"


def test_a_free_running_simulation_reports_how_late_the_controllers_are() -> None:
    """Few are late in real time; at 1,000 times the speed most are, and steps are missed."""
    need("zenoh")
    late, turns = [], []
    room = {**ROOM, "mode": "free-running", "missed_limit": 1.0}
    for rate, trials in ((1.0, 1), (1000.0, 8)):
        simulator = built("turtlebot-exit-ros", rate=rate, **room)
        for seed in range(3, 3 + trials):
            played = by_policy(simulator, robot_controllers.turtlebot_exit, seed)
            out, _, seconds, share, missed, ran_at = played.outcome.metrics
            assert ran_at > 0
            late.append(share)
            turns.append(len(played.poses) - 1)
            assert missed == 1 - turns[-1] / round(seconds / 0.2)
            assert seconds == 6.0 or out == 2, "all seconds have passed, or all are out"
        simulator.close()
        assert not simulator.repeatable
    assert late[0] < max(late[1:]) <= 1.0
    assert min(turns[1:]) < turns[0] <= 30


def test_a_trial_whose_steps_passed_without_decisions_is_a_fault() -> None:
    """It is no outcome: the robots were not asked."""
    need("zenoh")
    room = {**ROOM, "mode": "free-running", "rate": 1000.0, "missed_limit": 0.0}
    simulator = built("turtlebot-exit-ros", **room)
    with pytest.raises(
        EvaluationError,
        match=r"\d+ of \d+ steps passed without a decision: the simulation runs at \S+ times real "
        r"time, about [\d.]+ times too fast .* at most 0 \(missed_limit\): slow it down, see docs",
    ):
        play_many(simulator)
    simulator.close()


def play_many(simulator: Any) -> None:
    for seed in range(20):
        by_policy(simulator, robot_controllers.turtlebot_exit, seed)


def in_slot(here: RosGraph, folder: Path, patch: pytest.MonkeyPatch, **more: Any) -> Any:
    """Build the simulator as a slot does, on a machine whose file says where the node is."""
    file = {"link": "zenoh", "profile": "stage_ros2", "connect": here.connect}
    (folder / "room.toml").write_text(tomli_w.dumps(file))
    patch.setenv("ZSWARM_ROS", str(folder))
    patch.setenv("RUNTIME_DIRECTORY", str(folder / "locks"))
    settings = {**ROOM, "simulation": "room", **more}
    name, network = "turtlebot-exit-ros", "fully-meshed"
    return evaluate.build(name, settings, network, {}, in_slot=True)[0]


@pytest.mark.parametrize("contact", ["slide", "stall"])
def test_robots_that_stay_are_the_same_in_ros(contact: str) -> None:
    need("zenoh")
    room = {**ROOM, "steps": 60, "epsilon": 1.0, "contact": contact, "after_exit": "stay"}
    here, ros = (built(name, **room) for name in ("turtlebot-exit", "turtlebot-exit-ros"))
    expected = by_policy(here, robot_controllers.turtlebot_exit, 3)
    assert expected.outcome.metrics[0] > 0, "some leave"
    assert by_policy(ros, robot_controllers.turtlebot_exit, 3).bits == expected.bits
    ros.close()


def test_a_simulation_that_runs_is_driven_by_one_slot(
    here: RosGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with node(here):
        simulator, other = (in_slot(here, tmp_path, monkeypatch) for _ in range(2))
        expected = by_network(built("turtlebot-exit", **ROOM), 6)
        for _ in range(2):
            assert by_network(simulator, 6).bits == expected.bits
        with pytest.raises(
            EvaluationError,
            match="another slot drives this simulation; one server with --capacity 1",
        ):
            other.reset(1)
        simulator.close()
        assert by_network(other, 6).bits == expected.bits
        other.close()


def test_a_missing_simulation_is_named(
    here: RosGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulation, "READY_S", 2.0)
    simulator = in_slot(here, tmp_path, monkeypatch, deadline_s=1.0)
    lacking = "no node subscribes to .*; no node publishes .* after 2 s"
    with pytest.raises(
        EvaluationError, match=f"simulator 'turtlebot-exit-ros', trial seed 1: {lacking}"
    ):
        simulator.reset(1)
