"""Which ROS graph a program is in: a master, a domain, or Zenoh endpoints; and private ones for a simulation of one's own."""

import contextlib
from collections.abc import Iterator
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

LinkKind = Literal["rospy", "rclpy", "zenoh"]


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


@contextlib.contextmanager
def private(link: LinkKind) -> Iterator[Graph]:
    """A graph of this machine where nobody else is, for as long as the block lasts.

    rospy: starts a master. rclpy: a domain that nobody here uses. zenoh: a free endpoint of loopback in ``connect``;
    the simulation uses ``dialled()``.

    Raises:
        ConfigError: what it takes is not installed.
    """
    raise NotImplementedError(link)
    yield
