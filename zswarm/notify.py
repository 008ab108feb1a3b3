"""What a daemon tells systemd, by the protocol of sd_notify(3); whoever was not started by systemd tells nobody.

A datagram of ``KEY=value`` lines to the socket that ``NOTIFY_SOCKET`` names.
"""

import contextlib
import math
import os
import socket
import time
from collections.abc import Mapping

EXTENSION_S = 15.0  # asked for while something goes on that may take long
EXTEND_EVERY_S = 5.0


class Notify:
    """The way to systemd.

    Attributes:
        listens: somebody does.
        watchdog_s: systemd ends the program when it hears nothing for so long; infinite: it does not.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = _address(environment.get("NOTIFY_SOCKET", ""))
        self.listens = bool(self._address)
        self.watchdog_s = _watchdog_s(environment) if self.listens else math.inf
        self._fed_at = self._extended_at = -math.inf
        self._status = ""

    def ready(self) -> None:
        """It can do its work; at the start, and again after a reload."""
        self._send("READY=1")

    def reloading(self) -> None:
        """It reads its settings anew; ``ready`` ends that."""
        self._send("RELOADING=1", f"MONOTONIC_USEC={time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000}")

    def stopping(self) -> None:
        """It ends."""
        self._send("STOPPING=1")

    def extend(self) -> None:
        """It takes longer, and goes on; called as often as there is progress."""
        if self.listens and time.monotonic() >= self._extended_at + EXTEND_EVERY_S:
            self._extended_at = time.monotonic()
            self._send(f"EXTEND_TIMEOUT_USEC={int(EXTENSION_S * 1e6)}")

    def feed(self) -> None:
        """Feed the watchdog; called as often as there is progress."""
        if time.monotonic() >= self.feed_at():
            self._fed_at = time.monotonic()
            self._send("WATCHDOG=1")

    def feed_at(self) -> float:
        """When to feed it next, by the monotonic clock; infinite where there is no watchdog."""
        return math.inf if math.isinf(self.watchdog_s) else self._fed_at + self.watchdog_s / 4

    def status(self, line: str) -> None:
        """One line for people, if it is another one."""
        if line != self._status:
            self._status = line
            self._send(f"STATUS={line}")

    def _send(self, *lines: str) -> None:
        if not self.listens:
            return
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)  # a systemd that is gone, or has no room, holds nobody up: it hears the next one
            sender.sendto("\n".join(lines).encode(), self._address)


def _address(name: str) -> bytes:
    """Of a path, or of a name in the abstract name space; nothing for what is neither."""
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
