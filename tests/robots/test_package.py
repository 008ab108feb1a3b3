"""Packages for robots: what is in them, and that what they compute is what evolved."""

import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest

from tests.repository import REPOSITORY
from tests.robots.packed import (
    evolved,
    in_process,
    load,
    played,
    scanner,
    simulator,
    write,
)
from zswarm.errors import ConfigError
from zswarm.robots.package import Files, ros1, ros2, zenoh
from zswarm.ros.launch import controller_files

TARGETS: dict[str, tuple[Callable[..., Files], str]] = {
    "ros1": (ros1, "stageros"),
    "ros2": (ros2, "stage_ros2"),
    "zenoh": (zenoh, "stage_ros2"),
}
FLAGS = [
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Werror",
    "-pedantic",
    "-fPIC",
    "-shared",
]


def compiled(folder: Path, name: str) -> None:
    """Compile the robot into its Python package, strictly."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here: apt-get install gcc")
    sources = [
        str(folder / "src" / file) for file in ("robot.c", "interface.c", f"{name}.c")
    ]
    subprocess.run(
        ["cc", *FLAGS, "-o", str(folder / name / "librobot.so"), *sources, "-lm"],
        check=True,
    )


@pytest.mark.parametrize("how", ["compiled", "plain"])
def test_a_packed_robot_drives_as_evolved(tmp_path: Path, how: str) -> None:
    """The poses of all robots in all steps, and the fitness, to the bit; in C and in Python."""
    controller = evolved(robots=3, steps=40, map="open")
    write(ros2(controller, "of_a_test", "stage_ros2"), tmp_path)
    if how == "compiled":
        compiled(tmp_path, "zs_of_a_test")
    robot, driving = load(tmp_path, "zs_of_a_test", "robot", "driving")
    world = simulator(controller)
    built = [robot.build() for _ in range(world.settings.robots)]
    assert {type(one).__name__.lower() for one, _ in built} == {how}
    angles = scanner(world.robot)

    def decide(step: int, number: int) -> tuple[float, float]:
        pose = driving.Pose(step, *world.poses[number].tolist())
        decision = built[number][0].step(
            driving.Scan(step, world.scans[number], *angles), pose
        )
        return decision.linear, decision.angular

    assert played(world, 7, decide) == in_process(controller, 7)


def test_a_scanner_with_too_small_a_view_decides_nothing(tmp_path: Path) -> None:
    controller = evolved()
    write(ros2(controller, "x", "stage_ros2"), tmp_path)
    robot, driving = load(tmp_path, "zs_x", "robot", "driving")
    (plain, _), pose = robot.build(), driving.Pose(0, 0.0, 0.0, 0.0, 1.0)
    compiled(tmp_path, "zs_x")
    (in_c, _) = robot.build()
    assert in_c.how != plain.how
    for count, first, increment, sees in (
        (360, 0.0, np.pi / 180, True),  # all around, from ahead
        (360, -np.pi, np.pi / 180, True),
        (270, 0.75 * np.pi, -np.pi / 180, True),  # upside down
        (640, -0.5, 1 / 639, False),  # a depth camera
        (180, 0.0, np.pi / 180, False),
        (1, 0.0, 0.1, False),
        (0, 0.0, 0.1, False),
        (360, float("nan"), 0.1, False),
        (360, 0.0, float("inf"), False),
    ):
        scan = driving.Scan(0, np.full(count, 2.0, np.float32), first, increment)
        assert (plain.step(scan, pose) is not None) == sees, (count, first)
        assert (in_c.step(scan, pose) is not None) == sees, (count, first)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"speed": 0.7}, "speed: expected 0 to 0.65, not 0.7"),
        ({"turn": -0.1}, "turn: expected 0 to 3.14, not -0.1"),
        ({"speed": float("nan")}, "speed: expected 0 to 0.65, not nan"),
        ({"targets": [1.0, 2.0]}, "targets: expected 4 numbers"),
        ({"targets": [1.0, 2.0, 3.0, float("inf")]}, "targets: expected 4 numbers"),
    ],
)
def test_no_parameter_raises_a_limit(
    tmp_path: Path, given: dict[str, Any], expected: str
) -> None:
    write(ros2(evolved(), "x", "stage_ros2"), tmp_path)
    (robot,) = load(tmp_path, "zs_x", "robot")
    with pytest.raises(ValueError, match=expected):
        robot.build(**given)


def test_a_robot_is_never_faster_than_evolved_nor_than_its_base(tmp_path: Path) -> None:
    """A burger's base takes .22 m/s: the controller, which was evolved with .65, is cut to that."""
    write(ros2(evolved(), "x", "turtlebot3-jazzy"), tmp_path)
    settings, robot, driving = load(tmp_path, "zs_x", "settings", "robot", "driving")
    assert (settings.SPEED, settings.TURN) == (0.22, 2.84)
    compiled(tmp_path, "zs_x")
    for one in (robot.build()[0], robot.Plain(np.array(settings.TARGETS), 0.1, 0.2)):
        most = (0.22, 2.84) if one.how == "compiled" else (0.1, 0.2)
        stream, angles = np.random.default_rng(1), scanner(simulator(evolved()).robot)
        for step in range(200):
            scan = driving.Scan(
                step, stream.uniform(0, 5, 36).astype(np.float32), *angles
            )
            decision = one.step(
                scan, driving.Pose(step, *stream.uniform(-3, 3, 4).tolist())
            )
            assert abs(decision.linear) <= most[0]
            assert abs(decision.angular) <= most[1]


@pytest.mark.parametrize(
    ("file", "true", "false"),
    [
        ("zs_x/network.py", 'SHA256 = "', 'SHA256 = "0'),  # the parameters are others
        ("zs_x/kernels.py", "return distance", "return distance + 1e-15 * (x > 0)"),
        (
            "src/zs_x.c",
            "_actions[16][ZS_X_OUTPUTS] = {\n    {",
            "_actions[16][ZS_X_OUTPUTS] = {\n    {1.0f + ",
        ),
        ("src/interface.c", "fabs(angle_increment);", "0.5 * fabs(angle_increment);"),
    ],
)
def test_a_self_test_that_fails_refuses_to_drive(
    tmp_path: Path, file: str, true: str, false: str
) -> None:
    """The controller or the code around it computes other numbers, in Python or C."""
    files = ros2(evolved(), "x", "stage_ros2")
    text = str(files[file])
    assert true in text
    write(files | {file: text.replace(true, false)}, tmp_path)
    if file.startswith("src"):
        compiled(tmp_path, "zs_x")
    (robot,) = load(tmp_path, "zs_x", "robot")
    with pytest.raises(ValueError, match="the self-test of zs_x fails"):
        robot.build()


def test_a_robot_tests_and_drives_another_controller_of_its_interface(
    tmp_path: Path,
) -> None:
    """As the file route writes each candidate into an exported package."""
    write(ros1(evolved(), "candidate", "stageros"), tmp_path)
    files = controller_files.written(evolved(seed=9), "c99", "src/zs_candidate.c")
    exact, source = selftest(write(files, tmp_path)), files["src/zs_candidate.c"]
    table = "_actions[16][ZS_CANDIDATE_OUTPUTS] = {\n    {"
    assert table in source
    write({"src/zs_candidate.c": source.replace(table, table + "1.0f + ")}, tmp_path)
    assert (exact, selftest(tmp_path)) == (0, 1)


def selftest(folder: Path) -> int:
    """Compile a robot strictly; return what its self-test does."""
    (folder / "zs_candidate").mkdir(exist_ok=True)
    compiled(folder, "zs_candidate")
    run = f"""import ctypes
print(ctypes.CDLL({str(folder / "zs_candidate" / "librobot.so")!r}).robot_selftest())"""
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, check=True)
    return int(done.stdout)


@pytest.mark.parametrize("target", TARGETS)
def test_packages_are_the_same_each_time(target: str) -> None:
    make, profile = TARGETS[target]
    assert make(evolved(), "x", profile) == make(evolved(), "x", profile)


@pytest.mark.parametrize("target", TARGETS)
def test_no_placeholder_remains_and_all_files_are_well_formed(target: str) -> None:
    make, profile = TARGETS[target]
    for path, content in make(evolved(), "x", profile).items():
        assert isinstance(content, str)
        assert "@{" not in content, path
        match Path(path).suffix:
            case ".py":
                compile(content, path, "exec")
            case ".xml" | ".launch":
                ElementTree.fromstring(content)  # noqa: S314  our own
            case ".c" | ".h" | ".cpp" | ".hpp":
                assert content.isascii(), path
                assert content.count("{") == content.count("}"), path
        assert not path.startswith("/")
        assert ".." not in path


@pytest.mark.parametrize("target", TARGETS)
def test_foreign_texts_stay_text(target: str, tmp_path: Path) -> None:
    """Names that would end a comment, a string, a tag or a cell."""
    make, profile = TARGETS[target]
    hostile = '*/ ]]> </description> """ `|` @{name} \\" ??/ ${x} ü'
    controller = evolved()
    worse = msgspec.structs.replace(
        controller,
        run=hostile,
        sensors=[hostile] * controller.inputs,
        actuators=[hostile] * controller.outputs,
    )
    files = make(worse, "x", profile)
    for path, content in files.items():
        assert isinstance(content, str)
        if path.endswith(".py"):
            compile(content, path, "exec")
        if path.endswith((".xml", ".launch")):
            ElementTree.fromstring(content)  # noqa: S314  our own
    write(files, tmp_path)
    (tmp_path / "zs_x").mkdir(exist_ok=True)
    compiled(tmp_path, "zs_x")
    table = next(
        line
        for line in str(files["README.md"]).splitlines()
        if line.startswith("| evolved in")
    )
    assert table.count("|") == 3
    assert table.count("`") == 4


def test_controllers_that_fit_no_robot_are_refused_in_one_line() -> None:
    from tests.robots.controllers import controller

    with pytest.raises(
        ConfigError,
        match=r"minisim: its controllers fit no robot; expected .* turtlebot-exit",
    ):
        ros1(controller("fully-meshed"), "x")
    with pytest.raises(
        ConfigError,
        match=r"10 numbers and takes 2 .*; this one has 11 inputs and 2 outputs",
    ):
        ros1(msgspec.structs.replace(evolved(), inputs=11), "x")
    with pytest.raises(
        ConfigError,
        match=r"profile stageros: is for ROS 1; expected one for ROS 2: .*stage_ros2",
    ):
        ros2(evolved(), "x", "stageros")
    with pytest.raises(
        ConfigError,
        match=r"profile stage_ros2: is for ROS 2; expected one for ROS 1: .*stageros",
    ):
        ros1(evolved(), "x", "stage_ros2")
    with pytest.raises(ConfigError, match="no profile 'turtlebot'"):
        zenoh(evolved(), "x", "turtlebot")


def test_templates_are_in_the_wheel() -> None:
    """All that lies below the package is packed; nothing there is ignored."""
    root = REPOSITORY
    config = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["hatch"][
        "build"
    ]["targets"]["wheel"]
    assert config["packages"] == ["zswarm"]
    templates = [
        str(path)
        for path in (root / "zswarm/robots/templates").rglob("*")
        if path.is_file()
    ]
    ignored = subprocess.run(
        ["git", "-C", str(root), "check-ignore", *templates],
        capture_output=True,
        text=True,
        check=False,
    ).stdout.splitlines()
    assert not [path for path in ignored if "__pycache__" not in path]
