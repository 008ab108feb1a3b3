"""Packages for robots: a controller with all that a robot needs around it, as files.

A package holds the controller as C99 and as Python, the functions through which it observed in
evolution, and a node that subscribes to a laser scan and odometry and publishes velocities. Files
that are the same for all robots are in ``templates``; each ``@{word}`` there is replaced.
"""

import math
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from zswarm import evaluate
from zswarm.champion.controller import Controller
from zswarm.errors import ConfigError
from zswarm.robots import python_file, scan_checks
from zswarm.robots.c import c99, kernel_source, translate
from zswarm.robots.c.c_types import FLOAT32, FLOAT64, INT64, Array, Type, literal
from zswarm.robots.c.quoting import (
    Code,
    c_string,
    markdown_code,
    python_literal,
    xml_text,
)
from zswarm.robots.c.reference_steps import sha256
from zswarm.robots.c.templates import fill
from zswarm.robots.drive_checks import STEPS, DriveSteps, drive_steps, first_and_between
from zswarm.robots.profiles import profile as profiles
from zswarm.sims import robot_interface
from zswarm.sims.simulator import RobotInterface

SILENT_STEPS = 3  # the watchdog waits at least this many steps for a message
Types = dict[str, Type]
Files = dict[str, str | bytes]  # path in the package's folder -> content
Words = dict[str, object]

FLOATS = Array(FLOAT32)
SCAN: Types = {
    "ranges": FLOATS,
    "readings": INT64,
    "angle_min": FLOAT64,
    "angle_increment": FLOAT64,
}
# The scanner that a controller was evolved with.
OWN: Types = {"rays": INT64, "view": FLOAT64, "reach": FLOAT32}
POSE: Types = {"x": FLOAT64, "y": FLOAT64, "z": FLOAT64, "w": FLOAT64}
TARGETS: Types = {"targets": Array(FLOAT64), "count": INT64}
SEEN: Types = {"scan": FLOATS, "sectors": INT64, "observation": FLOATS}
KERNELS: list[tuple[Callable[..., Any], Types]] = [
    (robot_interface.fit_scan, SCAN | OWN | {"fitted": FLOATS}),
    (robot_interface.observe, OWN | POSE | TARGETS | SEEN),
    (robot_interface.velocity, {"share": FLOAT32, "most": FLOAT64}),
    (scan_checks.covers, SCAN | OWN),
    (scan_checks.limited, {"velocity": FLOAT64, "most": FLOAT64}),
]
KERNELS_HEAD = '''"""The functions with which the controller was evolved, as they are."""

import numpy as np

'''
# Words that become constants of the Python package's settings.
TEXTS = "name sha256 scan_topic odometry_topic velocity_topic velocity_frame distribution".split()
NUMBERS = (
    "step_s speed turn evolved_speed evolved_turn view view_degrees first between rays range "
    "sectors arrived watchdog_s state stamped"
).split()
STAMP = "    message.header.stamp = ros::Time::now();\n    message.header.frame_id = {frame};\n"
FILL = (
    "    {twist}.linear.x = velocity.linear;\n    {twist}.angular.z = velocity.angular;"
)
# A file that needs nothing of zswarm: it is copied as it is.
OVER_ZENOH = Path(__file__).parents[1] / "ros" / "link" / "over_zenoh.py"


class NodeKind(NamedTuple):
    """A kind of package.

    Attributes:
        folder: of its templates; ``build.md`` there becomes a part of README.md.
        title: what it is for.
        ros: the version of ROS that its profiles are for.
        profile: by default.
        files: paths of files and of their templates, where {name} is ``package``.
        in_python: it has the robot in Python, too.
    """

    folder: str
    title: str
    ros: int
    profile: str
    files: tuple[str, ...]
    in_python: bool = True


CATKIN = (
    "package.xml",
    "CMakeLists.txt",
    "launch/drive.launch",
    "src/node.cpp",
    "src/driving.hpp",
)
AMENT = (
    "package.xml",
    "setup.py",
    "setup.cfg",
    "launch/drive.launch.py",
    "resource/{name}",
)
NODE = "{name}/node.py"
ROS1 = NodeKind("ros1", "ROS 1", 1, "turtlebot2", CATKIN, in_python=False)
ROS2 = NodeKind("ros2", "ROS 2", 2, "turtlebot3-jazzy", (*AMENT, NODE))
ZENOH = NodeKind(
    "zenoh", "ROS 2 over Zenoh", 2, "turtlebot3-jazzy", ("requirements.txt", NODE)
)


def package(
    kind: NodeKind, controller: Controller, name: str, profile: str | None = None
) -> Files:
    """Return the package ``zs_<name>``.

    Args:
        name: as ``folded`` gives it.
        profile: name, or path of a file; None: that of the kind.

    Raises:
        ConfigError: the controller drives no robot with messages; the profile is unknown, wrong, or
            for another version of ROS.
    """
    robot = Robot(kind, controller, name, profile or kind.profile)
    words = _words(robot) | {"target": kind.title}
    words["build"] = fill(f"{kind.folder}/build.md", words)
    files: Files = {"README.md": fill("README.md", words)}
    for path in kind.files:
        template = f"{kind.folder}/{path.format(name='package')}"
        files[path.format(name=robot.name)] = fill(template, words)
    if kind is ZENOH:
        files[f"{robot.name}/over_zenoh.py"] = OVER_ZENOH.read_text(encoding="utf-8")
    if kind.in_python:
        files |= _python_files(robot, words)
    return files | _c_files(robot, words)


ros1, ros2, zenoh = (partial(package, kind) for kind in (ROS1, ROS2, ZENOH))


class Robot:
    """The contents of a package.

    Attributes:
        name: of the package: zs_ and an identifier.
        speed: m/s at most: as evolved, and as its base takes.
        turn: rad/s at most, likewise.
        watchdog_s: silence after which it stops.
    """

    def __init__(
        self, kind: NodeKind, controller: Controller, name: str, profile: str
    ) -> None:
        self.interface = _interface(controller)
        inputs = self.interface.sectors + 2
        if (controller.inputs, controller.outputs) != (inputs, 2):
            raise ConfigError(
                f"{controller.simulator}: a robot gives its controller {inputs} numbers and takes "
                f"2 (robot_interface.observe); this one has {controller.inputs} inputs and "
                f"{controller.outputs} outputs"
            )
        self.name = f"zs_{name}"
        self.controller = controller
        self.profile_name = profile
        self.profile = profiles.read(profile)
        if self.profile.ros != kind.ros:
            fit = ", ".join(
                one for one in profiles.names() if profiles.read(one).ros == kind.ros
            )
            raise ConfigError(
                f"profile {profile}: is for ROS {self.profile.ros}; "
                f"expected one for ROS {kind.ros}: {fit}"
            )
        self.speed = min(self.interface.speed, self.profile.speed)
        self.turn = min(self.interface.turn, self.profile.turn)
        wait_s = max(self.profile.watchdog_s, SILENT_STEPS * self.interface.step_s)
        self.watchdog_s = round(wait_s, 6)

    @cached_property
    def checks(self) -> DriveSteps:
        """The steps of its self-test."""
        return drive_steps(self.interface, self.speed, self.turn)


def _interface(controller: Controller) -> RobotInterface:
    """Return how a controller drives a robot: as its file has it, else as its simulator."""
    if controller.robot is not None:
        return controller.robot
    simulator, _ = evaluate.build(
        controller.simulator,
        controller.simulator_settings,
        controller.representation,
        controller.representation_settings,
    )
    if simulator.robot is None:
        raise ConfigError(
            f"{controller.simulator}: its controllers fit no robot; expected a simulator with a "
            "robot's interface: turtlebot-exit, or one of launch files whose manifest has robot"
        )
    return simulator.robot


def _words(robot: Robot) -> Words:
    """Return what the words of templates stand for."""
    interface, profile, controller = robot.interface, robot.profile, robot.controller
    network, parameters = controller.network()
    first, between = first_and_between(interface)
    about = f"evolved with zswarm: {controller.simulator}, {controller.representation}"
    velocity = profile.velocity
    message = "message.twist" if velocity.stamped else "message"
    frame = STAMP.format(frame=c_string(velocity.frame)) if velocity.stamped else ""
    numbers = {
        "first": first,
        "between": between,
        "evolved_speed": interface.speed,
        "evolved_turn": interface.turn,
        **{
            name: getattr(interface, name)
            for name in ("step_s", "view", "range", "arrived")
        },
        **{name: getattr(robot, name) for name in ("speed", "turn", "watchdog_s")},
    }
    texts = {
        name: getattr(controller, name) for name in ("simulator", "representation", "run")
    }
    texts["profile"] = robot.profile_name
    # Topics from the root have {i}; for others the node is given a namespace.
    topics = {
        f"{channel}_topic": getattr(profile, channel).name.replace("{i}", "0")
        for channel in ("scan", "odometry", "velocity")
    }
    return topics | {
        **{name: float(number) for name, number in numbers.items()},
        **{name: markdown_code(text) for name, text in texts.items()},
        "check_steps": STEPS,
        "name": robot.name,
        "prefix": robot.name.upper(),
        "sha256": sha256(parameters),
        "view_degrees": f"{interface.view * 180 / math.pi:.6g}",
        "rays": interface.rays,
        "reach": f"{float(np.float32(interface.range)).hex()}f",
        "sectors": interface.sectors,
        "targets": len(interface.targets),
        "places": ", ".join(
            str(float(number)) for target in interface.targets for number in target
        ),
        "state": max(1, network.state_size),
        "velocity_frame": velocity.frame,
        "stamped": velocity.stamped,
        "twist": "TwistStamped" if velocity.stamped else "Twist",
        "fill": Code("c", frame + FILL.format(twist=message)),
        "distribution": profile.distribution,
        "fitness": Code("markdown", controller.in_search()),
        "description": xml_text(f"A robot's controller, {about}"),
    }


def _c_files(robot: Robot, words: Words) -> Files:
    """Return the robot in C99: controller, observation, command."""
    interface = translate.functions(KERNELS, "interface")
    checks = robot.checks._asdict().items()
    code = interface._asdict() | {"guards": c99.GUARDS}
    code |= {f"check_{name}": _c_rows(rows) for name, rows in checks}
    words = words | {name: Code("c", text) for name, text in code.items()}
    names = ("interface.h", "interface.c", "robot.h", "robot.c")
    files = c99.pair(robot.controller, robot.name.removeprefix("zs_"))
    files |= {name: fill(f"c/{name}", words) for name in names}
    return {f"src/{path}": text for path, text in files.items()}


def _c_rows(table: np.ndarray) -> str:
    return ",\n".join(f"    {{{', '.join(map(literal, row))}}}" for row in table)


def _python_files(robot: Robot, words: Words) -> Files:
    """Return a Python package: the robot in Python, and when it decides and stops."""
    network = python_file.python(robot.controller, robot.name.removeprefix("zs_"))
    files = {
        "__init__.py": "",
        "network.py": network[f"{robot.name}.py"],
        "kernels.py": KERNELS_HEAD
        + kernel_source.functions([kernel for kernel, _ in KERNELS]),
        "settings.py": _settings(robot, words),
        "driving.py": fill("python/driving.py", words),
        "robot.py": fill("python/robot.py", words),
    }
    return {f"{robot.name}/{path}": text for path, text in files.items()}


def _settings(robot: Robot, words: Words) -> str:
    """Return the numbers and names of one robot, and its self-test, as a Python module."""
    checks = robot.checks._asdict().items()
    lines = [
        '"""What is particular to this robot; m, radians, s."""',
        "",
        *(f"{word.upper()} = {python_literal(str(words[word]))}" for word in TEXTS),
        *(f"{word.upper()} = {words[word]}" for word in NUMBERS),
        f"TARGETS = ({words['places']})",
        "",
        "# Steps of the self-test: scans, poses, what is observed; actions, decisions.",
        *(f"CHECK_{name.upper()} = {rows.tolist()}" for name, rows in checks),
        "",
    ]
    return "\n".join(lines)
