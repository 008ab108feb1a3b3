"""Profiles: names, types and limits of robots' topics, as TOML files; see docs/profiles.md."""

from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from zswarm.config import decode as strict
from zswarm.config import toml_lines as toml_line
from zswarm.config.meta import about
from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError

FOLDER = Path(__file__).parent
Channel = Literal["velocity", "scan", "odometry", "ground_truth", "clock", "reset"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)
SHARED = ("clock", "reset")  # one for all robots

# ROS: a letter, then letters, digits and underscores, between slashes; {i} is a robot's number.
NAME = r"^/?[A-Za-z]([A-Za-z0-9_]|\{i\})*(/[A-Za-z]([A-Za-z0-9_]|\{i\})*)*$"
Name = Annotated[str, Meta(pattern=NAME, max_length=200)]
Positive = Annotated[float, Meta(gt=0, le=1e3)]


class Topic(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A topic of each robot, or of the simulation."""

    name: Annotated[
        Name, about("in the robot's namespace; with a slash first, from the root")
    ]
    reliable: Annotated[
        bool, about("of ROS 2; false: best effort, as sensors often are")
    ] = True
    frame: Annotated[str, about("frame in its header", max_length=200)] = ""
    child_frame: Annotated[
        str, about("of odometry: the robot's frame", max_length=200)
    ] = ""


class VelocityTopic(Topic, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The topic for velocities."""

    stamped: Annotated[bool, about("TwistStamped rather than Twist")] = False


class ResetTopic(Topic, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The topic or service that begins a trial."""

    service: Annotated[
        bool, about("a service (std_srvs/Empty), not a topic with the seed")
    ] = False


class Profile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A kind of robot, or of simulation."""

    description: Annotated[str, about("one line", max_length=200)]
    ros: Annotated[Literal[1, 2], about("1 or 2")]
    distribution: Annotated[
        str, about("of ROS: noetic, humble, jazzy", pattern="^[a-z]{3,20}$")
    ]
    source: Annotated[str, about("where the names are from")] = ""
    tested: Annotated[str, about("what it was tested with")] = ""
    namespace: Annotated[
        Name, about("of a robot among several; a single one has none")
    ] = "robot_{i}"
    frame_prefix: Annotated[
        str, about("of frames of a robot among several", max_length=200)
    ] = ""
    speed: Annotated[Positive, about("m/s that its base can do")]
    turn: Annotated[Positive, about("rad/s that its base can do")]
    watchdog_s: Annotated[
        Positive, about("s without a scan or velocity until a robot stops")
    ] = 1.0
    velocity: VelocityTopic
    scan: Topic
    odometry: Topic
    ground_truth: Annotated[Topic | None, about("poses from the simulation")] = None
    clock: Annotated[Topic | None, about("the simulation's time")] = None
    reset: ResetTopic = ResetTopic(name="/zswarm/reset")

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels that it has."""
        return tuple(
            channel for channel in CHANNELS if getattr(self, channel) is not None
        )

    def topic(self, channel: Channel, robot: int, robots: int) -> str:
        """Return the whole name of a robot's topic, from the root.

        Args:
            robot: its number, from 0.
            robots: their number; a single one has no namespace.

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
        """Return a frame of the profile as that of a robot."""
        prefix = (
            self.frame_prefix.replace("{i}", str(robot)) if frame and robots > 1 else ""
        )
        return prefix + frame


def names() -> list[str]:
    """Return the names of bundled profiles."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def read(name: str) -> Profile:
    """Read a bundled profile by its name, or another by the path of its ``.toml`` file.

    Raises:
        ConfigError: there is none, or a key is unknown, missing or impossible; the text has file,
            line and what was expected.
    """
    if name.endswith(".toml"):
        return _read(Path(name))
    if name in names():
        return _read(FOLDER / f"{name}.toml")
    hint = f"{nearest(name, names())}; there are {', '.join(names())}, or a path to FILE.toml"
    raise ConfigError(f"no profile {name!r}{hint}")


def _read(path: Path) -> Profile:
    mapping = strict.read(path)
    try:
        return strict.convert(mapping, Profile, str(path))
    except ConfigError as error:
        line = toml_line.find(path.read_text(encoding="utf-8"), error.path)
        if line is None:
            raise
        text = str(error).removeprefix(str(path))
        raise ConfigError(f"{path}, line {line}{text}", error.path) from None
