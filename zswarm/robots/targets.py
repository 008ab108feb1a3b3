"""What a controller can be exported to: the one place that knows all targets."""

import importlib
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from zswarm.controller import Controller
from zswarm.errors import ConfigError
from zswarm.nearest import nearest
from zswarm.robots import names

Files = dict[str, str | bytes]  # texts and bytes by their paths in a folder; what begins with #! can be run


class Target(NamedTuple):
    """One of them.

    Attributes:
        make: module and function that gives the files of a controller under a name.
        on: the command that compiles, reads or checks them where they are, with the file's name for {name}.
        driving: it drives a robot, of which it takes a profile.
    """

    make: str
    on: str
    driving: bool = False


TARGETS = {
    "c99": Target("zswarm.robots.c99:pair", "cc -std=c99 -O2 -D{macro}_MAIN {name}.c -lm -o {name} && ./{name}"),
    "json": Target("zswarm.robots.json_file:as_json", "python3 -m json.tool {name}.json"),
    "onnx": Target("zswarm.robots.onnx_file:model", "python3 -m onnx.checker {name}.onnx"),
    "python": Target("zswarm.robots.python_file:python", "python3 {name}.py"),
}


def known(target: str) -> None:
    """Refuse a target that there is not.

    Raises:
        ConfigError: naming those that there are.
    """
    if target not in TARGETS:
        raise ConfigError(f"--to {target}: unknown target{nearest(target, TARGETS)}; known are: {', '.join(TARGETS)}")


def on(target: str, name: str, folder: Path) -> str:
    """What to type to compile, read or check the files of a controller that were written to a folder."""
    return f"cd {shlex.quote(str(folder))} && {TARGETS[target].on.format(name=f'zs_{name}')}"


def files(target: str, controller: Controller, name: str, profile: str | None = None) -> Files:
    """The files of a controller.

    Args:
        name: any; files are named by ``names.folded`` of it.
        profile: of the robot that is to be driven, its name or file; None: the target's own.

    Raises:
        ConfigError: no such target, one that drives no robot and a profile, or a controller that it cannot be made of.
    """
    known(target)
    module, function = TARGETS[target].make.split(":")
    make: Callable[..., Files] = getattr(importlib.import_module(module), function)
    if profile is None:
        return make(controller, names.folded(name))
    if not TARGETS[target].driving:
        driving = ", ".join(name for name, one in TARGETS.items() if one.driving)
        raise ConfigError(f"--profile {profile}: {target} drives no robot; a profile is for {driving or 'none of the targets'}")
    return make(controller, names.folded(name), profile)
