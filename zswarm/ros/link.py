"""A link: the topics of a profile, through a child process that speaks ROS.

Example::

    with graph.private("zenoh") as here, Link(here, profiles.read("stageros"), robots=4, side="controllers") as link:
        link.ready(timeout_s=10)
        link.send(Reset(seed=1))
        while (message := link.receive(timeout_s=5)) is not None: ...
"""

from collections.abc import Collection, Sequence
from types import TracebackType
from typing import Literal

from zswarm.ros.graph import Graph
from zswarm.ros.messages import Message
from zswarm.ros.profiles import Channel, Profile

Side = Literal["simulation", "controllers"]


class Link:
    """Publishes and receives the topics of a profile, for one side.

    The simulation publishes clock, scans, odometry and ground truth, and receives velocities and resets; controllers do the
    opposite.
    """

    def __init__(
        self, graph: Graph, profile: Profile, *, robots: int, side: Side, channels: Collection[Channel] | None = None
    ) -> None:
        """Start the child process.

        Args:
            robots: how many; one alone has no namespace.
            channels: what is used of the profile; None: all that it has.

        Raises:
            ConfigError: ROS is not there, with what to install; the profile does not fit the link.
        """
        raise NotImplementedError

    def __enter__(self) -> "Link":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def ready(self, timeout_s: float, channels: Collection[Channel] | None = None) -> None:
        """Wait until every topic is connected to the other side: what is sent from then on arrives.

        Args:
            channels: those that must be; None: all of the link.

        Raises:
            EvaluationError: not in time, with the topics that nobody publishes or subscribes; the child process ended.
        """
        raise NotImplementedError

    def send(self, messages: Sequence[Message]) -> None:
        """Publish, in order; those of one call cost one write.

        Raises:
            EvaluationError: the child process ended.
            ValueError: a message that this side does not publish.
        """
        raise NotImplementedError

    def receive(self, timeout_s: float) -> Message | None:
        """The next message; None: none came in time. Those of one topic come in their order.

        Raises:
            EvaluationError: the child process ended.
        """
        raise NotImplementedError

    def close(self) -> None:
        """End the child process; a second time does nothing."""
        raise NotImplementedError
