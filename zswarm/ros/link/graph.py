"""The ROS graph of a program: a master, a domain, or Zenoh endpoints; and private ones."""

import contextlib
import os
import socket
from collections.abc import Iterator
from typing import Annotated, Literal
from urllib.parse import urlsplit

import msgspec

from zswarm.config.meta import about
from zswarm.errors import EvaluationError
from zswarm.ros.link.child import Child, command

LinkKind = Literal["rospy", "rclpy", "zenoh"]
LOOPBACK = "127.0.0.1"
DEFAULT_MASTER = "http://localhost:11311"  # of ROS 1, without ROS_MASTER_URI
# Their ports are outside the ephemeral ranges of systems (docs of ROS 2).
DOMAINS = range(1, 102)
# Distributions without ROS_AUTOMATIC_DISCOVERY_RANGE.
BEFORE_RANGES = ("foxy", "galactic", "humble")


class RosGraph(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a link reaches the other side."""

    link: Annotated[
        LinkKind, about("rospy: ROS 1; rclpy: ROS 2; zenoh: rmw_zenoh without ROS here")
    ]
    master: Annotated[str, about("rospy: URI of the master; empty: ROS_MASTER_URI")] = ""
    domain: Annotated[int, about("rclpy, zenoh: ROS domain", ge=0, le=232)] = 0
    connect: Annotated[
        list[str], about("zenoh: endpoints such as tcp/127.0.0.1:7447")
    ] = []
    listen: Annotated[list[str], about("zenoh: endpoints to listen on")] = []
    local: Annotated[bool, about("nothing leaves this machine")] = True

    def dialled(self) -> "RosGraph":
        """Return the same for the side that listens: a simulation that a slot starts."""
        return msgspec.structs.replace(self, connect=[], listen=self.connect)

    def identity(self) -> "RosGraph":
        """Return the same, with the master's address in one spelling, for locks."""
        if self.link != "rospy":
            return self
        uri = urlsplit(
            self.master or os.environ.get("ROS_MASTER_URI", "") or DEFAULT_MASTER
        )
        address = _address(uri.hostname or LOOPBACK)
        return msgspec.structs.replace(self, master=f"http://{address}:{uri.port or 80}")

    def environment(self, distribution: str) -> dict[str, str]:
        """Return the environment variables that a distribution's programs read."""
        found, local = {}, {}
        if self.link == "rospy":
            found = {"ROS_MASTER_URI": self.master} if self.master else {}
            local = {"ROS_IP": LOOPBACK}
        elif self.link == "rclpy":
            found = {"ROS_DOMAIN_ID": str(self.domain)}
            local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
            if distribution in BEFORE_RANGES:
                local = {"ROS_LOCALHOST_ONLY": "1"}
        return found | local if self.local else found


def _address(host: str) -> str:
    """Return the IPv4 address of a host: loopback for this machine's, its name if unknown."""
    try:
        address = socket.gethostbyname(host)
    except OSError:
        return host
    with socket.socket() as probe:
        try:
            probe.bind((address, 0))
        except OSError:  # of another machine
            return address
    return LOOPBACK


@contextlib.contextmanager
def private(link: LinkKind) -> Iterator[RosGraph]:
    """Provide a graph on this machine that no other program uses.

    rospy: starts a master. rclpy: a domain that is unused here. zenoh: a free loopback endpoint in
    ``connect``; the simulation uses ``dialled()``.

    Raises:
        ConfigError: a required library is not installed.
        EvaluationError: there is no free domain.
    """
    if link == "rospy":
        environment = RosGraph(link=link).environment("noetic")
        master = Child("the ROS master", command("master", "rospy"), environment, {})
        with contextlib.closing(master):
            yield RosGraph(link=link, master=master.greeting.decode())
    elif link == "rclpy":
        with _free_domain() as domain:
            yield RosGraph(link=link, domain=domain)
    else:
        yield RosGraph(link=link, connect=[f"tcp/{LOOPBACK}:{free_port()}"])


@contextlib.contextmanager
def _free_domain() -> Iterator[int]:
    """Reserve a domain that no program here uses against others that look for one."""
    for domain in DOMAINS:
        with socket.socket(socket.AF_UNIX) as held:
            try:
                held.bind(f"\0zswarm-ros-domain-{domain}")
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    # The first participant's port for discovery (RTPS).
                    probe.bind((LOOPBACK, 7400 + 250 * domain + 10))
            except OSError:
                continue
            yield domain
            return
    first, last = DOMAINS[0], DOMAINS[-1]
    raise EvaluationError(f"no ROS domain of {first} to {last} is free on this machine")


def free_port() -> int:
    """Return a TCP port of loopback that is free now."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
