"""Manifests: small TOML files that say which programs of this machine are simulators (docs/foreign.md, docs/ros-files.md).

``NAME.toml`` makes a simulator of that name: of a program, or of a launch file of a ROS package. What runs is decided here alone,
by files that the machine's user or administrator put there: nothing that comes over the wire names a command.
"""

import contextlib
import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import platformdirs
from msgspec import Meta

from zswarm import strict
from zswarm.errors import ConfigError

SYSTEM = Path("/etc/zswarm/simulators")
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What ``NAME.toml`` says of a program; paths are relative to its folder."""

    command: Annotated[list[str], Meta(min_length=1)]  # and its arguments
    files: Annotated[list[str], Meta(min_length=1)]  # what decides the program's results: the version hash covers them
    description: str = ""  # one line, for zswarm-ot list


Inside = Annotated[str, Meta(pattern=r"^(?!/|.*(^|/)\.\.(/|$)).+$")]  # a path in a package
RosName = Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]


class Place(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a value goes: to an argument of roslaunch, or under a key of a YAML file of the package."""

    argument: RosName | None = None
    file: Inside | None = None
    key: RosName | None = None

    def __post_init__(self) -> None:
        if (self.argument is None) == (self.file is None) or (self.file is None) != (self.key is None):
            raise ValueError("expected argument, or file and key")


class PlacedSetting(Place, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A key of ``[problem.settings]``; its type is that of the default."""

    default: int | float | bool | str
    description: str = ""
    minimum: int | float | None = None  # of a number
    maximum: int | float | None = None
    choices: list[str] = []  # of a text; empty: any


class ControllerFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a candidate's controller comes into the package."""

    form: Literal["yaml", "json", "c99"]
    file: Inside
    rebuild: list[str] = []  # a program and its arguments, run in the package before each trial; no shell
    limit_s: Annotated[float, Meta(gt=0, le=86400)] = 600.0  # that it may take


class LaunchManifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What ``NAME.toml`` says of a launch file."""

    package: Annotated[str, Meta(min_length=1)]  # a folder beside this file, or the name of a package that ROS knows
    launch: Inside
    files: Annotated[list[str], Meta(min_length=1)]  # as of a program
    description: str = ""
    inputs: Annotated[int, Meta(ge=0, le=100_000)]  # numbers that a robot observes
    outputs: Annotated[int, Meta(ge=1, le=100_000)]  # and sets, in one decision
    sensors: list[str] = []
    actuators: list[str] = []
    robots: Annotated[int, Meta(ge=1, le=100_000)] | str  # how many, or the setting that says it
    controller: ControllerFile
    seed: Place | None = None  # where a trial's seed goes; None: the world takes none, and is not repeatable
    repeatable: bool = True  # the same candidate and seed have the same fitness
    logs: Inside = "log"  # folder of the robots' logs
    fitness: Literal["last-distance", "cpswarm-log", "command"] = "last-distance"  # unless the experiment says otherwise
    command: list[str] = []  # of the fitness "command"
    command_limit_s: Annotated[float, Meta(gt=0, le=86400)] = 60.0
    settings: dict[Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,62}$")], PlacedSetting] = {}
    arguments: dict[RosName, str] = {}  # of roslaunch, that stay
    parameters: dict[Inside, dict[RosName, Any]] = {}  # YAML files of the package, with what stays in them


def find() -> dict[str, Path]:
    """The manifests of this machine by the names of their simulators; of two of a name the first."""
    found: dict[str, Path] = {}
    for folder in _folders():
        for path in sorted(folder.glob("*.toml")):
            if NAME.fullmatch(path.stem):
                found.setdefault(path.stem, path.absolute())
    return found


def read(path: Path) -> Manifest | LaunchManifest:
    """What a manifest says.

    Raises:
        ConfigError: it cannot be read, or something in it is unknown, missing or impossible.
    """
    said = strict.read(path)
    kind: type[Manifest | LaunchManifest] = LaunchManifest if "package" in said else Manifest
    manifest = strict.convert(said, kind, str(path))
    for name in manifest.files:
        if not (path.parent / name).is_file():
            raise ConfigError(f"{path}: files: {path.parent / name} is not there, or no file")
    return manifest


def launches(path: Path) -> bool:
    """Whether it is a launch file's, as far as it can be read."""
    with contextlib.suppress(ConfigError):
        return "package" in strict.read(path)
    return False


def files(path: Path) -> list[Path]:
    """A manifest and the files that it names, for the version hash; where it cannot be used, it alone."""
    try:
        return [path, *(path.parent / name for name in read(path).files)]
    except ConfigError:
        return [path] if path.is_file() else []


def _folders() -> list[Path]:
    if told := os.environ.get("ZSWARM_SIMULATORS"):
        return [Path(folder) for folder in told.split(os.pathsep) if folder]
    folders = [SYSTEM]
    with contextlib.suppress(RuntimeError):  # nobody knows where this user is at home
        folders.insert(0, Path(platformdirs.user_config_dir("zswarm"), "simulators"))
    return folders
