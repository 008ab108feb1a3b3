"""Packages are built and started as their READMEs say, and drive robots in ROS."""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import xmlrpc.client
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.robots.packed import evolved, in_process, scanner, simulator, write
from tests.ros.ros_here import ROS_2, need
from zswarm.robots.package import Files, ros1, ros2, zenoh
from zswarm.robots.profiles import profile as profiles
from zswarm.ros.link import graph
from zswarm.ros.link.graph import LinkKind, RosGraph
from zswarm.ros.link.link import Link
from zswarm.ros.link.messages import Odometry, Scan, Velocity

pytestmark = pytest.mark.robots

ROBOTS, SEED, NAME = 2, 7, "zs_of_a_test"
CONTROLLER = evolved(robots=ROBOTS, steps=40, step_s=0.1)
ENDS_S = 20.0
DECIDES_S = 30.0


class Target(NamedTuple):
    """A kind of package, and which of its README's ways is taken."""

    make: Callable[..., Files]
    link: LinkKind
    profile: str
    way: int  # which block of commands
    lock_step: str  # what is said behind the last command; {robot} is a robot's namespace
    path: str  # where its programs are looked for first


TARGETS = {
    "catkin_make": Target(
        ros1, "rospy", "stageros", 0, "robot:={robot} lock_step:=true", "/usr/bin"
    ),
    "cmake": Target(
        ros1, "rospy", "stageros", 1, "__ns:={robot} _lock_step:=true", "/usr/bin"
    ),
    "ros2": Target(
        ros2,
        "rclpy",
        "stage_ros2",
        0,
        "--ros-args -r __ns:=/{robot} -p lock_step:=true -p use_sim_time:=true",
        str(ROS_2 / "bin"),
    ),
    "zenoh": Target(
        zenoh,
        "zenoh",
        "stage_ros2",
        0,
        "--namespace {robot} --lock-step",
        str(Path(sys.executable).parent),
    ),
}


# One way for each kind of node: that of ROS 1 is in C++, the others have one driver.
NODES = ["cmake", "ros2", "zenoh"]


class Built(NamedTuple):
    """A package that is built: how its node is started."""

    target: Target
    folder: str
    environment: dict[str, str]
    command: str

    @contextlib.contextmanager
    def started(self, here: RosGraph, more: str = "") -> Iterator[subprocess.Popen[str]]:
        """Run the node in its own process group until the block ends."""
        environment = self.environment | here.environment(
            profiles.read(self.target.profile).distribution
        )
        command = self.command.replace(
            "tcp/localhost:7447", here.connect[0] if here.connect else ""
        )
        node = subprocess.Popen(
            ["bash", "-c", f"exec {command} {more}"],
            cwd=self.folder,
            env=environment,
            text=True,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        try:
            yield node
        finally:
            if node.poll() is None:
                node.send_signal(signal.SIGINT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    node.wait(ENDS_S)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(node.pid, signal.SIGKILL)
            node.wait()
            assert node.stdout is not None
            node.stdout.close()


def build(target: Target, files: Files, folder: Path) -> Built:
    """Run what a README says before its last command, in the way of the target."""
    need(target.link)
    if shutil.which("cc") is None or (
        target.make is ros1 and shutil.which("catkin_make") is None
    ):
        pytest.skip(
            "no C compiler or no catkin here: apt-get install g++ cmake catkin libroscpp-dev "
            "and the messages' -dev packages"
        )
    package = write(files, folder / "package")
    blocks = re.findall(r"^```sh\n(.*?)^```", str(files["README.md"]), re.M | re.S)
    *lines, command = blocks[target.way].strip().splitlines()
    (folder / "home").mkdir(exist_ok=True)
    environment = {
        "HOME": str(folder / "home"),
        "PATH": f"{target.path}:/usr/local/bin:/usr/bin:/bin",
        "LANG": "C.UTF-8",
        "PIP_NO_INDEX": "1",
    }
    script = "\n".join(
        ["set -e", *lines, "printf '\\0'", "pwd", "printf '\\0'", "env -0"]
    )
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=package,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    _, where, *variables = done.stdout.split("\0")
    found = dict(variable.split("=", 1) for variable in variables if "=" in variable)
    return Built(target, where.strip(), found, command)


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Built]:
    """Build each target once."""
    built: dict[str, Built] = {}

    def give(name: str) -> Built:
        if name not in built:
            target = TARGETS[name]
            built[name] = build(
                target,
                target.make(CONTROLLER, "of_a_test", target.profile),
                tmp_path_factory.mktemp(name),
            )
        return built[name]

    return give


def simulated(
    here: RosGraph, profile: str, poses: Path
) -> subprocess.CompletedProcess[str]:
    """A trial in the simulation node, in lock-step."""
    dialled = here.dialled()
    options = [
        *(
            "--link",
            here.link,
            "--profile",
            profile,
            "--master",
            here.master,
            "--domain",
            str(here.domain),
        ),
        *(word for endpoint in dialled.listen for word in ("--listen", endpoint)),
        *(
            "--settings",
            json.dumps(CONTROLLER.simulator_settings),
            "--channels",
            "scan,odometry",
            "--deadline-s",
            "60",
        ),
        *("--seed", str(SEED), "--poses", str(poses)),
    ]
    return subprocess.run(
        [sys.executable, "-m", "zswarm.ros.simulation.node", *options],
        capture_output=True,
        text=True,
        check=False,
        timeout=180,
    )


def ask(here: RosGraph, what: str, *arguments: Any) -> Any:
    """Return the ROS master's answer."""
    with xmlrpc.client.ServerProxy(here.master) as master:
        return getattr(master, what)("/of_a_test", *arguments)


@pytest.mark.parametrize("name", TARGETS)
def test_a_packed_robot_drives_in_ros_as_evolved(
    packages: Callable[[str], Built], tmp_path: Path, name: str
) -> None:
    """The poses of all robots in all steps, and the fitness, to the bit."""
    built = packages(name)
    target = built.target
    poses, numbers = in_process(CONTROLLER, SEED)
    with contextlib.ExitStack() as running:
        here = running.enter_context(graph.private(target.link))
        if here.master:
            ask(here, "setParam", "/use_sim_time", True)
        nodes = []
        for robot in range(ROBOTS):
            nodes.append(
                running.enter_context(
                    built.started(here, target.lock_step.format(robot=f"robot_{robot}"))
                )
            )
            while (
                here.master
                and nodes[-1].poll() is None
                and ask(here, "lookupNode", f"/robot_{robot}/drive")[0] != 1
            ):
                # Two programs of roslaunch that begin at once refuse each other.
                time.sleep(0.05)
        done = simulated(here, target.profile, tmp_path / "poses.npy")
        assert done.returncode == 0, (done.stderr, [node.poll() for node in nodes])
    told = json.loads(done.stdout)
    assert [told["fitness"], *told["metrics"].values()] == numbers
    assert np.load(tmp_path / "poses.npy").tobytes() == b"".join(poses)
    assert len(set(poses)) > 10  # it moved


class Robot:
    """The scanner, the odometry and the wheels of one robot, over a link."""

    def __init__(self, link: Link) -> None:
        self._link, self._stamp_ns = link, 0
        interface = simulator(CONTROLLER).robot
        assert interface is not None
        self._interface = interface

    def sense(self, seconds: float, rays: int = 36) -> list[Velocity]:
        """Send scans and odometry as long; what came of velocities."""
        came, until = [], time.monotonic() + seconds
        first, between = scanner(self._interface)
        while time.monotonic() < until:
            self._stamp_ns += 50_000_000
            scan = Scan(
                robot=0,
                stamp_ns=self._stamp_ns,
                ranges=np.full(rays, 3.0, np.float32),
                angle_min=first,
                angle_max=first + between * (rays - 1),
                angle_increment=between,
                range_min=0.0,
                range_max=4.0,
            )
            self._link.send(
                [
                    Odometry(
                        robot=0, stamp_ns=self._stamp_ns, x=0.1, y=-1.0, z=0.0, w=1.0
                    ),
                    scan,
                ]
            )
            came += self.heard(0.05)
        return came

    def heard(self, seconds: float) -> list[Velocity]:
        """Return the velocities that arrive in that time."""
        came, until = [], time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            message = self._link.receive(left)
            if isinstance(message, Velocity):
                came.append(message)
        return came

    def drives(self, decisions: int) -> list[Velocity]:
        """Publish until this many nonzero velocities came, and return them."""
        deadline, came = time.monotonic() + DECIDES_S, list[Velocity]()
        while len(came) < decisions:
            assert time.monotonic() < deadline, f"{len(came)} of {decisions} decisions"
            came += [velocity for velocity in self.sense(0.25) if not stands(velocity)]
        return came

    def stops(self) -> None:
        """Publish nothing until the last velocity is zero, and none comes for half a second."""
        deadline, last = time.monotonic() + DECIDES_S, None
        while True:
            came = self.heard(0.5)
            last = came[-1] if came else last
            if last is not None and stands(last) and all(map(stands, came)):
                return
            assert time.monotonic() < deadline, last


def stands(velocity: Velocity) -> bool:
    return velocity.linear == 0 and velocity.angular == 0


@contextlib.contextmanager
def alone(built: Built) -> Iterator[tuple[Robot, subprocess.Popen[str]]]:
    """A robot with the node of a package."""
    target, channels = built.target, ("scan", "odometry", "velocity")
    with contextlib.ExitStack() as running:
        here = running.enter_context(graph.private(target.link))
        profile = profiles.read(target.profile)
        link = running.enter_context(
            Link(here.dialled(), profile, robots=1, side="simulation", channels=channels)
        )  # type: ignore[arg-type]  # names
        node = running.enter_context(built.started(here))
        link.ready(60)
        yield Robot(link), node


STAMPED = """
description = "velocities with a stamp"
ros = 1
distribution = "noetic"
speed = 0.3
turn = 2.0

[velocity]
name = "cmd_vel"
stamped = true
frame = 'base "link"'

[scan]
name = "scan"

[odometry]
name = "odom"
"""


@pytest.mark.parametrize("name", NODES)
def test_velocities_are_stamped_where_the_profile_says_so(
    tmp_path: Path, name: str
) -> None:
    """No velocity exceeds the profile's limits, which are below those of evolution."""
    profile = "turtlebot3-jazzy"
    if name == "cmake":
        profile = str(tmp_path / "own.toml")
        Path(profile).write_text(STAMPED)
    target = TARGETS[name]._replace(profile=profile)
    built = build(target, target.make(CONTROLLER, "of_a_test", profile), tmp_path)
    limits = profiles.read(profile)
    with alone(built) as (robot, _):
        came = robot.drives(3)
        # The time of this machine.
        assert all(velocity.stamp_ns > 1e18 for velocity in came)
        assert 0 < max(abs(velocity.linear) for velocity in came) <= limits.speed
        assert max(abs(velocity.angular) for velocity in came) <= limits.turn


@pytest.mark.parametrize("name", TARGETS)
def test_a_robot_stops_when_its_sensors_fall_silent(
    packages: Callable[[str], Built], name: str
) -> None:
    """It drives by its sensors, stops when they are silent, and when its program ends."""
    with alone(packages(name)) as (robot, node):
        robot.drives(10)
        robot.stops()
        robot.drives(1)
        node.send_signal(signal.SIGINT)
        came = robot.sense(0.2)
        said, _ = node.communicate(timeout=ENDS_S)
        assert node.returncode in (0, -signal.SIGINT), said
        came += robot.heard(2.0)
        assert came, said
        assert stands(came[-1])


@pytest.mark.parametrize("name", NODES)
def test_a_scanner_with_too_small_a_view_ends_the_drive(
    packages: Callable[[str], Built], name: str
) -> None:
    """The robot stands still afterwards."""
    with alone(packages(name)) as (robot, node):
        robot.drives(1)
        came = robot.sense(1.0, rays=20) + robot.heard(2.0)
        assert stands(came[-1])
        said, _ = node.communicate(timeout=ENDS_S)
        assert node.returncode == 1
        assert (
            "the scanner does not cover the 270 degrees that the controller needs" in said
        )


@pytest.mark.parametrize("name", NODES)
def test_a_node_whose_self_test_fails_does_not_drive(tmp_path: Path, name: str) -> None:
    target = TARGETS[name]
    files = target.make(CONTROLLER, "of_a_test", target.profile)
    table = f"_actions[16][{NAME.upper()}_OUTPUTS] = {{\n    {{"
    source = f"src/{NAME}.c"
    assert table in str(files[source])
    built = build(
        target,
        files | {source: str(files[source]).replace(table, table + "1.0f + ")},
        tmp_path,
    )
    with graph.private(target.link) as here, built.started(here) as node:
        said, _ = node.communicate(timeout=ENDS_S)
        assert node.returncode == 1
        assert f"the self-test of {NAME} fails" in said


def test_lock_step_is_refused_on_a_robot(packages: Callable[[str], Built]) -> None:
    """Nothing waits for the robot without simulated time, and the watchdog is needed."""
    for name, more in (
        ("cmake", "_lock_step:=true"),
        ("ros2", "--ros-args -p lock_step:=true"),
    ):
        built = packages(name)
        with graph.private(built.target.link) as here, built.started(here, more) as node:
            said, _ = node.communicate(timeout=ENDS_S)
            assert node.returncode == 1
            assert "lock_step: for simulations" in said


def test_without_a_compiler_a_robot_drives_in_python(tmp_path: Path) -> None:
    """It says so, and the bits are the same."""
    target = TARGETS["ros2"]
    files = target.make(CONTROLLER, "of_a_test", target.profile)
    setup = files["setup.py"]
    assert isinstance(setup, str)
    built = build(
        target,
        files | {"setup.py": setup.replace('"cc"', '"no-such-compiler"')},
        tmp_path,
    )
    assert not list(Path(built.folder).rglob("*.so"))
    with contextlib.ExitStack() as running:
        here = running.enter_context(graph.private(target.link))
        nodes = [
            running.enter_context(
                built.started(here, target.lock_step.format(robot=f"robot_{robot}"))
            )
            for robot in range(ROBOTS)
        ]
        done = simulated(here, target.profile, tmp_path / "poses.npy")
        assert done.returncode == 0, done.stderr
        nodes[0].send_signal(signal.SIGINT)
        said, _ = nodes[0].communicate(timeout=ENDS_S)
        assert "without a compiler: in Python" in said
    assert np.load(tmp_path / "poses.npy").tobytes() == b"".join(
        in_process(CONTROLLER, SEED)[0]
    )
