"""A link: the topics of a profile, through a child process that speaks ROS.

Example::

    profile = profiles.read("stage_ros2")
    with graph.private("zenoh") as here, Link(here, profile, robots=4, side="controllers") as link:
        link.ready(timeout_s=10)
        link.send([ResetWorld(seed=1)])
        while (message := link.receive(timeout_s=5)) is not None: ...
"""

import os
import time
from collections.abc import Callable, Collection, Sequence
from typing import Any, Literal, Self

from zswarm.errors import ConfigError, EvaluationError
from zswarm.robots.profiles.profile import SHARED, Channel, Profile
from zswarm.ros.link import codec
from zswarm.ros.link.bridges import frames
from zswarm.ros.link.child import Child, command
from zswarm.ros.link.graph import RosGraph
from zswarm.ros.link.messages import Message

Side = Literal["simulation", "controllers"]
FROM_CONTROLLERS = ("velocity", "reset")
POLL_S = 0.01  # between questions about connections
SHOWN = 4  # topics in an error message


class Link:
    """Publishes and receives the topics of a profile, for one side.

    The simulation publishes clock, scans, odometry and ground truth, and receives velocities and
    resets; controllers do the opposite. Messages sent before ``ready`` may be lost. Where the reset
    is a service, controllers receive a ``ResetWorld`` when a call of it returned.
    """

    def __init__(
        self,
        graph: RosGraph,
        profile: Profile,
        *,
        robots: int,
        side: Side,
        channels: Collection[Channel] | None = None,
        stamped_resets: bool = False,
    ) -> None:
        """Start the child process.

        Args:
            robots: their number; a single one has no namespace.
            channels: those used of the profile; None: all.
            stamped_resets: a ``ResetWorld`` that says that a service returned comes with the next
                message of the clock, whose stamp it has. Messages with earlier stamps may be of
                before the reset, also if they arrive later.

        Raises:
            ConfigError: ROS is not installed, with what to install; the profile does not fit the
                link.
            EvaluationError: the child process ended, or did not start in time.
        """
        ros = 1 if graph.link == "rospy" else 2
        if profile.ros != ros:
            raise ConfigError(
                f"the link {graph.link} speaks ROS {ros}, "
                f"and the profile ({profile.description}) is of ROS {profile.ros}"
            )
        self._topics = [
            (channel, robot)
            for channel in profile.channels
            if channels is None or channel in channels
            for robot in range(1 if channel in SHARED else robots)
        ]
        self._described = [
            _describe(profile, *topic, robots, side) for topic in self._topics
        ]
        if stamped_resets:
            clock = self._described[self._topics.index(("clock", 0))]
            self._described[self._topics.index(("reset", 0))]["clock"] = clock
        self._numbers = {
            topic: number
            for number, topic in enumerate(self._topics)
            if self._described[number]["publish"]
        }
        set_up = {
            "node": f"zswarm_{side}_{os.getpid()}",
            "distribution": profile.distribution,
            "topics": self._described,
            "domain": graph.domain,
            "connect": graph.connect,
            "listen": graph.listen,
            "local": graph.local,
        }
        program = command(f"by_{graph.link}", graph.link)
        environment = graph.environment(profile.distribution)
        self._child = Child(f"the {graph.link} bridge", program, environment, set_up)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ready(
        self,
        timeout_s: float,
        channels: Collection[Channel] | None = None,
        either: Collection[Channel] = (),
        check: Callable[[], object] = lambda: None,
    ) -> None:
        """Wait until topics are connected. Once both sides waited, no message is lost.

        Args:
            channels: those that must be connected; None: all of the link.
            either: of these, one must be, too.
            check: called meanwhile; it raises where waiting is in vain.

        Raises:
            EvaluationError: not in time, with the topics that have no other side; or the child
                process ended.
        """
        deadline = time.monotonic() + timeout_s
        while missing := self._missing(self._connections(deadline), channels, either):
            if time.monotonic() > deadline:
                raise EvaluationError(f"{self._shown(missing)} after {timeout_s:g} s")
            check()
            time.sleep(POLL_S)

    def send(self, messages: Sequence[Message]) -> None:
        """Publish messages, in order; those of one call cost one write.

        Raises:
            EvaluationError: the child process ended.
            ValueError: this side does not publish such a message.
        """
        body = bytearray()
        for message in messages:
            topic = codec.topic(message)
            number = self._numbers.get(topic)
            if number is None:
                raise ValueError(
                    f"{topic[0]} of robot {topic[1]} is not published by this link"
                )
            body += frames.frame(number, codec.encode(message))
        self._child.write(body)

    def receive(self, timeout_s: float) -> Message | None:
        """Return the next message; None: none came in time. Each topic's messages are in order.

        Raises:
            EvaluationError: the child process ended.
        """
        while (frame := self._child.next(timeout_s)) is not None:
            number, body = frame
            if number != frames.CONTROL:  # a late answer about connections
                return codec.decode(*self._topics[number], body)
        return None

    def close(self) -> None:
        """End the child process; a second call does nothing."""
        self._child.close()

    def _connections(self, deadline: float) -> list[int]:
        """Ask how many are connected to each topic; messages that come meanwhile are queued."""
        self._child.write(frames.frame(frames.CONTROL, b""))
        others: list[tuple[int, bytes]] = []
        try:
            while (
                frame := self._child.next(max(1.0, deadline - time.monotonic()))
            ) is not None:
                if frame[0] == frames.CONTROL:
                    return [count for (count,) in frames.COUNT.iter_unpack(frame[1])]
                others.append(frame)
        finally:
            self._child.put_back(others)
        raise EvaluationError("the bridge does not report connections")

    def _missing(
        self,
        counts: list[int],
        channels: Collection[Channel] | None,
        either: Collection[Channel],
    ) -> list[int]:
        """Return the numbers of topics that must be connected and are not."""
        open_: dict[Channel, list[int]] = {channel: [] for channel, _ in self._topics}
        for number, (channel, _) in enumerate(self._topics):
            if not counts[number]:
                open_[channel].append(number)
        required = set(open_ if channels is None else channels)
        if either and all(open_[channel] for channel in either):
            required |= set(either)
        return [
            number
            for channel in open_
            if channel in required
            for number in open_[channel]
        ]

    def _shown(self, numbers: list[int]) -> str:
        """Describe topics without another side."""
        texts = []
        for verb in ("offers the service", "subscribes to", "publishes"):
            topics = [self._described[number] for number in numbers]
            names = [topic["name"] for topic in topics if _verb(topic) == verb]
            if names:
                more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
                texts.append(f"no node {verb} {', '.join(names[:SHOWN])}{more}")
        return "; ".join(texts)


def _verb(topic: dict[str, Any]) -> str:
    """Return what the other side of a topic does."""
    if topic["type"] == frames.EMPTY:
        return "offers the service"
    return "subscribes to" if topic["publish"] else "publishes"


def _describe(
    profile: Profile, channel: Channel, robot: int, robots: int, side: Side
) -> dict[str, Any]:
    """Return what a bridge needs to know of a topic."""
    topic = getattr(profile, channel)
    return {
        "name": profile.topic(channel, robot, robots),
        "type": codec.ros_type(profile, channel),
        "publish": (channel in FROM_CONTROLLERS) == (side == "controllers"),
        "reliable": topic.reliable,
        "frame": profile.frame(topic.frame, robot, robots),
        "child_frame": profile.frame(topic.child_frame, robot, robots),
        "clock": None,
    }
