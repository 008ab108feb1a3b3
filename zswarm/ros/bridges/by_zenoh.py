"""Bridge to ROS 2 over Zenoh, no ROS installed: run by zswarm's own Python, as a child of ``ros/link.py``."""

from __future__ import annotations

import functools
import queue
import threading
from collections.abc import Callable
from typing import Any

import frames
import numpy as np
import zenoh
from conversion import Conversion

from zswarm import extras
from zswarm.errors import ConfigError


def main() -> None:
    """Speak ROS for a link until it is closed."""
    pipe = frames.Pipe()
    try:
        extras.need("rosbags.typesys", "ros", "the link zenoh")
    except ConfigError as error:
        frames.refuse(str(error))
    from zswarm.ros.over_zenoh import Node, open_session

    set_up = pipe.set_up()
    if any(topic["type"] == frames.EMPTY for topic in set_up["topics"]):
        frames.refuse("the link zenoh calls no services: use a profile whose reset is a topic, or link = rclpy")
    try:
        session = open_session(set_up["connect"], set_up["listen"], local=set_up["local"])
        node = Node(session, set_up["node"], domain=set_up["domain"], distribution=set_up["distribution"])
    except (zenoh.ZError, ValueError) as error:
        frames.refuse(f"zenoh: {str(error).split(' at /')[0][:200]}")
    new = functools.cache(
        lambda kind: empty(node.store, spelled(kind))
    )  # one for all messages: each is sent before the next is made
    conversion = Conversion(new, floats=lambda raw: np.frombuffer(raw, np.float32))
    saying: queue.SimpleQueue[bytes] = queue.SimpleQueue()  # Zenoh's threads only enqueue
    threading.Thread(target=say, args=(pipe, saying), daemon=True).start()
    sending, connected = {}, []
    for number, topic in enumerate(set_up["topics"]):
        kind = spelled(topic["type"])
        if topic["publish"]:
            publisher = node.publisher(topic["name"], kind, reliable=topic["reliable"])
            sending[number] = publishing(publisher, conversion.message(topic))
            connected.append(publisher.connected)
        else:
            taken = taking(saying, number, conversion.body(topic["type"]))
            node.subscribe(topic["name"], kind, taken, reliable=topic["reliable"])
            connected.append(counting(node, topic["name"], kind))
    pipe.publish(sending, connected)
    node.close()
    session.close()


def spelled(kind: str) -> str:
    """A type as ROS 2 spells it."""
    return kind.replace("/", "/msg/")


def empty(store: Any, kind: str) -> Any:
    """A message of rosbags in which all is zero or empty."""
    return store.types[kind](**{name: _empty(store, field) for name, field in store.get_msgdef(kind).fields})


def _empty(store: Any, field: Any) -> Any:
    """The value of a field, as rosbags describes it: a kind and what belongs to it."""
    match field:
        case (1, ("string", _)):
            return ""
        case (1, (name, _)):
            return 0.0 if name.startswith("float") else 0
        case (2, name):
            return empty(store, name)
        case (3, ((_, (name, _)), length)):
            return np.zeros(length, name)
        case (4, ((_, (name, _)), _)):
            return np.zeros(0, name)
    raise ValueError(f"a field of {field}")


def publishing(publisher: Any, message: Callable[[bytes], Any]) -> Callable[[bytes], object]:
    """Publishes a frame's body."""
    return lambda body: publisher.publish(message(body))


def taking(saying: queue.SimpleQueue[bytes], number: int, body: Callable[[Any], bytes]) -> Callable[[Any], None]:
    """A callback that has messages of a topic said."""
    return lambda message: saying.put(frames.frame(number, body(message)))


def counting(node: Any, topic: str, kind: str) -> Callable[[], int]:
    """How many publish a topic."""
    return lambda: int(node.publishers(topic, kind))


def say(pipe: Any, saying: queue.SimpleQueue[bytes]) -> None:
    """Write what was enqueued, all that waits at once."""
    while True:
        waiting = [saying.get()]
        while not saying.empty():
            waiting.append(saying.get())
        pipe.say(b"".join(waiting))


if __name__ == "__main__":
    main()
