"""Bridge to ROS 2: run by the Python that has rclpy, as a child of ``ros/link/link.py``."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import Any

import frames
from conversion import Conversion
from topics import Count, Send, Topics, message_class, new

NO_RCLPY = (
    "rclpy is missing: source ROS 2's setup.bash, or name the Python that has it in "
    "ZSWARM_ROS2_PYTHON (docs/profiles.md)"
)
NO_SERVICES = "std_srvs is missing: install ROS 2's package std_srvs"
WAKING_S = 1.0
LEAVING_S = 0.2
DEPTH = 1000  # messages in a queue


def main() -> None:
    """Speak ROS for a link until it is closed."""
    pipe = frames.Pipe()
    rclpy = frames.need("rclpy", NO_RCLPY)
    from rclpy.duration import Duration
    from rclpy.signals import SignalHandlerOptions

    set_up = pipe.set_up()
    arguments, no_handlers = (
        ["--ros-args", "--disable-external-lib-logs"],
        SignalHandlerOptions.NO,
    )
    rclpy.init(args=arguments, signal_handler_options=no_handlers)
    node = rclpy.create_node(
        set_up["node"], start_parameter_services=False, enable_rosout=False
    )
    topics = RclpyTopics(pipe.write, node)
    topics.connect(set_up["topics"])
    spinning = threading.Thread(target=spin, args=(node,), daemon=True)
    spinning.start()
    pipe.publish(topics.sending, topics.connected)
    for publisher in topics.publishers:  # let the last messages arrive
        publisher.wait_for_all_acked(Duration(seconds=LEAVING_S))
    rclpy.shutdown()
    spinning.join()


def spin(node: Any) -> None:
    """Call back until ROS is shut down."""
    import rclpy
    from rclpy.executors import ExternalShutdownException

    try:
        from rclpy.experimental import EventsExecutor as Executor  # faster; not in Humble
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor as Executor
    executor = Executor()
    executor.add_node(node)
    with contextlib.suppress(ExternalShutdownException):
        while rclpy.ok():
            # Without a timeout it would hold Python's lock while it waits.
            executor.spin_once(timeout_sec=WAKING_S)


class RclpyTopics(Topics):  # type: ignore[misc]  # found only at run time
    """Topics through rclpy."""

    def __init__(self, write: Callable[[bytes], object], node: Any) -> None:
        super().__init__(write, Conversion(new))
        self._node = node
        self.publishers: list[Any] = []
        self._heard: Any = None

    def _publish(self, topic: dict[str, Any]) -> tuple[Send, Count]:
        kind = message_class(topic["type"])
        publisher = self._node.create_publisher(kind, topic["name"], _quality(topic))
        self.publishers.append(publisher)
        return publisher.publish, publisher.get_subscription_count

    def _subscribe(self, topic: dict[str, Any], received: Send) -> Count:
        """Humble counts all publishers, not the matching ones."""
        name, kind = topic["name"], message_class(topic["type"])
        subscription = self._node.create_subscription(
            kind, name, received, _quality(topic)
        )
        matched = getattr(subscription, "get_publisher_count", None)
        return matched or (lambda: self._node.count_publishers(subscription.topic_name))

    def _hear_anew(self, topic: dict[str, Any], heard: Send) -> None:
        """Subscribe once more; the subscription is destroyed when the next one is made."""
        waiting = [heard]

        def receive(message: Any) -> None:
            if waiting:
                waiting.pop()(message)

        if self._heard is not None:
            self._node.destroy_subscription(self._heard)
        kind = message_class(topic["type"])
        self._heard = self._node.create_subscription(
            kind, topic["name"], receive, _quality(topic)
        )

    def _call(self, service: str, returned: Callable[[], object]) -> tuple[Send, Count]:
        kind = frames.need("std_srvs.srv", NO_SERVICES).Empty
        client = self._node.create_client(kind, service)

        def call(_: bytes) -> None:
            client.call_async(kind.Request()).add_done_callback(lambda _: returned())

        return call, lambda: int(client.service_is_ready())

    def _offer(self, service: str, called: Callable[[], object]) -> None:
        def answer(_: Any, response: Any) -> Any:
            called()
            return response

        self._node.create_service(
            frames.need("std_srvs.srv", NO_SERVICES).Empty, service, answer
        )


def _quality(topic: dict[str, Any]) -> Any:
    """Return a QoS profile: late subscribers get no earlier messages."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    policy = (
        ReliabilityPolicy.RELIABLE if topic["reliable"] else ReliabilityPolicy.BEST_EFFORT
    )
    return QoSProfile(
        depth=DEPTH, reliability=policy, durability=DurabilityPolicy.VOLATILE
    )


if __name__ == "__main__":
    main()
