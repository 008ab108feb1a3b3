"""Build zenoh's configuration and open sessions, which nothing else does; send from a thread.

The topology is a star: a server listens and dials no one, an optimizer dials the servers that it
finds; or both dial a router. docs/architecture.md, "The link", explains the values. Opening raises
``ConfigError`` for an endpoint that is not valid, contradicts the keys, or cannot be listened on.
"""

import contextlib
import json
import os
import resource
import threading
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import zenoh

from zswarm.errors import ConfigError, NoRouter
from zswarm.protocol import endpoint
from zswarm.protocol.messages import MAX_MESSAGE
from zswarm.security import access
from zswarm.security.keyring import Keyring
from zswarm.system import scouting
from zswarm.system.program import CLOSING

PORT = 7467
PORTS = 100  # tried from PORT on if none is given
ROUTER = "0.0.0.0:7466"  # where a router listens by default
LINK_TIMEOUT_S = 8
# Zenoh closes a link on which one message takes longer; its default of 5 s ends slow links.
WAIT_BEFORE_CLOSE_S = 60
# Bytes that a link carries at once; a link to this machine's slots is never slow.
BATCH, LOCAL_BATCH = 16_384, 65_535
# Of zenoh. A dead link on which a message hangs occupies one until it is given up.
SENDING_THREADS = 64
OPEN_FILES = 8192
OTHER_BYTES = 64 << 10  # of a message of zenoh's, besides ours: its key, for example
RETRY_MS = 2000  # between attempts to dial a given endpoint, at most; and with keys:
REFUSED_RETRY_MS = 30_000  # each refused handshake delays others there by 0.1 s
CLOSING_S = 1.0  # for a close that a dead link blocks

# The answer to an offer is sent as its query was, and by one thread for all: it must not wait for
# an optimizer that takes no answers.
OFFERS = {
    "messages": ["query"],
    "key_exprs": ["zswarm/*/*/ss/*/offer"],
    "flows": ["ingress"],
    "overwrite": {"congestion_control": "drop"},
}

Mode = Literal["peer", "client", "router"]
Session = zenoh.Session


class Reach(NamedTuple):
    """How a program reaches others, and who may reach it."""

    connect: Sequence[str] = ()  # endpoints to dial
    multicast: bool = True
    # One of ``connect``, or one that multicast finds, carries all.
    through_router: bool = False
    keyring: Keyring | None = None  # None: in the clear


# ---- sessions


def open_server(listen: Sequence[str], reach: Reach) -> tuple[Session, list[str]]:
    """Return a session that listens and its endpoints, by default the first free port from 7467."""
    free = [[f"{_protocol(reach)}/0.0.0.0:{port}"] for port in range(PORT, PORT + PORTS)]
    for endpoints in [list(listen)] if listen else free:
        try:
            return _open("peer", endpoints, reach), endpoints
        except ConfigError as error:
            last = error
    raise last


def open_optimizer(reach: Reach) -> Session:
    """Open a session that dials the servers it finds, and keeps dialing the given endpoints."""
    return _open("peer", [], reach, dial=True)


def open_through_router(reach: Reach, timeout_s: float = 2.0) -> Session:
    """Open a session to a router that carries everything, or raise ``NoRouter``; it reconnects.

    Args:
        reach: the first endpoint that answers is used; without any, multicast finds one.
        timeout_s: how long to wait for a router.
    """
    return _open("client", [], reach, timeout_ms=int(timeout_s * 1000))


def open_router(listen: Sequence[str], reach: Reach) -> tuple[Session, list[str]]:
    """Open a session that introduces programs to each other, and carries what clients send."""
    listen = list(listen) or [f"{_protocol(reach)}/{ROUTER}"]
    return _open("router", listen, reach), listen


def _protocol(reach: Reach) -> str:
    return "tcp" if reach.keyring is None else "tls"


def _open(
    mode: Mode,
    listen: Sequence[str],
    reach: Reach,
    *,
    dial: bool = False,
    timeout_ms: int = -1,
) -> Session:
    for where, endpoints in (("listen", listen), ("connect", reach.connect)):
        endpoint.check(endpoints, where)
        _check_keys(endpoints, where, reach.keyring)
    _raise_file_limit()
    # Zenoh reads it when the first session opens.
    os.environ.setdefault("ZENOH_RUNTIME", f"(tx: (worker_threads: {SENDING_THREADS}))")
    config = _config(mode, listen, reach, dial=dial, timeout_ms=timeout_ms)
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as error:
        if mode == "client":
            at = ", ".join(reach.connect) or "any address that multicast finds"
            raise NoRouter(f"no router answers at {at}") from None
        text = str(error).split(" at /")[0]  # without places in zenoh's source
        if "in use" in text:
            ports = ", ".join(listen)
            raise ConfigError(
                f"{ports}: the port is in use; give another with --listen"
            ) from None
        where = ", ".join([*listen, *reach.connect]) or "this machine"
        raise ConfigError(f"cannot open a session on {where}: {text[:200]}") from None


def _check_keys(endpoints: Sequence[str], where: str, keyring: Keyring | None) -> None:
    for text in endpoints:
        protocol = endpoint.parse(text).protocol
        if keyring is not None and protocol != "tls":
            raise ConfigError(
                f"{where}: {text}: the keys in {keyring.folder} are used, so an endpoint must begin"
                " with tls/ (ZSWARM_KEYS=none uses no keys)"
            )
        if keyring is None and protocol in ("tls", "quic"):
            off = os.environ.get("ZSWARM_KEYS") == "none"
            unused = "ZSWARM_KEYS=none uses none" if off else "none are installed"
            raise ConfigError(
                f"{where}: {text}: {protocol} needs keys, and {unused}: zswarm-keys join BUNDLE "
                "installs some"
            )


def _config(
    mode: Mode, listen: Sequence[str], reach: Reach, *, dial: bool, timeout_ms: int
) -> dict[str, Any]:
    """Return zenoh's whole configuration.

    Args:
        dial: as a peer, the programs that are found; a client dials a router.
        timeout_ms: for dialing; -1: keep trying in the background (a client would wait forever).
    """
    found = {mode: ["router"] if mode == "client" else ["peer", "router"] if dial else []}
    config: dict[str, Any] = {
        "mode": mode,
        "listen": {"endpoints": {mode: list(listen)}},
        "connect": {
            "endpoints": {mode: list(reach.connect)},
            "timeout_ms": {mode: timeout_ms},
            "exit_on_failure": {mode: False},
            "retry": {
                "period_init_ms": 20,
                "period_max_ms": RETRY_MS if reach.keyring is None else REFUSED_RETRY_MS,
                "period_increase_factor": 1.5,
            },
        },
        "scouting": {
            "delay": 500,
            "multicast": {
                "enabled": reach.multicast,
                "address": scouting.GROUP,
                "autoconnect": found,
            },
            "gossip": {
                "enabled": True,
                "multihop": False,
                "target": {"peer": ["router"]},
                "autoconnect": found,
            },
        },
        "open": {"return_conditions": {"connect_scouted": False}},
        "transport": {
            "unicast": {
                "open_timeout": 4000,
                "accept_timeout": 4000,
                "max_sessions": 4096,
            },
            "shared_memory": {"enabled": False},
            "link": _link(reach.keyring, [*listen, *reach.connect]),
        },
        "adminspace": {"enabled": False},
        "qos": {"network": [OFFERS]},
    }
    if timeout_ms > 0:
        config["scouting"]["timeout"] = timeout_ms
    if reach.keyring is not None:
        config["access_control"] = access.rules(reach.keyring.role, reach.keyring.members)
    return config


def _link(keyring: Keyring | None, given: Sequence[str]) -> dict[str, Any]:
    """Return the settings of each link; none but TCP is dialled unless the user gave it."""
    blocked = {"wait_before_close": WAIT_BEFORE_CLOSE_S * 1_000_000}
    protocols = {endpoint.parse(text).protocol for text in given}
    link: dict[str, Any] = {
        "tx": {
            "lease": LINK_TIMEOUT_S * 1000,
            "keep_alive": 4,
            "batch_size": LOCAL_BATCH if protocols == {endpoint.SOCKET_FILE} else BATCH,
            "queue": {"congestion_control": {"block": blocked}},
        },
        "rx": {"max_message_size": MAX_MESSAGE + OTHER_BYTES},
        "protocols": sorted({"tcp", *protocols}),
    }
    if keyring is not None:
        link |= {"protocols": ["tls"], "tls": _tls(keyring)}
    return link


def _tls(keyring: Keyring) -> dict[str, Any]:
    """Return the settings by which both sides show a certificate of the lab's authority.

    The name in it decides what a program may do (``security/access.py``). Names are not compared
    with addresses: multicast finds servers by changing addresses, and all may do the same.
    """
    from zswarm.security.certificates import AUTHORITY, CERTIFICATE, KEY  # needs an extra

    certificate, key = str(keyring.folder / CERTIFICATE), str(keyring.folder / KEY)
    return {
        "root_ca_certificate": str(keyring.folder / AUTHORITY),
        "enable_mtls": True,
        "verify_name_on_connect": False,
        "close_link_on_expiration": True,
        "listen_certificate": certificate,
        "listen_private_key": key,
        "connect_certificate": certificate,
        "connect_private_key": key,
    }


def _raise_file_limit() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = OPEN_FILES if hard == resource.RLIM_INFINITY else min(OPEN_FILES, hard)
    if soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def close(session: Session) -> None:
    """Close a session; leave that to a thread if a dead link blocks it."""

    def closing() -> None:
        with contextlib.suppress(zenoh.ZError):  # zenoh gave up waiting for a dead link
            session.close()

    thread = threading.Thread(target=closing, name=CLOSING, daemon=True)
    thread.start()
    thread.join(CLOSING_S)


def ask(
    opened: Session,
    key: str,
    body: bytes,
    answered: Callable[[bytes | None, str], None],
    *,
    timeout_s: float,
    **options: Any,
) -> None:
    """Send a query; answers after the first one are dropped.

    Args:
        answered: called once, in one of zenoh's threads, with the answer and the replier's id; with
            None if no answer comes, also if the query cannot be sent. If it fails with an answer,
            it is called again with None.
        options: of ``zenoh.Session.get``.
    """
    done = False

    # Zenoh calls on_end only when every link has answered on which an answer may come.
    def on_reply(reply: zenoh.Reply) -> None:
        nonlocal done
        if reply.ok is not None and not done:
            done = True
            try:
                replier = (
                    str(reply.replier_id.zid) if reply.replier_id is not None else ""
                )
                answered(reply.ok.payload.to_bytes(), replier)
            except BaseException:  # no memory, or a panic in zenoh
                done = False
                raise

    def on_end() -> None:
        nonlocal done
        if not done:
            done = True
            answered(None, "")

    try:
        opened.get(
            key,
            zenoh.handlers.Callback(on_reply, on_end, indirect=False),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            congestion_control=zenoh.CongestionControl.BLOCK,
            timeout=timeout_s,
            payload=body,
            **options,
        )
    except zenoh.ZError:  # the session is closing
        on_end()
    except BaseException:
        on_end()
        raise
