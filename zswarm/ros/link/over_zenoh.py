"""ROS 2 over Zenoh where no ROS is installed: a node that speaks like those with rmw_zenoh_cpp.

Format: docs/design.md of github.com/ros2/rmw_zenoh, and its sources. A message is CDR after four
bytes; its key is ``<domain>/<topic>/<DDS name of the type>/<hash of the type>``; its attachment
has a number, a time and the publisher's id. Liveliness tokens announce nodes, publishers and
subscriptions: ``ros2 topic list`` reads them.

This file needs only eclipse-zenoh, rosbags and numpy, and is shipped with nodes for robots.
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
# Number, time in ns, length of the id, publisher's id.
ATTACHMENT = struct.Struct("<qqB16s")
HASHLESS = ("humble",)  # distributions without hashes of types
NO_HASH = "TypeHashNotSupported"
PUBLISHER, SUBSCRIPTION = "MP", "MS"  # in a token
RELIABLE, BEST_EFFORT = "", "2"  # in a token; the first is the default
DEPTH = 1000  # of queues, in tokens


def open_session(
    connect: Sequence[str], listen: Sequence[str], *, local: bool = True
) -> zenoh.Session:
    """Open a session like that of a ROS node: a peer that dials, listens, and gossips.

    It dials endpoints until they answer, and listens on any free port unless ``listen`` names some.
    """
    anywhere = "tcp/127.0.0.1:0" if local else "tcp/0.0.0.0:0"
    retry = {"period_init_ms": 20, "period_max_ms": 1000, "period_increase_factor": 1.5}
    dial = {"timeout_ms": -1, "exit_on_failure": False, "retry": retry}
    config = {
        "mode": "peer",
        "connect": {"endpoints": list(connect), **dial},
        "listen": {"endpoints": list(listen) or [anywhere]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        "transport": {"shared_memory": {"enabled": False}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


class ZenohNode:
    """A node of ROS 2.

    Attributes:
        store: the types of the distribution's messages, and their CDR (rosbags).
    """

    def __init__(
        self,
        session: zenoh.Session,
        name: str,
        *,
        domain: int = 0,
        distribution: str = "jazzy",
    ) -> None:
        """Announce it in the root's namespace."""
        ros2 = [store for store in Stores if store.name.startswith("ROS2_")]
        known = {store.name.partition("_")[2].lower(): store for store in ros2}
        if distribution not in known:
            names = ", ".join(known)
            raise ValueError(
                f"no distribution {distribution!r} of ROS 2; known are {names}"
            )
        self.store = get_typestore(known[distribution])
        self._session, self._domain, self._hashed = (
            session,
            domain,
            distribution not in HASHLESS,
        )
        self._self = f"@ros2_lv/{domain}/{session.info.zid()}/0"
        self._name = name
        self._numbers = itertools.count(1)
        self._others: set[str] = set()  # tokens of all publishers and subscriptions
        self._changing = threading.Lock()
        live, all_tokens = session.liveliness(), f"@ros2_lv/{domain}/**"
        self._declared: list[Any] = [
            live.declare_subscriber(all_tokens, self._changed, history=True),
            live.declare_token(f"{self._self}/0/NN/%/%/{name}"),
        ]

    def publisher(
        self, topic: str, kind: str, *, reliable: bool = True
    ) -> TopicPublisher:
        """Publish a topic such as ``/robot_0/cmd_vel`` of ``geometry_msgs/msg/Twist``."""
        publisher = TopicPublisher(self, self._session, topic, kind)
        self._declared += [publisher, self._token(PUBLISHER, topic, kind, reliable)]
        return publisher

    def subscribe(
        self,
        topic: str,
        kind: str,
        callback: Callable[[Any], None],
        *,
        reliable: bool = True,
    ) -> Callable[[], int]:
        """Pass a topic's messages to a callback, on Zenoh's thread; others are dropped.

        Returns:
            A function that counts the topic's publishers.
        """

        def received(sample: zenoh.Sample) -> None:
            try:
                message = self.store.deserialize_cdr(sample.payload.to_bytes(), kind)
            except SerdeError:
                return
            callback(message)

        self._declared += [
            self._session.declare_subscriber(self.key(topic, kind), received),
            self._token(SUBSCRIPTION, topic, kind, reliable),
        ]
        return lambda: self.count(PUBLISHER, topic, kind)

    def count(self, what: str, topic: str, kind: str) -> int:
        """Return the number of a topic's publishers or subscriptions."""
        wanted = f"/{_mangled(topic)}/{self._type(kind)}/"
        with self._changing:
            return sum(f"/{what}/" in token and wanted in token for token in self._others)

    def key(self, topic: str, kind: str) -> str:
        """Return the key of a topic's messages."""
        return f"{self._domain}/{topic.strip('/')}/{self._type(kind)}"

    def close(self) -> None:
        """Withdraw it."""
        for declared in reversed(self._declared):
            declared.undeclare()
        self._declared.clear()

    def _type(self, kind: str) -> str:
        """Return a type and its hash, as keys and tokens have them."""
        package, _, name = kind.partition("/msg/")
        hash_ = self.store.hash_rihs01(kind) if self._hashed else NO_HASH
        return f"{package}::msg::dds_::{name}_/{hash_}"

    def _token(self, what: str, topic: str, kind: str, reliable: bool) -> Any:
        quality = f"{RELIABLE if reliable else BEST_EFFORT}::,{DEPTH}:,:,:,,"
        owner = f"{self._self}/{next(self._numbers)}/{what}/%/%/{self._name}"
        token = f"{owner}/{_mangled(topic)}/{self._type(kind)}/{quality}"
        return self._session.liveliness().declare_token(token)

    def _changed(self, sample: zenoh.Sample) -> None:
        appeared = sample.kind == zenoh.SampleKind.PUT
        with self._changing:
            (self._others.add if appeared else self._others.discard)(str(sample.key_expr))


class TopicPublisher:
    """Publishes a topic of a node."""

    def __init__(
        self, node: ZenohNode, session: zenoh.Session, topic: str, kind: str
    ) -> None:
        self._node, self._topic, self._kind = node, topic, kind
        self._publisher = session.declare_publisher(
            node.key(topic, kind),
            congestion_control=zenoh.CongestionControl.BLOCK,
            reliability=zenoh.Reliability.RELIABLE,
            express=True,
        )
        self._gid, self._sent = os.urandom(16), 0

    def publish(self, message: Any) -> None:
        """Send a message of rosbags."""
        self._sent += 1
        attachment = ATTACHMENT.pack(
            self._sent, time.time_ns(), len(self._gid), self._gid
        )
        body = self._node.store.serialize_cdr(message, self._kind)
        self._publisher.put(bytes(body), attachment=attachment)

    def connected(self) -> int:
        """Return the number of subscriptions, once Zenoh has a route to them."""
        status: Any = self._publisher.matching_status  # zenoh's stub calls it a bool
        return (
            self._node.count(SUBSCRIPTION, self._topic, self._kind)
            if status.matching
            else 0
        )

    def undeclare(self) -> None:
        """Withdraw it."""
        self._publisher.undeclare()


def _mangled(topic: str) -> str:
    """Return a topic as one part of a token."""
    return "%" + topic.strip("/").replace("/", "%")
