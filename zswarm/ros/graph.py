"""Which ROS graph a program is in: a master, a domain, or Zenoh endpoints; and private ones for a simulation of one's own."""

import contextlib
import socket
from collections.abc import Iterator
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from zswarm.errors import EvaluationError
from zswarm.ros.child import Child, command

LinkKind = Literal["rospy", "rclpy", "zenoh"]
LOOPBACK = "127.0.0.1"
DOMAINS = range(1, 102)  # whose ports are not those that systems give to anybody (docs of ROS 2)
BEFORE_RANGES = ("foxy", "galactic", "humble")  # distributions that know no ROS_AUTOMATIC_DISCOVERY_RANGE


class Graph(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a link reaches the other side."""

    link: Annotated[LinkKind, Meta(description="rospy: ROS 1; rclpy: ROS 2; zenoh: ROS 2 with rmw_zenoh, no ROS installed here")]
    master: Annotated[str, Meta(description="rospy: URI of the master; empty: as ROS_MASTER_URI says")] = ""
    domain: Annotated[int, Meta(description="rclpy, zenoh: ROS domain", ge=0, le=232)] = 0
    connect: Annotated[list[str], Meta(description="zenoh: endpoints to dial, such as tcp/127.0.0.1:7447")] = []
    listen: Annotated[list[str], Meta(description="zenoh: endpoints to listen on")] = []
    local: Annotated[bool, Meta(description="nothing leaves this machine")] = True

    def dialled(self) -> "Graph":
        """The same for the side that the other one dials: a simulation that a slot starts."""
        return msgspec.structs.replace(self, connect=[], listen=self.connect)

    def environment(self, distribution: str) -> dict[str, str]:
        """What ROS of a distribution reads from the environment of a program."""
        if self.link == "rospy":
            return {**({"ROS_MASTER_URI": self.master} if self.master else {}), **({"ROS_IP": LOOPBACK} if self.local else {})}
        if self.link == "zenoh":
            return {}
        found = {"ROS_DOMAIN_ID": str(self.domain)}
        if self.local:
            older = distribution in BEFORE_RANGES
            found |= {"ROS_LOCALHOST_ONLY": "1"} if older else {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        return found


@contextlib.contextmanager
def private(link: LinkKind) -> Iterator[Graph]:
    """A graph of this machine where nobody else is, for as long as the block lasts.

    rospy: starts a master. rclpy: a domain that nobody here uses. zenoh: a free endpoint of loopback in ``connect``;
    the simulation uses ``dialled()``.

    Raises:
        ConfigError: what it takes is not installed.
        EvaluationError: there is no free domain.
    """
    if link == "rospy":
        environment = Graph(link=link).environment("noetic")
        with contextlib.closing(Child("the ROS master", command("master", "rospy"), environment, {})) as master:
            yield Graph(link=link, master=master.said.decode())
    elif link == "rclpy":
        with _free_domain() as domain:
            yield Graph(link=link, domain=domain)
    else:
        yield Graph(link=link, connect=[f"tcp/{LOOPBACK}:{_free_port()}"])


@contextlib.contextmanager
def _free_domain() -> Iterator[int]:
    """A domain that no program here uses, held against others that look for one."""
    for domain in DOMAINS:
        with contextlib.closing(socket.socket(socket.AF_UNIX)) as held, contextlib.closing(_udp()) as probe:
            try:
                held.bind(f"\0zswarm-ros-domain-{domain}")
                probe.bind((LOOPBACK, 7400 + 250 * domain + 10))  # where its first participant is asked (RTPS)
            except OSError:
                continue
            probe.close()
            yield domain
            return
    raise EvaluationError(f"no ROS domain of {DOMAINS.start} to {DOMAINS.stop - 1} is free on this machine")


def _udp() -> socket.socket:
    return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


def _free_port() -> int:
    with contextlib.closing(socket.socket()) as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port
