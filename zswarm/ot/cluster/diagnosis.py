"""Find out why servers are not found (docs/network.md, "Diagnosis")."""

import contextlib
import errno
import socket
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import zenoh

from zswarm import session
from zswarm.errors import ConfigError, NoRouter, RemoteProtocolError
from zswarm.protocol import endpoint, keys
from zswarm.protocol.endpoint import Endpoint
from zswarm.protocol.keys import ServerKey
from zswarm.security import tls_diagnosis
from zswarm.security.keyring import Keyring
from zswarm.session import Reach
from zswarm.system import scouting
from zswarm.system.starting import daemons

DIAL_S = 2.0  # for one endpoint to answer
SCOUT_S = 1.0  # for answers to multicast
ANSWERS, DIALLED = 256, 16  # to multicast; endpoints of one, at most
NAMED = 5  # servers or endpoints that a line names
VERSION = keys.CURRENT
STARTING = "a server of this machine is starting: try again in a moment"


class DialResult(NamedTuple):
    """What dialling an endpoint showed."""

    at: str
    fault: str  # why nothing there can be asked; "" if it can
    router: bool = False
    servers: frozenset[ServerKey] = frozenset()  # seen through it, of any realm


def diagnose(
    realm: str,
    opened: Sequence[zenoh.Session],
    reach: Reach,
    *,
    known: Iterable[str] = (),
    starting: bool = False,
) -> list[str]:
    """Return why servers are not found, and what to set, a line each.

    It takes some seconds: endpoints are dialled, and multicast is listened to.

    Args:
        opened: sessions that found no servers but ``known``.
        starting: whether a server of this machine was starting when the search began.
    """
    tcp = "tcp" if reach.keyring is None else "tls"
    if not reach.connect and not reach.multicast:
        return [
            "multicast is off and connect is empty: no server can be found; name a server or"
            f" router: --connect {tcp}/HOST:7467"
        ]
    if not reach.connect and not known and (starting or daemons()):
        return [STARTING]
    lines: list[str] = []
    seen = {key for one in opened for key in _tokens(one)}
    groups = [[text] for text in reach.connect]  # of endpoints that lead to one program
    if not reach.connect:
        silent = bool(seen or scouting.fault())
        groups = [] if silent else _scout(tcp, routers=reach.through_router)
        if not groups:
            lines += _no_multicast(reach, tcp, answered=bool(seen))
    with ThreadPoolExecutor(16) as pool:
        results = list(pool.map(partial(_dial, ring=reach.keyring), groups))
    faults = []
    for result in results:
        seen |= result.servers
        fault = result.fault or _misplaced(result, realm, set(known), reach)
        faults.append((result.at, fault))
    return lines + _by_fault(faults) + _not_used(seen, realm)


def unreachable(reach: Reach) -> list[str]:
    """Return which endpoints of ``connect`` cannot be dialled, and why, a line each."""
    with ThreadPoolExecutor(16) as pool:
        faults = list(pool.map(_unreachable, map(endpoint.parse, reach.connect)))
    return _by_fault(zip(reach.connect, faults, strict=True))


def _by_fault(found: Iterable[tuple[str, str]]) -> list[str]:
    """Return a line for each fault with the endpoints that have it."""
    faults: defaultdict[str, list[str]] = defaultdict(list)
    for at, fault in found:
        if fault:
            faults[fault].append(at)
    return [f"{_some(ends)}: {fault}" for fault, ends in faults.items()]


def _no_multicast(reach: Reach, tcp: str, *, answered: bool) -> list[str]:
    if fault := scouting.fault():
        name = "name a server or router with --connect"
        return [f"multicast does not work on this machine: {fault}; {name}"]
    if answered:
        return []
    who, port = ("router", 7466) if reach.through_router else ("server", session.PORT)
    return [
        f"no {who} answers to multicast: none runs, or the network does not carry it"
        f" (UDP {scouting.GROUP}); name one with --connect {tcp}/HOST:{port}"
    ]


def _not_used(seen: Iterable[ServerKey], realm: str) -> list[str]:
    """Return which servers of the network cannot be used."""
    ours = sorted(key for key in seen if key.realm == realm)
    if ours:
        usable = {key.server for key in ours if key.version == VERSION}
        return [
            f"{key.server} {other_version(key)}"
            for key in ours
            if key.server not in usable
        ]
    return [
        f"{count} server{'s' if count != 1 else ''} in realm {other}, none in {realm}: use --realm"
        f" {other}, or start servers with --realm {realm}"
        for other, count in sorted(Counter(key.realm for key in seen).items())
    ]


def _scout(protocol: str, *, routers: bool) -> list[list[str]]:
    """Return the endpoints of each server and router that answers to multicast.

    Anybody can answer, with anything: only endpoints that speak the protocol count.
    """
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/address", f'"{scouting.GROUP}"')
    scout = zenoh.scout(what="router" if routers else "peer|router", config=config)
    time.sleep(SCOUT_S)
    answers: dict[str, list[str]] = {}
    while (hello := scout.try_recv()) is not None and len(answers) < ANSWERS:
        answers[str(hello.zid)] = [
            text for text in hello.locators if _speaks(text, protocol)
        ]
    scout.stop()
    return [ends for ends in answers.values() if ends]  # an optimizer has none


def _speaks(text: str, protocol: str) -> bool:
    """Return whether a text is an endpoint that speaks a protocol."""
    try:
        return endpoint.parse(text).protocol == protocol
    except ConfigError:
        return False


def _dial(group: list[str], ring: Keyring | None) -> DialResult:
    """Return what is at the first of these endpoints that can be dialled."""
    for text in group[:DIALLED]:
        at = endpoint.parse(text)
        fault = _unreachable(at) or tls_diagnosis.refusal(at, ring)
        if not fault:
            break
    else:
        return DialResult(text, fault)
    reach = Reach([text], multicast=False, keyring=ring)
    try:
        opened = session.open_through_router(reach, timeout_s=DIAL_S)  # or a server
    except NoRouter:
        fault = "something answers there, but no zswarm or zenoh program that lets this one in"
        if ring is None and tls_diagnosis.speaks_tls(at):
            fault = (
                "the program there lets in members only: have keys issued, and install them with"
                " zswarm-keys join"
            )
        return DialResult(text, fault)
    try:
        return DialResult(
            text, "", bool(list(opened.info.routers_zid())), _tokens(opened)
        )
    finally:
        session.close(opened)


def _unreachable(at: Endpoint) -> str:
    """Return why an endpoint cannot be dialled; "" if it can, or if only zenoh can tell."""
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
        return (
            "nothing listens there (connection refused): start zswarm-ss or zswarm-router, or"
            " correct the port"
        )
    except TimeoutError:
        return f"no answer in {DIAL_S:g} s: the machine is off, or a firewall is between"
    except OSError as error:
        if error.errno in (errno.EHOSTUNREACH, errno.ENETUNREACH):
            text = f"no route from this machine ({error.strerror})"
            return f"{text}: correct the address or the network"
        return f"cannot be dialled: {error.strerror}"
    return ""


def _misplaced(result: DialResult, realm: str, known: set[str], reach: Reach) -> str:
    """Return what is wrong with an endpoint that answers; "" if nothing is."""
    member = reach.keyring.name if reach.keyring is not None else ""
    if not result.servers:
        match result.router, bool(member):
            case True, True:
                return (
                    f"this router is running, but shows no server to {member}: none is connected to"
                    f" it, or its list of members does not have {member}"
                )
            case True, False:
                return (
                    "this router is running, but no server is connected to it: start servers with"
                    " --connect and its endpoint"
                )
            case False, True:
                return (
                    f"the program there shows no server to {member}, who may not be, or no longer"
                    " be, in its list of members: bring the newest list there (zswarm-keys join"
                    " members.zkeys) and reload it"
                )
        return "a zenoh program answers, but it is neither a zswarm server nor a router"
    if not result.router:
        if reach.through_router:
            return (
                "this is a server, not a router: leave through_router (--through-router) out, or"
                " name a router"
            )
        return ""
    ours = {
        key.server
        for key in result.servers
        if (key.realm, key.version) == (realm, VERSION)
    }
    if (beyond := sorted(ours - known)) and not reach.through_router:
        return (
            f"this router sees {_some(beyond)}, which cannot be dialled from here: set"
            " through_router = true (--through-router)"
        )
    return ""


def _tokens(opened: zenoh.Session) -> frozenset[ServerKey]:
    """Return the servers of all realms and versions that a session sees."""
    found = set()
    with contextlib.suppress(zenoh.ZError):  # the session is closing
        for reply in opened.liveliness().get(keys.ANY_ALIVE, timeout=DIAL_S):
            if reply.ok is not None and (key := parsed(reply.ok)):
                found.add(key)
    return frozenset(found)


def parsed(sample: zenoh.Sample) -> ServerKey | None:
    """Return the server of a liveliness token, or None if it is not one."""
    try:
        return keys.parse_server_key(str(sample.key_expr))
    except RemoteProtocolError:
        return None


def other_version(key: ServerKey) -> str:
    """Return what to do about a server of another version of the protocol."""
    return (
        f"speaks version {key.version} of the protocol, this program {VERSION}: install the same"
        " zswarm on both"
    )


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
