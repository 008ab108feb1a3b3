"""The words to systemd, as a socket of the test hears them."""

import math
import os
import socket
from pathlib import Path

import pytest

from zswarm.system.systemd import Notify


def heard(listener: socket.socket) -> list[str]:
    """Return all messages that arrived, in order."""
    listener.setblocking(False)
    words = []
    while True:
        try:
            words.append(listener.recv(4096).decode())
        except BlockingIOError:
            return words


@pytest.mark.parametrize("abstract", [False, True], ids=["path", "abstract"])
def test_notifications_arrive(abstract: bool, tmp_path: Path) -> None:
    name = f"@zswarm-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(name.replace("@", "\0"))
        told = Notify(
            {
                "NOTIFY_SOCKET": name,
                "WATCHDOG_USEC": "3000000",
                "WATCHDOG_PID": str(os.getpid()),
            }
        )
        assert told.listens
        assert told.watchdog_s == 3.0
        told.ready()
        told.feed()
        told.feed()
        told.status("two slots")
        told.status("two slots")
        told.reloading()
        told.stopping()
        told.extend()
        told.extend()
        ready, fed, status, reloading, stopping, extended = heard(listener)
    assert (ready, fed, status, stopping) == (
        "READY=1",
        "WATCHDOG=1",
        "STATUS=two slots",
        "STOPPING=1",
    )
    assert reloading.startswith("RELOADING=1\nMONOTONIC_USEC=")
    assert extended == "EXTEND_TIMEOUT_USEC=15000000"


@pytest.mark.parametrize("name", ["", "relative/path", "vsock:2:1"])
def test_nothing_is_sent_without_a_socket(name: str) -> None:
    told = Notify({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1000000"})
    assert not told.listens
    assert math.isinf(told.feed_at())
    told.ready()
    told.feed()


def test_a_dead_or_busy_systemd_does_not_block(tmp_path: Path) -> None:
    Notify({"NOTIFY_SOCKET": str(tmp_path / "nobody")}).ready()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        told = Notify({"NOTIFY_SOCKET": str(tmp_path / "notify")})
        for number in range(2000):
            told.status(f"{number}" * 100)
        assert 0 < len(heard(listener)) < 2000


@pytest.mark.parametrize(
    "watchdog",
    [
        {},
        {"WATCHDOG_USEC": "soon"},
        {"WATCHDOG_USEC": "0"},
        {"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "1"},
    ],
    ids=["none", "no number", "zero", "of another process"],
)
def test_there_is_no_watchdog_unless_systemd_sets_one(
    watchdog: dict[str, str], tmp_path: Path
) -> None:
    told = Notify({"NOTIFY_SOCKET": str(tmp_path / "notify"), **watchdog})
    assert math.isinf(told.watchdog_s)
    assert math.isinf(told.feed_at())
