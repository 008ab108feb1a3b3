"""A link: the topics of a profile, through a child process that speaks ROS.

Example::

    with graph.private("zenoh") as here, Link(here, profiles.read("stage_ros2"), robots=4, side="controllers") as link:
        link.ready(timeout_s=10)
        link.send([Reset(seed=1)])
        while (message := link.receive(timeout_s=5)) is not None: ...
"""

import os
import time
from collections.abc import Collection, Sequence
from types import TracebackType
from typing import Any, Literal

from zswarm.errors import ConfigError, EvaluationError
from zswarm.ros import codec
from zswarm.ros.bridges import frames
from zswarm.ros.child import Child, command
from zswarm.ros.graph import Graph
from zswarm.ros.messages import Message
from zswarm.ros.profiles import SHARED, Channel, Profile

Side = Literal["simulation", "controllers"]
FROM_CONTROLLERS = ("velocity", "reset")
ASKING_S = 0.01  # between questions who is connected


class Link:
    """Publishes and receives the topics of a profile, for one side.

    The simulation publishes clock, scans, odometry and ground truth, and receives velocities and resets; controllers do the
    opposite. What is sent before ``ready`` may be lost.
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
            EvaluationError: the child process ended, or did not start in time.
        """
        ros = 1 if graph.link == "rospy" else 2
        if profile.ros != ros:
            raise ConfigError(
                f"the link {graph.link} speaks ROS {ros}, and the profile ({profile.description}) is of ROS {profile.ros}"
            )
        self._topics = [
            (channel, robot)
            for channel in profile.channels
            if channels is None or channel in channels
            for robot in range(1 if channel in SHARED else robots)
        ]
        self._described = [_description(profile, channel, robot, robots, side) for channel, robot in self._topics]
        self._numbers = {
            topic: number for number, topic in enumerate(self._topics) if self._described[number]["publish"]
        }  # fmt: skip
        set_up = {
            "node": f"zswarm_{side}_{os.getpid()}", "distribution": profile.distribution, "topics": self._described,
            "domain": graph.domain, "connect": graph.connect, "listen": graph.listen, "local": graph.local,
        }  # fmt: skip
        program = command(f"by_{graph.link}", graph.link)
        self._child = Child(f"the {graph.link} bridge", program, graph.environment(profile.distribution), set_up)

    def __enter__(self) -> "Link":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def ready(self, timeout_s: float, channels: Collection[Channel] | None = None, either: Collection[Channel] = ()) -> None:
        """Wait until every topic is connected to the other side. Once both sides waited, nothing is lost.

        Args:
            channels: those that must be; None: all of the link.
            either: one of these must be, too.

        Raises:
            EvaluationError: not in time, with the topics that nobody publishes or subscribes; the child process ended.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            lacking: dict[Channel, list[int]] = {channel: [] for channel, _ in self._topics}
            for number, count in enumerate(self._connected(deadline)):
                if not count:
                    lacking[self._topics[number][0]].append(number)
            missing = [number for channel in lacking if channels is None or channel in channels for number in lacking[channel]]
            if either and all(lacking[channel] for channel in either):
                missing += [number for channel in either for number in lacking[channel]]
            if not missing:
                return
            if time.monotonic() > deadline:
                raise EvaluationError(f"{self._missing(missing)} after {timeout_s:g} s")
            time.sleep(ASKING_S)

    def send(self, messages: Sequence[Message]) -> None:
        """Publish, in order; those of one call cost one write.

        Raises:
            EvaluationError: the child process ended.
            ValueError: a message that this side does not publish.
        """
        said = bytearray()
        for message in messages:
            topic = codec.topic(message)
            number = self._numbers.get(topic)
            if number is None:
                raise ValueError(f"{topic[0]} of robot {topic[1]} is not published by this link")
            said += frames.frame(number, codec.encode(message))
        self._child.write(said)

    def receive(self, timeout_s: float) -> Message | None:
        """The next message; None: none came in time. Those of one topic come in their order, those of several in any.

        Raises:
            EvaluationError: the child process ended.
        """
        while (came := self._child.next(timeout_s)) is not None:
            number, body = came
            if number != frames.CONTROL:  # an answer to a question that was given up
                return codec.decode(*self._topics[number], body)
        return None

    def close(self) -> None:
        """End the child process; a second time does nothing."""
        self._child.close()

    def _connected(self, deadline: float) -> list[int]:
        """How many are connected to each topic; messages that come meanwhile are kept."""
        self._child.write(frames.frame(frames.CONTROL, b""))
        kept: list[tuple[int, bytes]] = []
        try:
            while (came := self._child.next(max(1.0, deadline - time.monotonic()))) is not None:
                if came[0] == frames.CONTROL:
                    return [count for (count,) in frames.COUNT.iter_unpack(came[1])]
                kept.append(came)
        finally:
            self._child.put_back(kept)
        raise EvaluationError("the bridge does not say who is connected")

    def _missing(self, numbers: list[int]) -> str:
        """What is not there, in words."""
        lacking = []
        for verb, published in (("subscribes to", True), ("publishes", False)):
            names = [self._described[number]["name"] for number in numbers if self._described[number]["publish"] is published]
            if names:
                shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
                lacking.append(f"nobody {verb} {shown}")
        return "; ".join(lacking)


def _description(profile: Profile, channel: Channel, robot: int, robots: int, side: Side) -> dict[str, Any]:
    """What a bridge needs to know of a topic."""
    topic = getattr(profile, channel)
    return {
        "name": profile.topic(channel, robot, robots),
        "type": codec.ros_type(profile, channel),
        "publish": (channel in FROM_CONTROLLERS) == (side == "controllers"),
        "reliable": topic.reliable,
        "frame": profile.frame(topic.frame, robot, robots),
        "child_frame": profile.frame(topic.child_frame, robot, robots),
    }
