"""Bridge to ROS 2: run by the Python that has rclpy, as a child of ``ros/link.py``."""

from __future__ import annotations

import contextlib
import importlib
import threading
from collections.abc import Callable
from typing import Any

import frames
from conversion import Conversion

NO_RCLPY = (
    "rclpy is not there: source ROS 2's setup.bash, or name the Python that has it in ZSWARM_ROS2_PYTHON (docs/profiles.md)"
)
NO_SERVICES = "std_srvs is not there: install ROS 2's package std_srvs"
WAKING_S = 1.0
LEAVING_S = 0.2
DEPTH = 1000  # messages that wait


def main() -> None:
    """Speak ROS for a link until it is closed."""
    pipe = frames.Pipe()
    try:
        import rclpy
    except ImportError:
        frames.refuse(NO_RCLPY)
    from rclpy.duration import Duration
    from rclpy.signals import SignalHandlerOptions

    set_up = pipe.set_up()
    rclpy.init(args=["--ros-args", "--disable-external-lib-logs"], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(set_up["node"], start_parameter_services=False, enable_rosout=False)
    conversion = Conversion(lambda name: kind(name)())
    sending, connected, publishers = {}, [], []
    for number, topic in enumerate(set_up["topics"]):
        if topic["type"] == frames.EMPTY:
            send, count = service(pipe, node, number, topic)
            sending[number] = send
        elif topic["publish"]:
            publisher = node.create_publisher(kind(topic["type"]), topic["name"], quality(topic))
            sending[number], count = publishing(publisher, conversion.message(topic)), publisher.get_subscription_count
            publishers.append(publisher)
        else:
            taken = taking(pipe, number, conversion.body(topic["type"]))
            count = counting(node, node.create_subscription(kind(topic["type"]), topic["name"], taken, quality(topic)))
        connected.append(count)
    spinning = threading.Thread(target=spin, args=(node,), daemon=True)
    spinning.start()
    pipe.publish(sending, connected)
    for publisher in publishers:  # what was said last is on its way
        publisher.wait_for_all_acked(Duration(seconds=LEAVING_S))
    rclpy.shutdown()
    spinning.join()


def spin(node: Any) -> None:
    """Take what comes."""
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
            executor.spin_once(timeout_sec=WAKING_S)  # without an end it keeps Python's lock while it waits


def kind(name: str) -> Any:
    """The message class of a type."""
    package, _, name = name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def quality(topic: dict[str, Any]) -> Any:
    """Reliable or best effort; who comes late gets nothing that was said before."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    policy = ReliabilityPolicy.RELIABLE if topic["reliable"] else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=DEPTH, reliability=policy, durability=DurabilityPolicy.VOLATILE)


def publishing(publisher: Any, message: Callable[[bytes], Any]) -> Callable[[bytes], object]:
    """Publishes a frame's body."""
    return lambda body: publisher.publish(message(body))


def taking(pipe: Any, number: int, body: Callable[[Any], bytes]) -> Callable[[Any], None]:
    """A callback that says messages of a topic."""
    return lambda message: pipe.say(frames.frame(number, body(message)))


def counting(node: Any, subscription: Any) -> Callable[[], int]:
    """How many publish to a subscription; in Humble, how many there are."""
    matched = getattr(subscription, "get_publisher_count", None)
    return matched or (lambda: node.count_publishers(subscription.topic_name))


def service(pipe: Any, node: Any, number: int, topic: dict[str, Any]) -> tuple[Callable[[bytes], object], Callable[[], int]]:
    """A service without arguments, offered or called: how to call it, and whether the other side is there."""
    try:
        empty = importlib.import_module("std_srvs.srv").Empty
    except ImportError:
        frames.refuse(NO_SERVICES)
    if topic["publish"]:
        client = node.create_client(empty, topic["name"])
        return lambda _: client.call_async(empty.Request()), lambda: int(client.service_is_ready())

    def asked(_: Any, answer: Any) -> Any:
        pipe.say(frames.frame(number, frames.RESET.pack(0)))
        return answer

    node.create_service(empty, topic["name"], asked)
    return lambda _: None, lambda: 1


if __name__ == "__main__":
    main()
