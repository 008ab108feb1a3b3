"""The formats that a controller can be exported to, as a table."""

import importlib
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from zswarm.champion.controller import Controller
from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError
from zswarm.robots.c.c_types import folded

# By path in a folder; what begins with #! is made executable.
Files = dict[str, str | bytes]


class Target(NamedTuple):
    """A format.

    Attributes:
        make: module and function that returns the files of a controller with a name.
        command: compiles, reads or checks the files; {name} is their name, {macro} the prefix of
            C's macros.
        driving: it drives a robot, and takes the profile of that.
        simulator: the only one whose controllers it takes; empty: any.
    """

    make: str
    command: str
    driving: bool = False
    simulator: str = ""


C99 = (
    "cc -std=c99 -O2 -D{macro}_MAIN {name}.c -lm -o {name} && ./{name} && echo same bits"
)
PACKAGE = "zswarm.robots.package"
TARGETS = {
    "argos": Target(
        "zswarm.robots.argos.files:files", "cat {name}.argos", simulator="epuck"
    ),
    "c99": Target("zswarm.robots.c.c99:pair", C99),
    "json": Target("zswarm.robots.json_file:as_json", "python3 -m json.tool {name}.json"),
    "onnx": Target(
        "zswarm.robots.onnx.file:model", "python3 -m onnx.checker {name}.onnx"
    ),
    "python": Target("zswarm.robots.python_file:python", "python3 {name}.py"),
    "ros1": Target(f"{PACKAGE}:ros1", "cat README.md", driving=True),
    "ros2": Target(f"{PACKAGE}:ros2", "cat README.md", driving=True),
    "zenoh": Target(f"{PACKAGE}:zenoh", "cat README.md", driving=True),
}


def known(target: str) -> None:
    """Check the name of a target.

    Raises:
        ConfigError: there is no such target; the text names those that exist.
    """
    if target not in TARGETS:
        hint = f"{nearest(target, TARGETS)}; known are: {', '.join(TARGETS)}"
        raise ConfigError(f"--to {target}: unknown target{hint}")


def on(target: str, name: str, folder: Path) -> str:
    """Return the command that compiles, reads or checks exported files in a folder."""
    command = TARGETS[target].command.format(
        name=f"zs_{name}", macro=f"ZS_{name.upper()}"
    )
    return f"cd {shlex.quote(str(folder))} && {command}"


def files(
    target: str, controller: Controller, name: str, profile: str | None = None
) -> Files:
    """Return the files of a controller.

    Args:
        name: any; files are named by ``folded`` of it.
        profile: of the robot to drive, its name or file; None: the target's default.

    Raises:
        ConfigError: there is no such target, the profile is for one that drives no robot, or the
            controller cannot be exported to it.
    """
    known(target)
    module, function = TARGETS[target].make.split(":")
    make: Callable[..., Files] = getattr(importlib.import_module(module), function)
    if profile is None:
        return make(controller, folded(name))
    if not TARGETS[target].driving:
        driving = ", ".join(name for name, one in TARGETS.items() if one.driving)
        raise ConfigError(
            f"--profile {profile}: {target} drives no robot; a profile is for {driving}"
        )
    return make(controller, folded(name), profile)
