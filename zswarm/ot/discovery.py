"""Who is there: the servers of a network with their offers, and why one is not found (docs/network.md, "Diagnosis")."""

import collections
import contextlib
import errno
import queue
import socket
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import msgspec
import zenoh

from zswarm import endpoint, session
from zswarm.endpoint import Endpoint
from zswarm.errors import NoRouter, RemoteProtocolError
from zswarm.ot.matching import Choice
from zswarm.ot.newcomers import Newcomers
from zswarm.protocol import codec, keys
from zswarm.protocol.keys import ServerKey
from zswarm.protocol.messages import Offer, Requirements
from zswarm.security import handshake
from zswarm.security.keyring import Keyring
from zswarm.session import Reach

OFFER_S = 3.0  # for an offer, at most
DIAL_S = 2.0  # for one endpoint to answer
SCOUT_S = 1.0  # for answers to multicast
TRIPS_WAIT_S = 1.0  # until all servers are there whose answers are timed
NAMED = 5  # servers or endpoints that a line names


class Found(msgspec.Struct, frozen=True):
    """A server, or why nothing is known of it."""

    server: str
    offer: Offer | None
    reason: str = ""
    address: str = ""  # the endpoint it was dialled at; "" through a router

    def mismatch(self, choice: Choice) -> str:
        """Why it is not used; "" when it is."""
        return self.reason or (choice.mismatch(self.offer) if self.offer is not None else "")


class Survey(NamedTuple):
    """What a look around showed."""

    servers: list[Found]  # of the realm
    elsewhere: dict[str, int]  # servers of other realms, by realm
    findings: list[str]  # where no server was found: why, a line each


def survey(realm: str, reach: Reach, *, requirements: Requirements, wait_s: float) -> Survey:
    """All servers that show up within a time, those of a realm with their offers."""
    try:
        if reach.through_router:
            opened = session.open_through_router(reach, timeout_s=max(wait_s, DIAL_S))
        else:
            opened = session.open_optimizer(reach)
    except NoRouter:
        return Survey([], {}, diagnose(realm, [], reach))
    try:
        tokens, found = _ask_all(opened, realm, requirements, wait_s)
        realms = collections.Counter(key.realm for key in tokens if key.realm != realm)
        findings: list[str] = []
        if not found:
            findings = diagnose(realm, [opened], reach)
    finally:
        session.close(opened)
    return Survey([found[server] for server in sorted(found)], dict(sorted(realms.items())), findings)


def _ask_all(
    opened: zenoh.Session, realm: str, requirements: Requirements, wait_s: float
) -> tuple[set[ServerKey], dict[str, Found]]:
    """The tokens of all realms, and what the servers of one say."""
    inbox: queue.SimpleQueue[ServerKey | Found] = queue.SimpleQueue()

    def on_token(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT and (key := _parsed(sample)):
            inbox.put(key)

    opened.liveliness().declare_subscriber(keys.ANY_ALIVE, zenoh.handlers.Callback(on_token, indirect=False), history=True)
    tokens: set[ServerKey] = set()
    newcomers = Newcomers[str]()
    found: dict[str, Found] = {}
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
            if item.realm == realm:
                asked += 1
                if item.version == f"v{keys.VERSION}":
                    newcomers.add(item.server, time.monotonic())
                else:
                    inbox.put(Found(item.server, None, _other_version(item)))
    return tokens, found


def _ask(
    opened: zenoh.Session,
    realm: str,
    server: str,
    requirements: Requirements,
    answers: "queue.SimpleQueue[ServerKey | Found]",
) -> None:
    """Have one server's offer, or why there is none, put among the answers."""
    replies: list[Found] = []

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is None:
            return
        try:
            answer = codec.decode_reply(reply.ok.payload.to_bytes())
        except RemoteProtocolError as error:
            replies.append(Found(server, None, str(error)))
            return
        replier = reply.replier_id.zid if reply.replier_id is not None else None
        address = next((link.dst for link in opened.info.links() if link.zid == replier), "")
        if isinstance(answer, Offer):
            replies.append(Found(server, answer, "", address))
        else:
            replies.append(Found(server, None, str(getattr(answer, "reason", "")), address))

    def on_end() -> None:
        answers.put(replies[0] if replies else Found(server, None, "does not answer"))

    opened.get(
        keys.offer(realm, server),
        zenoh.handlers.Callback(on_reply, on_end, indirect=False),
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=OFFER_S,
        payload=codec.encode(requirements),
    )


class Trips(NamedTuple):
    """Questions to servers and their answers, one after another."""

    servers: int
    seconds: list[float]  # from question to answer, of each
    busy_s: float  # that this program computed for one of them


def trips(realm: str, reach: Reach, local: str, *, requirements: Requirements, times: int) -> Trips:
    """How long servers that match take to answer, each asked so many times.

    Args:
        local: where this machine's slots are dialled, too; "": there are none.

    Raises:
        NoRouter: none answered.
    """
    opened = []
    if reach.through_router:
        opened.append(session.open_through_router(reach, timeout_s=DIAL_S))
        reach = Reach((), multicast=False)
    if local or not opened:
        opened.append(session.open_optimizer(reach._replace(connect=[*reach.connect, *([local] if local else [])])))
    seconds, servers, busy = [], 0, 0.0
    try:
        for one in opened:
            found = _ask_all(one, realm, requirements, TRIPS_WAIT_S)[1]
            there = [server for server, what in found.items() if what.offer is not None]
            servers += len(there)
            begun = time.process_time()
            seconds += [_trip(one, realm, server, requirements) for server in there for _ in range(times)]
            busy += time.process_time() - begun
    finally:
        for one in opened:
            session.close(one)
    return Trips(servers, seconds, busy / max(1, len(seconds)))


def _trip(opened: zenoh.Session, realm: str, server: str, requirements: Requirements) -> float:
    answers: queue.SimpleQueue[ServerKey | Found] = queue.SimpleQueue()
    begun = time.perf_counter()
    _ask(opened, realm, server, requirements, answers)
    answers.get()
    return time.perf_counter() - begun


# ---- why nobody is found


class Look(NamedTuple):
    """What is at an endpoint."""

    at: str
    fault: str  # why nobody there can be asked; "" else
    router: bool = False
    servers: frozenset[ServerKey] = frozenset()  # seen through it, of any realm


def diagnose(realm: str, opened: Sequence[zenoh.Session], reach: Reach, *, known: Iterable[str] = ()) -> list[str]:
    """Why servers are not found, and what to set: a line each. Takes some seconds: dials what is to be dialled, listens around.

    Args:
        opened: the sessions that found nobody but ``known``.
    """
    connect, multicast, through_router, ring = reach
    tcp = "tcp" if ring is None else "tls"
    if not connect and not multicast:
        return [f"multicast is off and connect is empty: nobody can be found; name a server or router: --connect {tcp}/HOST:7467"]
    lines: list[str] = []
    around = frozenset(key for one in opened for key in _tokens(one))
    groups = [[text] for text in connect]  # of endpoints that lead to one program
    if multicast and not connect:
        if fault := session.multicast_fault():
            lines.append(f"multicast does not work on this machine: {fault}; name a server or router with --connect")
        elif not around and not (groups := _scout(routers=through_router)):
            who, port = ("router", 7466) if through_router else ("server", session.PORT)
            lines.append(
                f"no {who} answers to multicast: none runs, or the network does not carry it (UDP {session.SCOUTING_GROUP}); "
                f"name one with --connect {tcp}/HOST:{port}"
            )
    with ThreadPoolExecutor(16) as pool:
        looks = list(pool.map(lambda group: _look(group, ring), groups))
    faults: dict[str, list[str]] = {}
    for look in looks:
        if fault := look.fault or _misplaced(look, realm, set(known), reach):
            faults.setdefault(fault, []).append(look.at)
    lines += [f"{_some(ends)}: {fault}" for fault, ends in faults.items()]
    seen = around.union(*(look.servers for look in looks))
    lines += [f"{key.server} {_other_version(key)}" for key in sorted(seen) if key.realm == realm and key.version != _VERSION]
    if not any(key.realm == realm for key in seen):
        realms = collections.Counter(key.realm for key in seen)
        lines += [
            f"{_servers(count)} in realm {other}, none in {realm}: use --realm {other}, or start servers with --realm {realm}"
            for other, count in sorted(realms.items())
        ]
    return lines


_VERSION = f"v{keys.VERSION}"


def _scout(*, routers: bool) -> list[list[str]]:
    """The endpoints of each server and router that answers to multicast."""
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/address", f'"{session.SCOUTING_GROUP}"')
    scout = zenoh.scout(what="router" if routers else "peer|router", config=config)
    time.sleep(SCOUT_S)
    answers: dict[str, list[str]] = {}
    while (hello := scout.try_recv()) is not None:
        answers[str(hello.zid)] = list(hello.locators)
    scout.stop()
    return [ends for ends in answers.values() if ends]  # an optimizer has none


def _look(group: list[str], ring: Keyring | None) -> Look:
    """What is at the first of these endpoints that can be dialled."""
    for text in group:
        fault = _unreachable(endpoint.parse(text)) or handshake.refusal(endpoint.parse(text), ring)
        if not fault:
            break
    else:
        return Look(text, fault)
    try:
        opened = session.open_through_router(Reach([text], multicast=False, keyring=ring), timeout_s=DIAL_S)  # or a server
    except NoRouter:
        if ring is None and handshake.speaks_tls(endpoint.parse(text)):
            return Look(text, "the program there lets in members only: have keys issued, and install them with zswarm-keys join")
        return Look(text, "something answers there, but no zswarm or zenoh program that lets this one in")
    try:
        return Look(text, "", bool(list(opened.info.routers_zid())), _tokens(opened))
    finally:
        session.close(opened)


def _unreachable(at: Endpoint) -> str:
    """Why nothing can be dialled there; "" when it can, or when only zenoh can tell."""
    try:
        if at.protocol == endpoint.SOCKET_FILE:
            with socket.socket(socket.AF_UNIX) as dialled:
                dialled.connect(at.host)
        elif at.protocol in ("udp", "quic"):
            socket.getaddrinfo(at.host, at.port, type=socket.SOCK_DGRAM)
        else:
            socket.create_connection((at.host, at.port), DIAL_S).close()
    except socket.gaierror:
        return f"the name {at.host} is not known on this network"
    except ConnectionRefusedError:
        return "nothing listens there (connection refused): start zswarm-ss or zswarm-router, or mend the port"
    except TimeoutError:
        return f"no answer in {DIAL_S:g} s: the machine is off, or a firewall is between"
    except OSError as error:
        if error.errno in (errno.EHOSTUNREACH, errno.ENETUNREACH):
            return f"this machine has no way there ({error.strerror}): mend the address or the network"
        return f"cannot be dialled: {error.strerror}"
    return ""


def _misplaced(look: Look, realm: str, known: set[str], reach: Reach) -> str:
    """What is wrong at an endpoint that answers; "" when it is not to blame."""
    ours = sorted(key.server for key in look.servers if key.realm == realm and key.version == _VERSION)
    if look.router:
        if not look.servers and reach.keyring is not None:
            return (
                f"this router is there, but shows no server to {reach.keyring.name}: none is connected to it, or its list of"
                f" members does not have {reach.keyring.name}"
            )
        if not look.servers:
            return "this router is there, but no server is connected to it: start servers with --connect and its endpoint"
        beyond = [server for server in ours if server not in known]
        if beyond and not reach.through_router:
            return (
                f"this router sees {_some(beyond)}, which cannot be dialled from here: "
                "set through_router = true (--through-router)"
            )
    elif not look.servers and reach.keyring is not None:
        return (
            f"the program there shows no server to {reach.keyring.name}, who may not be, or no more be, in its list of members:"
            " bring the newest list there (zswarm-keys join members.zkeys) and reload it"
        )
    elif not look.servers:
        return "a zenoh program is there, but neither a zswarm server nor a router"
    elif reach.through_router:
        return "this is a server, no router: leave through_router (--through-router) away, or name a router"
    return ""


def _tokens(opened: zenoh.Session) -> frozenset[ServerKey]:
    """The servers of all realms and versions that a session sees."""
    found = set()
    with contextlib.suppress(zenoh.ZError):  # the session is closing
        for reply in opened.liveliness().get(keys.ANY_ALIVE, timeout=DIAL_S):
            if reply.ok is not None and (key := _parsed(reply.ok)):
                found.add(key)
    return frozenset(found)


def _parsed(sample: zenoh.Sample) -> ServerKey | None:
    try:
        return keys.parse_server_key(str(sample.key_expr))
    except RemoteProtocolError:
        return None


def _other_version(key: ServerKey) -> str:
    return f"speaks version {key.version} of the protocol, this program {_VERSION}: install the same zswarm on both"


def _servers(count: int) -> str:
    return f"{count} server{'s' if count != 1 else ''}"


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
