"""Survey a network: which servers are there, what they offer, and how fast they answer.

``diagnosis`` finds out why servers are missing.
"""

import queue
import time
from collections import Counter
from contextlib import ExitStack
from functools import partial
from typing import NamedTuple

import msgspec
import zenoh

from zswarm import session
from zswarm.errors import NoRouter, RemoteProtocolError
from zswarm.ot.cluster import diagnosis
from zswarm.ot.cluster.debounce import Newcomers
from zswarm.ot.cluster.diagnosis import DIAL_S, VERSION, other_version, parsed
from zswarm.ot.cluster.events import QUERY_S
from zswarm.ot.cluster.matching import Choice
from zswarm.protocol import codec, keys
from zswarm.protocol.keys import ServerKey
from zswarm.protocol.messages import Offer, Reply, Requirements
from zswarm.session import Reach
from zswarm.system.starting import daemons

OFFER_S = QUERY_S["offer"]
ROUND_TRIPS_WAIT_S = 1.0  # until all servers whose answers are timed are found


class Found(msgspec.Struct, frozen=True):
    """A server and its offer, or why there is none."""

    server: str
    offer: Offer | None
    reason: str = ""
    address: str = ""  # the endpoint it was dialled at; "" through a router

    def mismatch(self, choice: Choice) -> str:
        """Return why it is not used; "" if it is."""
        return self.reason or (
            choice.mismatch(self.offer) if self.offer is not None else ""
        )


class Survey(NamedTuple):
    """The servers that were found."""

    servers: list[Found]  # of the realm
    elsewhere: dict[str, int]  # number of servers in other realms, by realm
    findings: list[
        str
    ]  # why servers that were named, or all, were not found, a line each


def survey(
    realm: str, reach: Reach, *, requirements: Requirements, wait_s: float
) -> Survey:
    """Return all servers that show up within a time, those of a realm with their offers."""
    diagnose = partial(diagnosis.diagnose, realm, starting=daemons() > 0)
    try:
        opened = _open(reach, max(wait_s, DIAL_S))
    except NoRouter:
        return Survey([], {}, diagnose([], reach))
    try:
        tokens, found = _ask_all(opened, realm, requirements, wait_s)
        findings = diagnosis.unreachable(reach) if found else diagnose([opened], reach)
    finally:
        session.close(opened)
    others = Counter(
        other
        for other, _ in {(key.realm, key.server) for key in tokens}
        if other != realm
    )
    return Survey(
        [found[name] for name in sorted(found)], dict(sorted(others.items())), findings
    )


def names(realm: str, reach: Reach, *, wait_s: float) -> list[str]:
    """Return the servers of a realm that show up within a time and answer; none without a router.

    Raises:
        ConfigError: installed keys cannot be used.
    """
    try:
        opened = _open(reach, wait_s)
    except NoRouter:
        return []
    try:
        _, found = _ask_all(opened, realm, Requirements(), wait_s)
    finally:
        session.close(opened)
    return sorted(name for name, server in found.items() if server.offer is not None)


def _open(reach: Reach, timeout_s: float) -> zenoh.Session:
    if reach.through_router:
        return session.open_through_router(reach, timeout_s=timeout_s)
    return session.open_optimizer(reach)


_Inbox = queue.SimpleQueue[ServerKey | Found]


def _ask_all(
    opened: zenoh.Session, realm: str, requirements: Requirements, wait_s: float
) -> tuple[set[ServerKey], dict[str, Found]]:
    """Return the tokens of all realms, and what the servers of one realm offer."""
    inbox: _Inbox = queue.SimpleQueue()

    def on_token(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT and (key := parsed(sample)):
            inbox.put(key)

    opened.liveliness().declare_subscriber(
        keys.ANY_ALIVE, zenoh.handlers.Callback(on_token, indirect=False), history=True
    )
    tokens: set[ServerKey] = set()
    newcomers = Newcomers()
    found: dict[str, Found] = {}
    others: dict[str, ServerKey] = {}  # servers with a token of another version
    asked = 0
    deadline = time.monotonic() + wait_s
    while (now := time.monotonic()) < deadline or len(found) < asked:
        for server in newcomers.take(now):
            _ask(opened, realm, server, requirements, inbox)
        until = min(deadline if now < deadline else now + 2 * OFFER_S, newcomers.due)
        try:
            item = inbox.get(timeout=max(0.0, until - now))
        except queue.Empty:
            if until > deadline and until != newcomers.due:
                break
            continue
        if isinstance(item, Found):
            found[item.server] = item
        elif item not in tokens:
            tokens.add(item)
            if item.realm != realm:
                continue
            if item.version == VERSION:
                asked += 1
                newcomers.add(item.server, time.monotonic())
            else:
                others[item.server] = item
    for server, key in others.items():
        found.setdefault(server, Found(server, None, other_version(key)))
    return tokens, found


def _ask(
    opened: zenoh.Session,
    realm: str,
    server: str,
    requirements: Requirements,
    inbox: _Inbox,
) -> None:
    """Ask a server for its offer; the answer, or why there is none, comes to the inbox."""

    def on_answer(answer: bytes | None, replier: str) -> None:
        reply = "does not answer" if answer is None else read_reply(answer)
        if isinstance(reply, str):
            inbox.put(Found(server, None, reply))
            return
        offer = reply if isinstance(reply, Offer) else None
        links = opened.info.links()
        address = next((link.dst for link in links if str(link.zid) == replier), "")
        inbox.put(Found(server, offer, getattr(reply, "reason", ""), address))

    key, body = keys.offer(realm, server), codec.encode(requirements)
    session.ask(opened, key, body, on_answer, timeout_s=OFFER_S)


def read_reply(body: bytes) -> Reply | str:
    """Return the message of a server, or why it cannot be read."""
    try:
        return codec.decode_reply(body)
    except RemoteProtocolError as error:
        return str(error)
    except Exception as error:  # no memory, or a bug: only this answer is lost
        return f"it cannot be decoded: {error!r}"


class RoundTrips(NamedTuple):
    """Queries to servers and their answers, one after another."""

    servers: int
    seconds: list[float]  # from query to answer, of each
    busy_s: float  # that this program computed for one of them


def round_trips(
    realm: str, reach: Reach, local: str, *, requirements: Requirements, times: int
) -> RoundTrips:
    """Measure how long servers that match take to answer; ask each several times.

    Args:
        local: endpoint of this machine's slots; "": there are none.

    Raises:
        NoRouter: none answered.
    """
    seconds, servers, busy_s = [], 0, 0.0
    with ExitStack() as stack:
        sessions = []
        if reach.through_router:
            sessions.append(session.open_through_router(reach, timeout_s=DIAL_S))
        elif reach.connect or reach.multicast:
            sessions.append(session.open_optimizer(reach))
        if local:
            here = Reach([local], multicast=False)
            sessions.append(session.open_optimizer(here))
        for opened in sessions:
            stack.callback(session.close, opened)
        for opened in sessions:
            _, found = _ask_all(opened, realm, requirements, ROUND_TRIPS_WAIT_S)
            names = [name for name, server in found.items() if server.offer is not None]
            servers += len(names)
            begun = time.process_time()
            for name in names:
                seconds += [
                    _round_trip(opened, realm, name, requirements) for _ in range(times)
                ]
            busy_s += time.process_time() - begun
    return RoundTrips(servers, seconds, busy_s / max(1, len(seconds)))


def _round_trip(
    opened: zenoh.Session, realm: str, server: str, requirements: Requirements
) -> float:
    inbox: _Inbox = queue.SimpleQueue()
    begun = time.perf_counter()
    _ask(opened, realm, server, requirements, inbox)
    inbox.get()
    return time.perf_counter() - begun
