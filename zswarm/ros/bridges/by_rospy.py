"""Bridge to ROS 1: run by the Python that has rospy (Debian's), as a child of ``ros/link.py``."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable
from typing import Any
from xmlrpc.client import ServerProxy

import frames
from conversion import Conversion

NO_ROSPY = "rospy is not there: install it (Debian: apt install ros-core), or name its Python in ZSWARM_ROS1_PYTHON"
NO_SERVICES = "std_srvs is not there: install it (Debian: apt install python3-std-srvs)"
ASKING_S = 0.01  # whether a service is there


def main() -> None:
    """Speak ROS for a link until it is closed."""
    pipe = frames.Pipe()
    try:
        import rospy
    except ImportError:
        frames.refuse(NO_ROSPY)
    set_up = pipe.set_up()
    check(set_up)
    warnings.simplefilter("ignore", SyntaxWarning)  # of a publisher without a queue
    if any(topic["type"] == frames.CLOCKS and topic["publish"] for topic in set_up["topics"]):
        rospy.set_param("/use_sim_time", True)
    rospy.impl.simtime.init_simtime = no_time
    rospy.core.configure_logging = lambda *_: None  # no files: what goes wrong goes to standard error
    rospy.init_node(set_up["node"], anonymous=True, disable_signals=True, log_level=rospy.ERROR)
    conversion = Conversion(lambda name: kind(name)(), stamp=("secs", "nsecs"))
    sending, connected = {}, []
    for number, topic in enumerate(set_up["topics"]):
        if topic["type"] == frames.EMPTY:
            send, count = service(pipe, number, topic)
            sending[number] = send
        elif topic["publish"]:
            publisher = rospy.Publisher(topic["name"], kind(topic["type"]), queue_size=None, tcp_nodelay=True)  # None: at once
            sending[number], count = publishing(publisher, conversion.message(topic)), publisher.get_num_connections
        else:
            taken = taking(pipe, number, conversion.body(topic["type"]))
            count = rospy.Subscriber(topic["name"], kind(topic["type"]), taken, tcp_nodelay=True).get_num_connections
        connected.append(count)
    pipe.publish(sending, connected)
    rospy.signal_shutdown("the link is closed")


def check(set_up: dict[str, Any]) -> None:
    """Refuse what rospy would wait for without end, or fail at later."""
    import rosgraph

    uri = rosgraph.get_master_uri()
    try:
        ServerProxy(uri).getPid("/zswarm")
    except Exception:  # refused, not resolved, no XML: all the same for the user
        frames.refuse(f"no ROS master answers at {uri}: start one (roscore), or give the URI of another")
    if any(topic["type"] == frames.EMPTY for topic in set_up["topics"]):
        try:
            importlib.import_module("std_srvs.srv")
        except ImportError:
            frames.refuse(NO_SERVICES)


def no_time() -> bool:
    """A bridge asks nobody what time it is; rospy would hear /clock for that, and keep the last of several alone."""
    import rospy

    rospy.rostime.set_rostime_initialized(True)
    return True


def kind(name: str) -> Any:
    """The message class of a type."""
    package, _, name = name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def publishing(publisher: Any, message: Callable[[bytes], Any]) -> Callable[[bytes], object]:
    """Publishes a frame's body."""
    return lambda body: publisher.publish(message(body))


def taking(pipe: Any, number: int, body: Callable[[Any], bytes]) -> Callable[[Any], None]:
    """A callback that says messages of a topic."""
    return lambda message: pipe.say(frames.frame(number, body(message)))


def service(pipe: Any, number: int, topic: dict[str, Any]) -> tuple[Callable[[bytes], object], Callable[[], int]]:
    """A service without arguments, offered or called: how to call it, and whether the other side is there."""
    import rospy
    from std_srvs.srv import Empty, EmptyResponse

    if topic["publish"]:
        call = rospy.ServiceProxy(topic["name"], Empty)
        return lambda _: call(), lambda: is_there(topic["name"])

    def asked(_: Any) -> Any:
        pipe.say(frames.frame(number, frames.RESET.pack(0)))
        return EmptyResponse()

    rospy.Service(topic["name"], Empty, asked)
    return lambda _: None, lambda: 1


def is_there(service: str) -> int:
    """1 if somebody offers a service."""
    import rospy

    try:
        rospy.wait_for_service(service, timeout=ASKING_S)
    except rospy.ROSException:
        return 0
    return 1


if __name__ == "__main__":
    main()
