"""ROS simulations and robots of this machine: files of its administrator (docs/ros.md).

``NAME.toml`` says where one is, which profile it has and whether its robots are real. An experiment
names it; no message on the wire holds an address, a path or a profile's file.
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from zswarm.config import decode
from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError
from zswarm.plugins import manifests
from zswarm.robots.profiles import profile as profiles
from zswarm.robots.profiles.profile import Profile
from zswarm.ros.link.graph import LinkKind, RosGraph

KIND = "ros"  # of the folders


class MachineSimulation(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """The content of a file."""

    link: LinkKind
    profile: Annotated[str, Meta(min_length=1)]  # bundled, or FILE.toml next to this file
    real_robots: bool = False  # may move what is not a simulation
    master: str = ""  # rospy: URI; empty: ROS_MASTER_URI
    domain: Annotated[int, Meta(ge=0, le=232)] = 0  # rclpy, zenoh
    connect: list[str] = []  # zenoh: endpoints to dial
    # Starts it for each slot, in a graph of its own, from the folder of the file.
    launch: str = ""
    description: str = ""

    @property
    def command(self) -> list[str]:
        """The words of ``launch``, as a shell splits them."""
        return shlex.split(self.launch)

    def graph(self) -> RosGraph:
        """Return the graph in which it runs."""
        return RosGraph(
            link=self.link,
            master=self.master,
            domain=self.domain,
            connect=self.connect,
            local=False,
        )


class FoundSimulation(NamedTuple):
    """A simulation of this machine."""

    simulation: MachineSimulation
    profile: Profile
    folder: Path  # of its file


def find(name: str) -> FoundSimulation:
    """Return the simulation of a name.

    Raises:
        ConfigError: this machine has none of that name, or its file is not valid. Its text holds
            nothing of the file: it is an answer to the user who sent the name.
    """
    files = manifests.files_in(KIND)
    if name not in files:
        there = ", ".join(files) or "none"
        raise ConfigError(
            f"no ROS simulation {name!r} on this machine{nearest(name, files)}; it has {there}"
        )
    try:
        return read(files[name])
    except ConfigError as error:
        print(error, file=sys.stderr)  # noqa: T201  the server logs what a slot writes
        raise ConfigError(
            f"the file of the ROS simulation {name!r} on this machine is not valid; the log of "
            "its server has the reason"
        ) from None


def read(path: Path) -> FoundSimulation:
    """Read a file, and the profile that it names.

    Raises:
        ConfigError: not valid, with what was expected.
    """
    found = decode.convert(decode.read(path), MachineSimulation, str(path))
    named = found.profile
    beside = str(path.parent / named) if named.endswith(".toml") else named
    profile = profiles.read(beside)
    if profile.clock is None and not found.real_robots:
        raise ConfigError(
            f"{path}: profile {named} has no clock, which shows that robots are simulated; "
            "expected one that has, or real_robots = true"
        )
    if found.launch:
        _check_launch(path, found)
    return FoundSimulation(found, profile, path.parent)


def _check_launch(path: Path, found: MachineSimulation) -> None:
    """Refuse what does not go with ``launch``."""
    try:
        command = found.command
    except ValueError as error:
        raise ConfigError(f"{path}: launch: {error}; expected a command") from None
    if not command:
        raise ConfigError(f"{path}: launch: expected a command")
    if found.link == "zenoh":
        raise ConfigError(f'{path}: launch: expected link = "rospy" or "rclpy"')
    if found.master or found.domain or found.real_robots:
        raise ConfigError(
            f"{path}: launch: each slot has its own master or domain, and simulated robots; "
            "expected no master, domain or real_robots"
        )
