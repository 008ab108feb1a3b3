"""Notify systemd of a daemon's state by the protocol of sd_notify(3).

A message is a datagram of ``KEY=value`` lines to the socket that ``NOTIFY_SOCKET`` names. A program
that systemd did not start sends nothing.
"""

import contextlib
import math
import os
import socket
import time
from collections.abc import Mapping

EXTENSION_S = 15.0  # requested while something takes long
EXTEND_EVERY_S = 5.0


class Notify:
    """The connection to systemd.

    Attributes:
        listens: systemd has a socket for this program.
        watchdog_s: systemd ends the program after this time without a feed; infinite: it does not.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = _address(environment.get("NOTIFY_SOCKET", ""))
        self.listens = bool(self._address)
        self.watchdog_s = _watchdog_s(environment) if self.listens else math.inf
        self._fed_at = self._extended_at = -math.inf
        self._status = ""

    def ready(self) -> None:
        """Report that the program can do its work; at the start, and after a reload."""
        self._send("READY=1")

    def reloading(self) -> None:
        """Report that the program reads its settings again, until ``ready``."""
        now_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        self._send("RELOADING=1", f"MONOTONIC_USEC={now_us}")

    def stopping(self) -> None:
        """Report that the program ends."""
        self._send("STOPPING=1")

    def extend(self) -> None:
        """Ask for more time to start, reload or stop; call it as often as there is progress."""
        now = time.monotonic()
        if self.listens and now >= self._extended_at + EXTEND_EVERY_S:
            self._extended_at = now
            self._send(f"EXTEND_TIMEOUT_USEC={int(EXTENSION_S * 1e6)}")

    def feed(self) -> None:
        """Feed the watchdog if it is time; call it as often as there is progress."""
        now = time.monotonic()
        if now >= self.feed_at():
            self._fed_at = now
            self._send("WATCHDOG=1")

    def feed_at(self) -> float:
        """Return when to feed the watchdog next, by the monotonic clock; infinite without one."""
        return (
            math.inf
            if math.isinf(self.watchdog_s)
            else self._fed_at + self.watchdog_s / 4
        )

    def status(self, line: str) -> None:
        """Report one line for people, if it changed."""
        if line != self._status:
            self._status = line
            self._send(f"STATUS={line}")

    def _send(self, *lines: str) -> None:
        if not self.listens:
            return
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender,
        ):
            # Drop the message if systemd is gone or its queue is full.
            sender.setblocking(False)
            sender.sendto("\n".join(lines).encode(), self._address)


def _address(name: str) -> bytes:
    """Return the address of a path or of an abstract name; nothing for other names."""
    if name.startswith("@"):
        return b"\0" + name[1:].encode()
    return name.encode() if name.startswith("/") else b""


def _watchdog_s(environment: Mapping[str, str]) -> float:
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return math.inf
    try:
        seconds = int(environment.get("WATCHDOG_USEC", "")) / 1e6
    except ValueError:
        return math.inf
    return seconds if seconds > 0 else math.inf
