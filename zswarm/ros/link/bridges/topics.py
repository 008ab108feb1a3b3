"""The topics of a link, connected through a ROS client library."""

from __future__ import annotations

import importlib
from typing import Any, Callable  # noqa: UP035  Python 3.8

import frames
from conversion import Conversion

Send = Callable[[Any], object]
Count = Callable[[], int]


class Topics:
    """Connects topics; a bridge overrides what differs between libraries.

    Attributes:
        sending: functions that publish a body, by the number of the topic.
        connected: functions that count the other ends, of all topics.
    """

    def __init__(self, write: Callable[[bytes], object], conversion: Conversion) -> None:
        self._write, self._conversion = write, conversion
        self.sending: dict[int, Send] = {}
        self.connected: list[Count] = []

    def connect(self, topics: list[dict[str, Any]]) -> None:
        """Publish, subscribe to, call or offer each."""
        for number, topic in enumerate(topics):
            connect = (
                self._connect_service if topic["type"] == frames.EMPTY else self._connect
            )
            self.connected.append(connect(number, topic))

    def _publish(self, topic: dict[str, Any]) -> tuple[Send, Count]:
        """Return functions that publish a message, and that count subscriptions."""
        raise NotImplementedError

    def _subscribe(self, topic: dict[str, Any], received: Send) -> Count:
        """Subscribe to a topic; return a function that counts publishers."""
        raise NotImplementedError

    def _hear_anew(self, topic: dict[str, Any], heard: Send) -> None:
        """Call back once, with a message that is published from now on.

        Args:
            topic: one that is subscribed to; on its connection older messages may wait.
            heard: what is called.
        """
        raise NotImplementedError

    def _call(self, service: str, returned: Callable[[], object]) -> tuple[Send, Count]:
        """Return functions that call an empty service, and whether it exists.

        Args:
            service: its name.
            returned: to be called after each call of the service that returned.
        """
        raise NotImplementedError

    def _offer(self, service: str, called: Callable[[], object]) -> None:
        """Offer an empty service."""
        raise NotImplementedError

    def _connect(self, number: int, topic: dict[str, Any]) -> Count:
        if topic["publish"]:
            publish, count = self._publish(topic)
            message = self._conversion.message(topic)
            self.sending[number] = lambda body: publish(message(body))
            return count
        body = self._conversion.body(topic["type"])
        return self._subscribe(
            topic, lambda message: self._write(frames.frame(number, body(message)))
        )

    def _connect_service(self, number: int, topic: dict[str, Any]) -> Count:
        def report(clock: bytes = b"") -> None:
            self._write(frames.frame(number, frames.RESET.pack(0) + clock))

        if not topic["publish"]:
            self._offer(topic["name"], report)
            return lambda: 1
        returned: Callable[[], object] = report
        if (clock := topic["clock"]) is not None:
            body = self._conversion.body(frames.CLOCKS)
            heard = lambda message: report(body(message))  # noqa: E731
            returned = lambda: self._hear_anew(clock, heard)  # noqa: E731
        self.sending[number], count = self._call(topic["name"], returned)
        return count


def message_class(name: str) -> Any:
    """Return the message class of a type, such as ``nav_msgs/Odometry``."""
    package, _, name = name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def new(name: str) -> Any:
    """Return an empty message of a type."""
    return message_class(name)()
