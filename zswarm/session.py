"""The one place that builds a zenoh configuration and opens a session, and the thread that sends.

Star topology: a server listens and dials nobody, an optimizer dials the servers it finds; or both dial a router. Why each
value is as it is: docs/architecture.md, "The link".
"""

import contextlib
import fcntl
import json
import os
import queue
import resource
import socket
import struct
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import zenoh

from zswarm import endpoint
from zswarm.errors import ConfigError, NoRouter
from zswarm.security import access
from zswarm.security.keyring import Keyring

SCOUTING_GROUP = "224.0.0.225:7467"  # our own: on zenoh's default group every ROS 2 robot of the lab would join in
PORT = 7467
PORTS = 100  # tried from PORT on when none is given
ROUTER = "0.0.0.0:7466"  # where a router listens by default
LINK_TIMEOUT_S = 8
WAIT_BEFORE_CLOSE_S = 60  # zenoh closes a link on which one message takes longer; its default of 5 s ends slow links
SENDING_THREADS = 64  # of zenoh: a link that ends while a message hangs in it takes one until that is given up
OPEN_FILES = 8192
CLOSING_S = 15.0
QUEUE = 10_000  # calls waiting in one sender
SIOCGIFFLAGS, SIOCGIFADDR = 0x8913, 0x8915  # Linux: of an interface by its name
IFF_UP, IFF_LOOPBACK, IFF_RUNNING, IFF_MULTICAST = 0x1, 0x8, 0x40, 0x1000

Mode = Literal["peer", "client", "router"]
Session = zenoh.Session


class Reach(NamedTuple):
    """How a program reaches others, and who may reach it."""

    connect: Sequence[str] = ()  # endpoints to dial
    multicast: bool = True
    through_router: bool = False  # a router carries everything, one of ``connect`` or one that multicast finds
    keyring: Keyring | None = None  # None: in the clear


def keys_in_words(reach: Reach) -> str:
    """Which keys are used, for a log."""
    return f"{reach.keyring.authority} until {reach.keyring.not_after:%Y-%m-%d}" if reach.keyring else "none"


def open_server(listen: Sequence[str], reach: Reach) -> tuple[zenoh.Session, list[str]]:
    """A session that listens, and the endpoints it listens on; without ``listen`` the first free port from 7467 on.

    Raises:
        ConfigError: an endpoint cannot be listened on, is none, or does not go with the keys.
    """
    if listen:
        return _open("peer", listen, reach), list(listen)
    for port in range(PORT, PORT + PORTS):
        listen = [f"{_protocol(reach)}/0.0.0.0:{port}"]
        try:
            return _open("peer", listen, reach), listen
        except ConfigError as error:
            last = error
    raise last


def open_optimizer(reach: Reach) -> zenoh.Session:
    """A session that dials the servers it finds, and the given endpoints for as long as it lives.

    Raises:
        ConfigError: an endpoint is none, or does not go with the keys.
    """
    return _open("peer", [], reach, dial=True)


def open_through_router(reach: Reach, timeout_s: float = 2.0) -> zenoh.Session:
    """A session with one link, to a router that carries everything; it looks for one again whenever it lost it.

    Args:
        reach: of its endpoints the first that answers is taken; without any, multicast finds one.
        timeout_s: opening waits as long for a router.

    Raises:
        ConfigError: an endpoint is none, or does not go with the keys.
        NoRouter: none answered in time.
    """
    return _open("client", [], reach, timeout_ms=int(timeout_s * 1000))


def open_router(listen: Sequence[str], reach: Reach) -> tuple[zenoh.Session, list[str]]:
    """A session that introduces those who dial it to each other and carries what clients send, and where it listens.

    Raises:
        ConfigError: an endpoint cannot be listened on, is none, or does not go with the keys.
    """
    listen = list(listen) or [f"{_protocol(reach)}/{ROUTER}"]
    return _open("router", listen, reach), listen


def _protocol(reach: Reach) -> str:
    return "tcp" if reach.keyring is None else "tls"


def multicast_fault() -> str:
    """Why nobody finds this machine by multicast, nor is found from here; "" where that is possible.

    Zenoh scouts on every interface that is up, has an address and can multicast, but for loopback. It needs no route.
    """
    try:
        interfaces = scouting_interfaces()
    except OSError as error:  # such as netlink forbidden by systemd's RestrictAddressFamilies
        return f"the network interfaces cannot be listed ({error.strerror})"
    group = socket.inet_aton(SCOUTING_GROUP.partition(":")[0])
    fault = "no network interface is up that has an IPv4 address and multicast"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for index, name in interfaces:
            try:
                probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, struct.pack("=4s4si", group, bytes(4), index))
            except OSError as error:
                fault = f"{name} cannot join the group {SCOUTING_GROUP} ({error.strerror})"
            else:
                return ""
    return fault


def scouting_interfaces() -> list[tuple[int, str]]:
    """Number and name of those that Zenoh scouts on.

    Raises:
        OSError: they cannot be listed.
    """
    interfaces = socket.if_nameindex()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        return [(index, name) for index, name in interfaces if sys.platform != "linux" or _scouts(probe, name)]


def _scouts(probe: socket.socket, interface: str) -> bool:
    request = struct.pack("=16s24x", interface.encode()[:15])
    try:
        flags = struct.unpack_from("=16xH", fcntl.ioctl(probe, SIOCGIFFLAGS, request))[0]
        fcntl.ioctl(probe, SIOCGIFADDR, request)
    except OSError:
        return False  # it has no address
    return bool(flags & IFF_UP and flags & IFF_RUNNING and flags & IFF_MULTICAST and not flags & IFF_LOOPBACK)


def _open(mode: Mode, listen: Sequence[str], reach: Reach, *, dial: bool = False, timeout_ms: int = -1) -> zenoh.Session:
    for where, endpoints in (("listen", listen), ("connect", reach.connect)):
        endpoint.check(endpoints, where)
        _check_keys(endpoints, where, reach.keyring)
    _raise_file_limit()
    os.environ.setdefault("ZENOH_RUNTIME", f"(tx: (worker_threads: {SENDING_THREADS}))")  # read when the first session opens
    config = _config(mode, listen, reach, dial=dial, timeout_ms=timeout_ms)
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as error:
        if mode == "client":
            raise NoRouter(f"no router answers at {', '.join(reach.connect) or 'any address that multicast finds'}") from None
        text = str(error).split(" at /")[0]  # what follows are places in zenoh's own source
        if "in use" in text:
            raise ConfigError(f"{', '.join(listen)}: the port is in use; give another with --listen") from None
        where = ", ".join([*listen, *reach.connect])
        raise ConfigError(f"cannot open a session on {where or 'this machine'}: {text[:200]}") from None


def _check_keys(endpoints: Sequence[str], where: str, keyring: Keyring | None) -> None:
    for text in endpoints:
        protocol = endpoint.parse(text).protocol
        if keyring is not None and protocol != "tls":
            raise ConfigError(
                f"{where}: {text}: the keys in {keyring.folder} are used, so an endpoint must begin with tls/"
                " (ZSWARM_KEYS=none goes without keys)"
            )
        if keyring is None and protocol in ("tls", "quic"):
            unused = "ZSWARM_KEYS=none goes without" if os.environ.get("ZSWARM_KEYS") == "none" else "none are installed"
            raise ConfigError(f"{where}: {text}: {protocol} needs keys, and {unused}: zswarm-keys join BUNDLE installs some")


def _config(mode: Mode, listen: Sequence[str], reach: Reach, *, dial: bool, timeout_ms: int) -> dict[str, Any]:
    """The whole configuration; ``dial``: dial servers and routers that are found."""
    found = ["router"] if mode == "client" else ["peer", "router"] if dial else []
    return {
        "mode": mode,
        "listen": {"endpoints": {mode: list(listen)}},
        "connect": {
            "endpoints": {mode: list(reach.connect)},
            "timeout_ms": {mode: timeout_ms},  # -1: keep trying in the background; a client would wait in open for ever
            "exit_on_failure": {mode: False},
            "retry": {"period_init_ms": 20, "period_max_ms": 2000, "period_increase_factor": 1.5},
        },
        "scouting": {
            "delay": 500,
            **({"timeout": timeout_ms} if timeout_ms > 0 else {}),
            "multicast": {"enabled": reach.multicast, "address": SCOUTING_GROUP, "autoconnect": {mode: found}},
            "gossip": {"enabled": True, "multihop": False, "target": {"peer": ["router"]}, "autoconnect": {mode: found}},
        },
        "open": {"return_conditions": {"connect_scouted": False}},
        "transport": {
            "unicast": {"open_timeout": 4000, "accept_timeout": 4000, "max_sessions": 4096},
            "shared_memory": {"enabled": False},
            "link": {
                "tx": {
                    "lease": LINK_TIMEOUT_S * 1000,
                    "keep_alive": 4,
                    "batch_size": 16384,
                    "queue": {"congestion_control": {"block": {"wait_before_close": WAIT_BEFORE_CLOSE_S * 1_000_000}}},
                },
                "rx": {"max_message_size": 64 << 20},
                **({} if reach.keyring is None else {"protocols": ["tls"], "tls": _tls(reach.keyring)}),
            },
        },
        **({} if reach.keyring is None else {"access_control": access.rules(reach.keyring.role, reach.keyring.members)}),
        "adminspace": {"enabled": False},
    }


def _tls(keyring: Keyring) -> dict[str, Any]:
    """Both sides show a certificate of the lab's authority; who it names decides what it may do (``security/access.py``).

    Names and addresses are not compared: multicast finds servers by addresses that change, and all the lab's servers may
    do the same.
    """
    from zswarm.security.certificates import AUTHORITY, CERTIFICATE, KEY  # whoever has keys has the package for them

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


def close(session: zenoh.Session, *, or_exit: bool = True) -> None:
    """Close a session; a link that does not let go must not keep the program.

    Args:
        or_exit: end the program when that takes long; else leave it to a thread.
    """

    def closing() -> None:
        with contextlib.suppress(zenoh.ZError):  # it gave up waiting for a dead link
            session.close()

    if or_exit:
        watchdog = threading.Timer(CLOSING_S, os._exit, (1,))
        watchdog.daemon = True
        watchdog.start()
        try:
            closing()
        finally:
            watchdog.cancel()
    else:
        thread = threading.Thread(target=closing, name="closing", daemon=True)
        thread.start()
        thread.join(CLOSING_S)


class Sender:
    """A thread that sends to one peer. A send into a dying link blocks; here it holds up nobody else."""

    def __init__(self, name: str) -> None:
        self._calls: queue.Queue[Callable[[], None] | None] = queue.Queue(QUEUE)
        self._thread = threading.Thread(target=self._work, name=f"send-{name}", daemon=True)
        self._thread.start()

    def send(self, call: Callable[[], None], *, at_once: bool = False) -> bool:
        """Have a call made, in order; False when too many wait already.

        Args:
            at_once: it does not block: make it in this thread if no other is waited for.
        """
        if at_once and not self._calls.unfinished_tasks:
            call()
            return True
        try:
            self._calls.put_nowait(call)
        except queue.Full:
            return False
        return True

    def close(self, timeout_s: float = 0.0) -> None:
        """End after the calls that wait; wait for that as long as told."""
        if self.send(None):  # type: ignore[arg-type]  # the end mark
            self._thread.join(timeout_s)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            call()
            self._calls.task_done()
