"""ROS 2 over Zenoh where no ROS is installed: a node that speaks as those do that run with rmw_zenoh_cpp.

Format: docs/design.md of github.com/ros2/rmw_zenoh, and its sources. A message is CDR behind four bytes; its key is
``<domain>/<topic>/<type in DDS's spelling>/<hash of the type>``; attached are a number, a time and who publishes it. Liveliness
tokens say which nodes, publishers and subscriptions there are: ``ros2 topic list`` and others read them.

This file needs eclipse-zenoh, rosbags and numpy alone, and is shipped with nodes for robots.
"""

from __future__ import annotations

import itertools
import json
import os
import struct
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import zenoh
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

ROUTER = "tcp/127.0.0.1:7447"  # where rmw_zenohd listens
ATTACHMENT = struct.Struct("<qqB16s")  # number, time in ns, length of the name, name of the publisher
HASHLESS = ("humble",)  # distributions without hashes of types
NO_HASH = "TypeHashNotSupported"
RELIABLE, BEST_EFFORT = "", "2"  # in a token; the first is the default
DEPTH = 1000  # that tokens name: messages that wait


def open_session(connect: Sequence[str], listen: Sequence[str], *, local: bool = True) -> zenoh.Session:
    """A session as ROS nodes have it: a peer that dials endpoints, listens, and is told of others by those.

    Args:
        connect: endpoints to dial, again and again until they are there.
        listen: endpoints to listen on; none: any free port.
        local: of this machine.

    Raises:
        zenoh.ZError: an endpoint is none, or cannot be listened on.
    """
    anywhere = "tcp/127.0.0.1:0" if local else "tcp/0.0.0.0:0"
    config = {
        "mode": "peer",
        "connect": {"endpoints": list(connect), "timeout_ms": -1, "exit_on_failure": False,
                    "retry": {"period_init_ms": 20, "period_max_ms": 1000, "period_increase_factor": 1.5}},
        "listen": {"endpoints": list(listen) or [anywhere]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        "transport": {"shared_memory": {"enabled": False}},
    }  # fmt: skip
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


class Node:
    """A node of ROS 2.

    Attributes:
        store: the types of the distribution's messages, and their CDR (rosbags).
    """

    def __init__(self, session: zenoh.Session, name: str, *, domain: int = 0, distribution: str = "jazzy") -> None:
        """Appear.

        Args:
            name: its name, in the root's namespace.
            domain: ROS_DOMAIN_ID.
            distribution: of ROS; humble has no hashes of types.

        Raises:
            ValueError: rosbags does not know the distribution.
        """
        known = {store.name.partition("_")[2].lower(): store for store in Stores if store.name.startswith("ROS2_")}
        if distribution not in known:
            raise ValueError(f"no distribution {distribution!r} of ROS 2; known are {', '.join(known)}")
        self.store = get_typestore(known[distribution])
        self._session, self._domain, self._hashed = session, domain, distribution not in HASHLESS
        self._self = f"@ros2_lv/{domain}/{session.info.zid()}/0"
        self._name = name
        self._numbers = itertools.count(1)
        self._others: set[str] = set()  # tokens of all publishers and subscriptions
        self._changing = threading.Lock()
        self._declared: list[Any] = [
            session.liveliness().declare_subscriber(f"@ros2_lv/{domain}/**", self._changed, history=True),
            session.liveliness().declare_token(f"{self._self}/0/NN/%/%/{name}"),
        ]

    def publisher(self, topic: str, kind: str, *, reliable: bool = True) -> Publisher:
        """Publish a topic.

        Args:
            topic: its name from the root, such as ``/robot_0/cmd_vel``.
            kind: its type, such as ``geometry_msgs/msg/Twist``.
        """
        publisher = Publisher(self, self._session, topic, kind, self.key(topic, kind))
        self._declared += [publisher, self._token("MP", topic, kind, reliable)]
        return publisher

    def subscribe(self, topic: str, kind: str, callback: Callable[[Any], None], *, reliable: bool = True) -> None:
        """Have messages of a topic given to a callback, on Zenoh's thread; what is no such message is dropped.

        Args:
            topic: its name from the root.
            kind: its type.
            callback: takes a message as rosbags has it.
        """

        def taken(sample: zenoh.Sample) -> None:
            try:
                message = self.store.deserialize_cdr(sample.payload.to_bytes(), kind)
            except SerdeError:
                return
            callback(message)

        self._declared += [
            self._session.declare_subscriber(self.key(topic, kind), taken),
            self._token("MS", topic, kind, reliable),
        ]

    def publishers(self, topic: str, kind: str) -> int:
        """How many publish a topic."""
        return self._count("MP", topic, kind)

    def subscriptions(self, topic: str, kind: str) -> int:
        """How many have a topic given to them."""
        return self._count("MS", topic, kind)

    def key(self, topic: str, kind: str) -> str:
        """The key of a topic's messages."""
        return f"{self._domain}/{topic.strip('/')}/{self._type(kind)}"

    def close(self) -> None:
        """Disappear."""
        for declared in reversed(self._declared):
            declared.undeclare()
        self._declared.clear()

    def _type(self, kind: str) -> str:
        """Type and hash of it, as keys and tokens have them."""
        package, _, name = kind.partition("/msg/")
        return f"{package}::msg::dds_::{name}_/{self.store.hash_rihs01(kind) if self._hashed else NO_HASH}"

    def _token(self, what: str, topic: str, kind: str, reliable: bool) -> Any:
        quality = f"{RELIABLE if reliable else BEST_EFFORT}::,{DEPTH}:,:,:,,"
        return self._session.liveliness().declare_token(
            f"{self._self}/{next(self._numbers)}/{what}/%/%/{self._name}/{_mangled(topic)}/{self._type(kind)}/{quality}"
        )

    def _changed(self, sample: zenoh.Sample) -> None:
        """Somebody appeared or disappeared."""
        token = str(sample.key_expr)
        with self._changing:
            (self._others.add if sample.kind == zenoh.SampleKind.PUT else self._others.discard)(token)

    def _count(self, what: str, topic: str, kind: str) -> int:
        wanted = f"/{_mangled(topic)}/{self._type(kind)}/"
        with self._changing:
            return sum(f"/{what}/" in token and wanted in token for token in self._others)


class Publisher:
    """Publishes a topic of a node."""

    def __init__(self, node: Node, session: zenoh.Session, topic: str, kind: str, key: str) -> None:
        self._node, self._topic, self._kind = node, topic, kind
        self._publisher = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.BLOCK, reliability=zenoh.Reliability.RELIABLE, express=True
        )
        self._gid, self._sent = os.urandom(16), 0

    def publish(self, message: Any) -> None:
        """Send a message as rosbags has it."""
        self._sent += 1
        attachment = ATTACHMENT.pack(self._sent, time.time_ns(), len(self._gid), self._gid)
        body = self._node.store.serialize_cdr(message, self._kind)
        self._publisher.put(bytes(body), attachment=attachment)

    def connected(self) -> int:
        """How many have the topic given to them, once Zenoh knows the way."""
        status: Any = self._publisher.matching_status  # zenoh's stub calls it a bool
        return self._node.subscriptions(self._topic, self._kind) if status.matching else 0

    def undeclare(self) -> None:
        """Publish no more."""
        self._publisher.undeclare()


def _mangled(topic: str) -> str:
    """A topic as one part of a token."""
    return "%" + topic.strip("/").replace("/", "%")
