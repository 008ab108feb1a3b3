"""Bridge to ROS 2 over Zenoh, without ROS: run by zswarm's Python, as a child of ``link.py``."""

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
from topics import Count, Send, Topics

from zswarm.errors import ConfigError
from zswarm.system import extras

NO_SERVICES = (
    "the link zenoh calls no services: use a profile whose reset is a topic, "
    "or link = rclpy"
)


def main() -> None:
    """Speak ROS for a link until it is closed."""
    pipe = frames.Pipe()
    try:
        extras.need("rosbags.typesys", "ros", "the link zenoh")
    except ConfigError as error:
        frames.refuse(str(error))
    from zswarm.ros.link.over_zenoh import ZenohNode, open_session

    set_up = pipe.set_up()
    if any(topic["type"] == frames.EMPTY for topic in set_up["topics"]):
        frames.refuse(NO_SERVICES)
    domain, distribution = set_up["domain"], set_up["distribution"]
    try:
        session = open_session(set_up["connect"], set_up["listen"], local=set_up["local"])
        node = ZenohNode(
            session, set_up["node"], domain=domain, distribution=distribution
        )
    except (zenoh.ZError, ValueError) as error:
        frames.refuse(f"zenoh: {str(error).split(' at /')[0][:200]}")
    # Zenoh's threads only enqueue.
    waiting: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=write, args=(pipe, waiting), daemon=True).start()
    topics = ZenohTopics(waiting.put, node)
    topics.connect(set_up["topics"])
    pipe.publish(topics.sending, topics.connected)
    node.close()
    session.close()


class ZenohTopics(Topics):  # type: ignore[misc]  # found only at run time
    """Topics through a node on Zenoh."""

    def __init__(self, write: Callable[[bytes], object], node: Any) -> None:
        # Each message is sent before the next is made: one object of a type serves for all.
        new = functools.cache(lambda kind: empty(node.store, spelled(kind)))
        super().__init__(
            write, Conversion(new, floats=lambda raw: np.frombuffer(raw, np.float32))
        )
        self._node = node

    def _publish(self, topic: dict[str, Any]) -> tuple[Send, Count]:
        name, kind = topic["name"], spelled(topic["type"])
        publisher = self._node.publisher(name, kind, reliable=topic["reliable"])
        return publisher.publish, publisher.connected

    def _subscribe(self, topic: dict[str, Any], received: Send) -> Count:
        name, kind = topic["name"], spelled(topic["type"])
        count: Count = self._node.subscribe(
            name, kind, received, reliable=topic["reliable"]
        )
        return count


def spelled(kind: str) -> str:
    """Return the name of a type in ROS 2."""
    return kind.replace("/", "/msg/")


def empty(store: Any, kind: str) -> Any:
    """Return a message of rosbags whose fields are zero or empty."""
    fields = store.get_msgdef(kind).fields
    return store.types[kind](**{name: _empty(store, field) for name, field in fields})


def _empty(store: Any, field: Any) -> Any:
    """Return the value of a field, which rosbags describes by a kind and its parameters."""
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


def write(pipe: Any, waiting: queue.SimpleQueue[bytes]) -> None:
    """Write all waiting frames of a queue at once."""
    while True:
        batch = [waiting.get()]
        while not waiting.empty():
            batch.append(waiting.get())
        pipe.write(b"".join(batch))


if __name__ == "__main__":
    main()
