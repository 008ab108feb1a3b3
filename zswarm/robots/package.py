"""Packages for robots: a controller with all that a robot needs around it, as the files of a folder.

A package holds the controller as C99 and as Python, the functions through which it observed in evolution, and a node that
subscribes to a laser scan and odometry and publishes velocities. Files that are the same for all robots lie in ``templates``;
``@{word}`` in one stands for what is particular.
"""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import escape

import numpy as np

from zswarm import evaluate
from zswarm.controller import Controller
from zswarm.errors import ConfigError
from zswarm.robots import c99, fitting, gather, original, python_file, translate
from zswarm.robots.c_types import FLOAT32, FLOAT64, INT64, Array, Type, literal
from zswarm.robots.drive_checks import STEPS, drive_steps, first_and_between
from zswarm.ros import profiles
from zswarm.ros.profiles import Profile
from zswarm.sims import robot_interface
from zswarm.sims.simulator import RobotInterface

TEMPLATES = Path(__file__).parent / "templates"
WORD = re.compile(r"@\{(\w+)\}")
FITTING = "turtlebot-exit"
SILENT_STEPS = 3  # of the controller without a message at least, before the watchdog stops the robot
Types = dict[str, Type]
SCAN: Types = {"ranges": Array(FLOAT32), "readings": INT64, "angle_min": FLOAT64, "angle_increment": FLOAT64}
OWN: Types = {"rays": INT64, "view": FLOAT64, "reach": FLOAT32}  # of the scanner that a controller was evolved with
POSE: Types = {"x": FLOAT64, "y": FLOAT64, "z": FLOAT64, "w": FLOAT64}
TARGETS: Types = {"targets": Array(FLOAT64), "count": INT64}
KERNELS: list[tuple[Callable[..., Any], Types]] = [
    (robot_interface.fit_scan, SCAN | OWN | {"fitted": Array(FLOAT32)}),
    (robot_interface.observe, OWN | POSE | TARGETS | {"scan": Array(FLOAT32), "sectors": INT64, "observation": Array(FLOAT32)}),
    (robot_interface.velocity, {"share": FLOAT32, "most": FLOAT64}),
    (fitting.covers, SCAN | OWN),
    (fitting.limited, {"velocity": FLOAT64, "most": FLOAT64}),
]

Files = dict[str, str | bytes]  # path in the package's folder -> content


class Robot(NamedTuple):
    """What a package is made of."""

    name: str  # of the package: zs_ and an identifier
    controller: Controller
    interface: RobotInterface
    profile: Profile
    profile_name: str

    @property
    def speed(self) -> float:
        """m/s at most: as evolved, and as its base takes."""
        return min(self.interface.speed, self.profile.speed)

    @property
    def turn(self) -> float:
        """rad/s at most, likewise."""
        return min(self.interface.turn, self.profile.turn)

    @property
    def watchdog_s(self) -> float:
        """Silence after which it stops."""
        return round(max(self.profile.watchdog_s, SILENT_STEPS * self.interface.step_s), 6)

    @property
    def places(self) -> list[float]:
        """X, y of the first target, of the second ..., m."""
        return [float(number) for target in self.interface.targets for number in target]


def robot(controller: Controller, name: str, profile: str, ros: int) -> Robot:
    """A robot to be packed.

    Args:
        name: as ``names.folded`` gives it.
        profile: name, or path of a file.
        ros: the version that the package is for.

    Raises:
        ConfigError: the controller drives no robot with messages; the profile is unknown, wrong, or of another ROS.
    """
    simulator, _ = evaluate.build(
        controller.simulator, controller.simulator_settings, controller.representation, controller.representation_settings
    )
    if simulator.robot is None:
        raise ConfigError(
            f"{controller.simulator}: its controllers fit no robot; expected a simulator with a robot's interface: {FITTING}"
        )
    numbers = (simulator.robot.sectors + 2, 2)
    if (controller.inputs, controller.outputs) != numbers:
        raise ConfigError(
            f"{controller.simulator}: a robot gives its controller {numbers[0]} numbers and takes 2 (robot_interface.observe); "
            f"this one has {controller.inputs} inputs and {controller.outputs} outputs"
        )
    read = profiles.read(profile)
    if read.ros != ros:
        fit = ", ".join(one for one in profiles.names() if profiles.read(one).ros == ros)
        raise ConfigError(f"profile {profile}: is for ROS {read.ros}; expected one for ROS {ros}: {fit}")
    return Robot(f"zs_{name}", controller, simulator.robot, read, profile)


def words(robot: Robot) -> dict[str, str]:
    """What the words of templates stand for."""
    interface, profile, controller = robot.interface, robot.profile, robot.controller
    network, parameters = controller.network()
    first, between = first_and_between(interface)
    return {
        "check_steps": str(STEPS),
        "first": _number(first),
        "between": _number(between),
        "name": robot.name,
        "prefix": robot.name.upper(),
        "sha256": original.sha256(parameters),
        "step_s": _number(interface.step_s),
        "speed": _number(robot.speed),
        "turn": _number(robot.turn),
        "evolved_speed": _number(interface.speed),
        "evolved_turn": _number(interface.turn),
        "view": _number(interface.view),
        "degrees": f"{interface.view * 180 / math.pi:.6g}",
        "rays": str(interface.rays),
        "range": _number(interface.range),
        "reach": f"{float(np.float32(interface.range)).hex()}f",
        "sectors": str(interface.sectors),
        "targets": str(len(interface.targets)),
        "places": ", ".join(map(_number, robot.places)),
        "arrived": _number(interface.arrived),
        "watchdog_s": _number(robot.watchdog_s),
        "state": str(max(1, network.state_size)),
        "scan": profile.scan.name.replace("{i}", "0"),  # of a topic from the root: others are told to the node
        "odometry": profile.odometry.name.replace("{i}", "0"),
        "velocity": profile.velocity.name.replace("{i}", "0"),
        "frame": profile.velocity.frame,
        "stamped": str(profile.velocity.stamped),
        "twist": "TwistStamped" if profile.velocity.stamped else "Twist",
        "distribution": profile.distribution,
        "profile": _shown(robot.profile_name),
        "simulator": _shown(controller.simulator),
        "representation": _shown(controller.representation),
        "run": _shown(controller.run),
        "fitness": f"{controller.fitness:.6g}",
        "description": escape(f"A robot's controller, evolved with zswarm: {controller.simulator}, {controller.representation}"),
    }


def fill(template: str, known: dict[str, str]) -> str:
    """The text of a template, its words replaced; nothing is looked for in what replaces them."""
    text = (TEMPLATES / template).read_text(encoding="utf-8")
    return WORD.sub(lambda word: known[word[1]], text)


def c_files(robot: Robot, known: dict[str, str], folder: str) -> Files:
    """The robot in C99: controller, observation, command."""
    pair = c99.pair(robot.controller, robot.name.removeprefix("zs_"))
    checks = drive_steps(robot.controller, robot.interface, robot.speed, robot.turn)
    known = known | translate.functions(KERNELS, "interface")._asdict() | {"guards": c99.GUARDS}
    known |= {f"check_{what}": c_rows(rows) for what, rows in checks._asdict().items()}
    files = pair | {path: fill(f"c/{path}", known) for path in ("interface.h", "interface.c", "robot.h", "robot.c")}
    return {f"{folder}/{path}": text for path, text in files.items()}


def python_files(robot: Robot, known: dict[str, str]) -> Files:
    """A Python package: the robot in Python, and when it decides and stops."""
    network = python_file.python(robot.controller, robot.name.removeprefix("zs_"))[f"{robot.name}.py"]
    head = '"""The functions with which the controller was evolved, as they are."""\n\nimport numpy as np\n\n'
    files = {
        "__init__.py": "",
        "network.py": network,
        "kernels.py": head + gather.functions([kernel for kernel, _ in KERNELS]),
        "settings.py": settings(known) + checks(robot),
        **{path: (TEMPLATES / "python" / path).read_text(encoding="utf-8") for path in ("driving.py", "robot.py")},
    }
    return {f"{robot.name}/{path}": text for path, text in files.items()}


def settings(known: dict[str, str]) -> str:
    """The numbers and names of one robot, as a Python module."""
    texts = {
        "NAME": "name", "SHA256": "sha256", "SCAN_TOPIC": "scan", "ODOMETRY_TOPIC": "odometry", "VELOCITY_TOPIC": "velocity",
        "VELOCITY_FRAME": "frame", "DISTRIBUTION": "distribution",
    }  # fmt: skip
    numbers = {
        "STEP_S": "step_s", "SPEED": "speed", "TURN": "turn", "EVOLVED_SPEED": "evolved_speed", "EVOLVED_TURN": "evolved_turn",
        "VIEW": "view", "VIEW_DEGREES": "degrees", "FIRST": "first", "BETWEEN": "between", "RAYS": "rays", "RANGE": "range",
        "SECTORS": "sectors", "ARRIVED": "arrived", "WATCHDOG_S": "watchdog_s", "STATE": "state", "STAMPED": "stamped",
    }  # fmt: skip
    lines = ['"""What is particular to this robot; m, radians, s."""', ""]
    lines += [f"{constant} = {known[word]!a}" for constant, word in texts.items()]
    lines += [f"{constant} = {known[word]}" for constant, word in numbers.items()]
    lines += [f"TARGETS = ({known['places']})", ""]
    return "\n".join(lines)


def checks(robot: Robot) -> str:
    """The steps of the self-test, as Python."""
    steps = drive_steps(robot.controller, robot.interface, robot.speed, robot.turn)
    lines = [f"CHECK_{what.upper()} = {rows.tolist()}" for what, rows in steps._asdict().items()]
    return "\n".join(["", "# Steps of the self-test: scans, poses, and what is decided on them.", *lines, ""])


def c_rows(table: np.ndarray) -> str:
    """The rows of a table as C has them."""
    return ",\n".join(f"    {{{', '.join(map(literal, row))}}}" for row in table)


def _shown(text: str) -> str:
    """What others wrote, as code in a table of Markdown."""
    return re.sub(r"[`|\\<>]", " ", text).strip() or " "


def _number(number: float) -> str:
    """A decimal number with a point or an exponent, that every language reads back to the same float64."""
    return repr(float(number))
