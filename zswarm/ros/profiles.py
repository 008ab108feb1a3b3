"""Profiles: names, types and limits of robots' topics, as TOML files (docs/profiles.md). Imports leaves only."""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from zswarm import strict, toml_line
from zswarm.errors import ConfigError
from zswarm.nearest import nearest

FOLDER = Path(__file__).parent / "profiles"
Channel = Literal["velocity", "scan", "odometry", "ground_truth", "clock", "reset"]
CHANNELS: tuple[Channel, ...] = ("velocity", "scan", "odometry", "ground_truth", "clock", "reset")
SHARED = ("clock", "reset")  # one for all robots

# ROS: a letter first, then letters, digits and underscores, between slashes; {i} is the robot's number, from 0.
NAME = r"^/?[A-Za-z]([A-Za-z0-9_]|\{i\})*(/[A-Za-z]([A-Za-z0-9_]|\{i\})*)*$"
Name = Annotated[str, Meta(pattern=NAME, max_length=200)]
Positive = Annotated[float, Meta(gt=0, le=1e3)]


class Topic(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A topic of each robot, or of the simulation."""

    name: Annotated[Name, Meta(description="below the robot's namespace, or from the root where it begins with a slash")]
    reliable: Annotated[bool, Meta(description="ROS 2: reliable; false: best effort, as sensors often are")] = True
    frame: Annotated[str, Meta(description="frame of its header", max_length=200)] = ""
    child_frame: Annotated[str, Meta(description="of odometry: the robot's frame", max_length=200)] = ""


class VelocityTopic(Topic, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where velocities go."""

    stamped: Annotated[bool, Meta(description="TwistStamped rather than Twist")] = False


class ResetTopic(Topic, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a trial begins."""

    service: Annotated[bool, Meta(description="a service without arguments (std_srvs/Empty), not a topic with the seed")] = False


class Profile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A kind of robot, or of simulation."""

    description: Annotated[str, Meta(description="one line", max_length=200)]
    ros: Annotated[Literal[1, 2], Meta(description="1 or 2")]
    distribution: Annotated[str, Meta(description="of ROS: noetic, humble, jazzy", pattern="^[a-z]{3,20}$")]
    source: Annotated[str, Meta(description="where the names are from")] = ""
    tested: Annotated[str, Meta(description="with what it was tested")] = ""
    namespace: Annotated[Name, Meta(description="of a robot among several; one alone has none")] = "robot_{i}"
    frame_prefix: Annotated[str, Meta(description="before frames of a robot among several", max_length=200)] = ""
    speed: Annotated[Positive, Meta(description="m/s that its base takes at most")]
    turn: Annotated[Positive, Meta(description="rad/s that its base takes at most")]
    watchdog_s: Annotated[
        Positive,
        Meta(description="s after which a robot that hears no scan is stopped, and one in a simulation that hears no velocity"),
    ] = 1.0
    velocity: VelocityTopic
    scan: Topic
    odometry: Topic
    ground_truth: Annotated[Topic | None, Meta(description="poses from the simulation itself")] = None
    clock: Annotated[Topic | None, Meta(description="the simulation's time")] = None
    reset: ResetTopic = ResetTopic(name="/zswarm/reset")

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Those that it has."""
        return tuple(channel for channel in CHANNELS if getattr(self, channel) is not None)

    def topic(self, channel: Channel, robot: int, robots: int) -> str:
        """The whole name of a robot's topic, from the root.

        Args:
            robot: its number, from 0.
            robots: how many there are; one alone has no namespace.

        Raises:
            ValueError: the profile has no such topic.
        """
        found: Topic | None = getattr(self, channel)
        if found is None:
            raise ValueError(f"the profile has no {channel}")
        name = found.name
        if not name.startswith("/") and channel not in SHARED and robots > 1:
            name = f"{self.namespace}/{name}"
        return "/" + name.replace("{i}", str(robot)).lstrip("/")

    def frame(self, frame: str, robot: int, robots: int) -> str:
        """A frame of the profile, as that of a robot."""
        return self.frame_prefix.replace("{i}", str(robot)) + frame if frame and robots > 1 else frame


def names() -> list[str]:
    """Bundled profiles."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def read(name: str) -> Profile:
    """A bundled profile by its name, or one's own by the path of its file, which ends in ``.toml``.

    Raises:
        ConfigError: there is none, or something in it is unknown, missing or impossible: file, line and what was expected.
    """
    if not name.endswith(".toml"):
        if name not in names():
            known = ", ".join(names())
            raise ConfigError(f"no profile {name!r}{nearest(name, names())}; there are {known}, or a path to FILE.toml")
        return _read(FOLDER / f"{name}.toml")
    return _read(Path(name))


def _read(path: Path) -> Profile:
    mapping = strict.read(path)
    try:
        return strict.convert(mapping, Profile, str(path))
    except ConfigError as error:
        line = toml_line.find(path.read_text(encoding="utf-8"), error.path)
        if line is None:
            raise
        raise ConfigError(f"{path}, line {line}{str(error).removeprefix(str(path))}", error.path) from None
