"""Manifests: TOML files that make programs of this machine simulators (docs/foreign.md).

``NAME.toml`` describes the simulator of that name: a program, or a launch file of a ROS package
(docs/ros-files.md). Only these files, written by the machine's user or administrator, decide what
is run: no message on the wire names a command.
"""

import contextlib
import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import platformdirs
from msgspec import Meta

from zswarm.config import decode
from zswarm.errors import ConfigError

SYSTEM = Path("/etc/zswarm")
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")
Texts = Annotated[list[str], Meta(min_length=1)]
Count = Annotated[int, Meta(ge=1, le=100_000)]
Limit = Annotated[float, Meta(gt=0, le=86400)]  # seconds
# A path in a package.
Inside = Annotated[str, Meta(pattern=r"^(?!/|.*(^|/)\.\.(/|$)).+$")]
Positive = Annotated[float, Meta(gt=0, le=1e4)]
Place = tuple[
    Annotated[float, Meta(ge=-1e6, le=1e6)], Annotated[float, Meta(ge=-1e6, le=1e6)]
]
RosName = Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
SettingName = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,62}$")]


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The manifest of a program; paths are relative to its folder."""

    command: Texts  # and its arguments
    files: Texts  # that determine the results: the version hash covers them
    description: str = ""  # one line, for zswarm-ot list


class LaunchTarget(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The target of a value: an argument of roslaunch, or a key of a YAML file of the package."""

    argument: RosName | None = None
    file: Inside | None = None
    key: RosName | None = None

    def __post_init__(self) -> None:
        in_file = self.file is not None
        if in_file != (self.key is not None) or in_file == (self.argument is not None):
            raise ValueError("expected argument, or file and key")


class PlacedSetting(LaunchTarget, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A key of ``[problem.settings]``; the default determines its type."""

    default: int | float | bool | str
    description: str = ""
    minimum: int | float | None = None  # of a number
    maximum: int | float | None = None
    choices: list[str] = []  # of a string; empty: any


class ControllerFile(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """How a candidate's controller is written to the package."""

    form: Literal["yaml", "json", "c99"]
    file: Inside
    # A command, run in the package before each trial, without a shell.
    rebuild: list[str] = []
    limit_s: Limit = 600.0  # for the command


class DrivenRobot(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a controller's numbers come from a robot's messages, as in turtlebot-exit.

    It observes the laser scan in sectors, two numbers less than it has inputs, and the direction
    of the nearest target; it sets shares of the highest speed and turning rate.
    """

    rays: Annotated[int, Meta(ge=2, le=100_000)]
    view: Annotated[float, Meta(gt=0, le=360)]  # degrees from the first ray to the last
    range: Positive  # m
    targets: Annotated[list[Place], Meta(min_length=1, max_length=10_000)]  # m: x, y
    arrived: Annotated[float, Meta(ge=0, le=1e6)]  # m from a target
    speed: Positive  # m/s at most
    turn: Positive  # rad/s at most
    step_s: Positive  # between decisions
    radius: Positive  # m


class LaunchManifest(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """The manifest of a launch file."""

    # A folder next to this file, or known to ROS.
    package: Annotated[str, Meta(min_length=1)]
    launch: Inside
    files: Texts  # as in Manifest
    description: str = ""
    inputs: Annotated[int, Meta(ge=0, le=100_000)]  # numbers in a robot's observation
    outputs: Count  # numbers in its action
    sensors: list[str] = []
    actuators: list[str] = []
    robots: Count | str  # how many, or the setting for it
    robot: DrivenRobot | None = None  # for exports that drive one
    controller: ControllerFile
    seed: LaunchTarget | None = None  # of a trial; None: the world takes none
    repeatable: bool = True  # the same candidate and seed have the same fitness
    logs: Inside = "log"  # folder of the robots' logs
    # Default.
    fitness: Literal["last-distance", "cpswarm-log", "command"] = "last-distance"
    command: list[str] = []  # of the fitness "command"
    command_limit_s: Limit = 60.0
    settings: dict[SettingName, PlacedSetting] = {}
    arguments: dict[RosName, str] = {}  # fixed ones, of roslaunch
    # Fixed ones, by YAML file of the package.
    parameters: dict[Inside, dict[RosName, Any]] = {}


def find() -> dict[str, Path]:
    """Return the manifests of this machine by simulator; the first of a name wins."""
    return files_in("simulators")


def files_in(kind: str) -> dict[str, Path]:
    """Return the TOML files of this machine in folders of a kind by name; the first wins."""
    found: dict[str, Path] = {}
    for folder in _folders(kind):
        for path in sorted(folder.glob("*.toml")):
            if NAME.fullmatch(path.stem):
                found.setdefault(path.stem, path.absolute())
    return found


def read(path: Path) -> Manifest | LaunchManifest:
    """Read a manifest."""
    mapping = decode.read(path)
    kind: type[Manifest | LaunchManifest] = (
        LaunchManifest if "package" in mapping else Manifest
    )
    manifest = decode.convert(mapping, kind, str(path))
    for name in manifest.files:
        if not (path.parent / name).is_file():
            raise ConfigError(
                f"{path}: files: {path.parent / name} is missing, or not a file"
            )
    return manifest


def launches(path: Path) -> bool:
    """Return whether a manifest is readable and of a launch file."""
    with contextlib.suppress(ConfigError):
        return "package" in decode.read(path)
    return False


def files(path: Path) -> list[Path]:
    """Return a manifest and the files it names, for the version hash; only it if not usable."""
    try:
        return [path, *(path.parent / name for name in read(path).files)]
    except ConfigError:
        return [path] if path.is_file() else []


def _folders(kind: str) -> list[Path]:
    if folders := os.environ.get(f"ZSWARM_{kind.upper()}"):
        return [Path(folder) for folder in folders.split(os.pathsep) if folder]
    with contextlib.suppress(RuntimeError):  # the user has no home
        return [Path(platformdirs.user_config_dir("zswarm"), kind), SYSTEM / kind]
    return [SYSTEM / kind]
