"""Bridge to ROS 1: run by the Python that has rospy, as a child of ``ros/link/link.py``."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any
from xmlrpc.client import ServerProxy

import frames
from conversion import Conversion
from topics import Count, Send, Topics, message_class, new

NO_ROSPY = (
    "rospy is missing: install it (Debian: apt install ros-core), or name its Python in "
    "ZSWARM_ROS1_PYTHON"
)
NO_SERVICES = "std_srvs is missing: install it (Debian: apt install python3-std-srvs)"
PROBE_S = 0.01  # for a service to answer


def main() -> None:
    """Speak ROS for a link until it is closed."""
    pipe = frames.Pipe()
    rospy = frames.need("rospy", NO_ROSPY)
    set_up = pipe.set_up()
    check(set_up)
    warnings.simplefilter("ignore", SyntaxWarning)  # of a publisher without a queue
    if any(
        topic["type"] == frames.CLOCKS and topic["publish"] for topic in set_up["topics"]
    ):
        rospy.set_param("/use_sim_time", True)

    def no_time() -> bool:
        """Have rospy not subscribe to /clock, which would leave only its last subscriber."""
        rospy.rostime.set_rostime_initialized(True)
        return True

    rospy.impl.simtime.init_simtime = no_time
    # No files: errors go to standard error.
    rospy.core.configure_logging = lambda *_: None
    rospy.init_node(
        set_up["node"], anonymous=True, disable_signals=True, log_level=rospy.ERROR
    )
    topics = RospyTopics(pipe.write, rospy)
    topics.connect(set_up["topics"])
    pipe.publish(topics.sending, topics.connected)
    rospy.signal_shutdown("the link is closed")


def check(set_up: dict[str, Any]) -> None:
    """Refuse a set-up for which rospy would wait without end, or fail later."""
    import rosgraph

    uri = rosgraph.get_master_uri()
    try:
        ServerProxy(uri).getPid("/zswarm")
    except Exception:  # refused, not resolved, no XML: the same for the user
        frames.refuse(
            f"no ROS master answers at {uri}: start one (roscore), or give the URI of another"
        )
    if any(topic["type"] == frames.EMPTY for topic in set_up["topics"]):
        frames.need("std_srvs.srv", NO_SERVICES)


class RospyTopics(Topics):  # type: ignore[misc]  # found only at run time
    """Topics through rospy."""

    def __init__(self, write: Callable[[bytes], object], rospy: Any) -> None:
        super().__init__(write, Conversion(new, stamp=("secs", "nsecs")))
        self._rospy = rospy
        self._subscriptions: dict[str, tuple[Any, Send]] = {}

    def _publish(self, topic: dict[str, Any]) -> tuple[Send, Count]:
        """Without a queue, messages are sent at once."""
        name, kind = topic["name"], message_class(topic["type"])
        publisher = self._rospy.Publisher(name, kind, queue_size=None, tcp_nodelay=True)
        return publisher.publish, publisher.get_num_connections

    def _subscribe(self, topic: dict[str, Any], received: Send) -> Count:
        name = topic["name"]
        self._subscriptions[name] = self._subscriber(topic, received), received
        return lambda: int(self._subscriptions[name][0].get_num_connections())

    def _hear_anew(self, topic: dict[str, Any], heard: Send) -> None:
        """Subscribe again: rospy has one connection for all subscribers of a topic."""
        old, received = self._subscriptions[topic["name"]]
        old.unregister()
        waiting = [heard]

        def receive(message: Any) -> None:
            if waiting:
                waiting.pop()(message)
            received(message)

        self._subscriptions[topic["name"]] = self._subscriber(topic, receive), received

    def _subscriber(self, topic: dict[str, Any], received: Send) -> Any:
        kind = message_class(topic["type"])
        return self._rospy.Subscriber(topic["name"], kind, received, tcp_nodelay=True)

    def _call(self, service: str, returned: Callable[[], object]) -> tuple[Send, Count]:
        from std_srvs.srv import Empty

        def is_offered() -> int:
            try:
                self._rospy.wait_for_service(service, timeout=PROBE_S)
            except self._rospy.ROSException:
                return 0
            return 1

        proxy = self._rospy.ServiceProxy(service, Empty)

        def call(_: bytes) -> None:
            proxy()
            returned()

        return call, is_offered

    def _offer(self, service: str, called: Callable[[], object]) -> None:
        from std_srvs.srv import Empty, EmptyResponse

        def answer(_: Any) -> Any:
            called()
            return EmptyResponse()

        self._rospy.Service(service, Empty, answer)


if __name__ == "__main__":
    main()
