"""The one place that builds a zenoh configuration and opens a session, and the thread that sends.

Star topology: a server listens and dials nobody, an optimizer dials the servers it finds. Why each value is as it is:
docs/architecture.md, "The link".
"""

import json
import os
import queue
import resource
import threading
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

from zswarm.errors import ConfigError

SCOUTING_GROUP = "224.0.0.225:7467"  # our own: on zenoh's default group every ROS 2 robot of the lab would join in
PORT = 7467
PORTS = 100  # tried from PORT on when none is given
LINK_TIMEOUT_S = 8
WAIT_BEFORE_CLOSE_S = 120  # zenoh closes a link on which one message takes longer; its default of 5 s ends slow links
OPEN_FILES = 8192
QUEUE = 10_000  # calls waiting in one sender


def open_server(listen: Sequence[str], connect: Sequence[str], *, multicast: bool) -> tuple[zenoh.Session, list[str]]:
    """A session that listens, and the endpoints it listens on; without ``listen`` the first free port from 7467 on.

    Raises:
        ConfigError: an endpoint cannot be listened on, or is none.
    """
    if listen:
        return _open(_config(listen, connect, multicast=multicast, dial=False)), list(listen)
    for port in range(PORT, PORT + PORTS):
        endpoint = f"tcp/0.0.0.0:{port}"
        try:
            return _open(_config([endpoint], connect, multicast=multicast, dial=False)), [endpoint]
        except ConfigError as error:
            last = error
    raise last


def open_optimizer(connect: Sequence[str], *, multicast: bool) -> zenoh.Session:
    """A session that dials the servers it finds, and the given endpoints for as long as it lives.

    Raises:
        ConfigError: an endpoint is none.
    """
    return _open(_config([], connect, multicast=multicast, dial=True))


def _config(listen: Sequence[str], connect: Sequence[str], *, multicast: bool, dial: bool) -> dict[str, Any]:
    found: list[str] = ["peer", "router"] if dial else []
    return {
        "mode": "peer",
        "listen": {"endpoints": {"peer": list(listen)}},
        "connect": {
            "endpoints": {"peer": list(connect)},
            "timeout_ms": {"peer": -1},  # keep trying in the background
            "exit_on_failure": {"peer": False},
            "retry": {"period_init_ms": 20, "period_max_ms": 2000, "period_increase_factor": 1.5},
        },
        "scouting": {
            "delay": 500,
            "multicast": {"enabled": multicast, "address": SCOUTING_GROUP, "autoconnect": {"peer": found}},
            "gossip": {"enabled": True, "multihop": False, "autoconnect": {"peer": found}},
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
            },
        },
        "adminspace": {"enabled": False},
    }


def _open(config: dict[str, Any]) -> zenoh.Session:
    _raise_file_limit()
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as error:
        endpoints = ", ".join(config["listen"]["endpoints"]["peer"] + config["connect"]["endpoints"]["peer"])
        text = str(error).split(" at /")[0]  # what follows are places in zenoh's own source
        if "in use" in text:
            raise ConfigError(
                f"{endpoints}: the port is in use; give another with --listen, or none to take the next free"
            ) from None
        raise ConfigError(
            f"cannot open a session on {endpoints or 'this machine'}: "
            f"expected endpoints such as tcp/192.168.1.5:7467 ({text[:200]})"
        ) from None


def _raise_file_limit() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = OPEN_FILES if hard == resource.RLIM_INFINITY else min(OPEN_FILES, hard)
    if soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def close(session: zenoh.Session) -> None:
    """Close a session; a link that does not let go must not keep the program."""
    watchdog = threading.Timer(15.0, os._exit, (1,))
    watchdog.daemon = True
    watchdog.start()
    try:
        session.close()
    except zenoh.ZError:
        pass  # it gave up waiting for a dead link
    finally:
        watchdog.cancel()


class Sender:
    """A thread that sends to one peer. A send into a dying link blocks; here it holds up nobody else."""

    def __init__(self, name: str) -> None:
        self._calls: queue.Queue[Callable[[], None] | None] = queue.Queue(QUEUE)
        self._thread = threading.Thread(target=self._work, name=f"send-{name}", daemon=True)
        self._thread.start()

    def send(self, call: Callable[[], None]) -> bool:
        """Have a call made, in order; False when too many wait already."""
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
