"""Sessions on loopback: who sees whom, what is refused, and what is waited for."""

import contextlib
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from zswarm import session
from zswarm.errors import ConfigError, NoRouter
from zswarm.protocol import endpoint
from zswarm.session import Reach

ALIVE = "zswarm/v1/default/ss/somebody-01234567/alive"


OFF = Reach(multicast=False)


@pytest.fixture
def opened() -> Iterator[Callable[[zenoh.Session], zenoh.Session]]:
    """Close what is given to it."""
    sessions: list[zenoh.Session] = []

    def keep(one: zenoh.Session) -> zenoh.Session:
        sessions.append(one)
        return one

    yield keep
    for one in sessions:
        session.close(one)


def free(protocol: str = "tcp") -> str:
    """Return an unused endpoint on loopback."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{probe.getsockname()[1]}"


def sees(one: zenoh.Session) -> bool:
    """Whether a session comes to see the token."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        if any(
            reply.ok is not None for reply in one.liveliness().get(ALIVE, timeout=2.0)
        ):
            return True
        time.sleep(0.02)
    return False


@pytest.mark.parametrize("protocol", ["tcp", "udp", "ws"])
def test_a_server_listens_at_the_given_endpoint(
    opened: Callable[..., zenoh.Session], protocol: str
) -> None:
    place = free(protocol)
    listening, endpoints = session.open_server([place], OFF)
    opened(listening)
    assert endpoints == [place]
    _token = listening.liveliness().declare_token(ALIVE)
    assert sees(opened(session.open_optimizer(Reach([place], multicast=False))))


def test_a_server_listens_on_a_socket_file(
    opened: Callable[..., zenoh.Session], tmp_path: Path
) -> None:
    place = f"{endpoint.SOCKET_FILE}/{tmp_path / 'socket'}"
    server = opened(session.open_server([place], OFF)[0])
    _token = server.liveliness().declare_token(ALIVE)
    assert sees(opened(session.open_optimizer(Reach([place], multicast=False))))


@pytest.mark.parametrize(
    ("open_", "words"),
    [
        (lambda: session.open_server(["nonsense"], OFF), "listen: expected endpoints"),
        (
            lambda: session.open_server(
                ["tcp/127.0.0.1:0"], Reach(["nonsense"], multicast=False)
            ),
            "connect: expected endpoints",
        ),
        (
            lambda: session.open_optimizer(Reach(["nonsense"], multicast=False)),
            "connect: expected endpoints",
        ),
        (
            lambda: session.open_through_router(Reach(["nonsense"], multicast=False)),
            "connect: expected endpoints",
        ),
        (lambda: session.open_router(["nonsense"], OFF)[0], "listen: expected endpoints"),
        (lambda: session.open_router(["tls/127.0.0.1:17620"], OFF)[0], "tls needs keys"),
        (
            lambda: session.open_router(["tcp/192.0.2.1:17621"], OFF)[0],
            "Cannot assign requested address",
        ),
    ],
)
def test_an_endpoint_that_cannot_be_used_is_refused_in_one_line(
    open_: Callable[[], object], words: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        open_()
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_taken_port_is_refused_or_skipped(opened: Callable[..., zenoh.Session]) -> None:
    first = session.open_server([], OFF)
    opened(first[0])
    second = session.open_server([], OFF)
    opened(second[0])
    assert first[1] != second[1]
    with pytest.raises(ConfigError, match="the port is in use"):
        session.open_server(first[1], OFF)


def test_a_missing_router_is_reported_in_time() -> None:
    place = free()
    with pytest.raises(NoRouter, match=f"no router answers at {place}"):
        session.open_through_router(Reach([place], multicast=False), timeout_s=0.3)


def test_a_router_carries_messages_between_two_sessions(
    opened: Callable[..., zenoh.Session],
) -> None:
    place = free()
    opened(session.open_router([place], OFF)[0])
    server = opened(session.open_server([free()], Reach([place], multicast=False))[0])
    _token = server.liveliness().declare_token(ALIVE)
    client = opened(session.open_through_router(Reach([place], multicast=False)))
    assert sees(client)
    assert list(client.info.peers_zid()) == [], "nothing goes direct"
    assert [str(link.dst) for link in client.info.links()] == [place]


class Panic(BaseException):
    """What a panic in zenoh is in Python: no ``Exception``."""


class Panicking:
    """A session that fails when a query is sent."""

    def get(self, *_: object, **__: object) -> None:
        raise Panic


def test_a_query_that_cannot_be_sent_counts_as_not_answered() -> None:
    answers: list[bytes | None] = []
    with pytest.raises(Panic):
        session.ask(
            Panicking(),  # type: ignore[arg-type]
            "zswarm/key",
            b"",
            lambda answer, _: answers.append(answer),
            timeout_s=1.0,
        )
    assert answers == [None]


class Answering:
    """A session on which the answer is there at once, and then the query ends."""

    def get(self, _: str, callback: zenoh.handlers.Callback, **__: object) -> None:
        payload = SimpleNamespace(to_bytes=lambda: b"answer")
        reply = SimpleNamespace(ok=SimpleNamespace(payload=payload), replier_id=None)
        with contextlib.suppress(MemoryError):  # as zenoh does, which logs it
            callback(reply)
        callback.drop()


def test_an_answer_that_cannot_be_read_counts_as_none() -> None:
    """There may be no memory for it: without an end of its query, nobody would ask again."""
    answers: list[bytes | None] = []

    def answered(answer: bytes | None, _: str) -> None:
        if answer is not None and len(answers) == 0:
            answers.append(answer)
            raise MemoryError
        answers.append(answer)

    for _ in range(2):
        answering: Any = Answering()
        session.ask(answering, "zswarm/key", b"", answered, timeout_s=1.0)
    assert answers == [b"answer", None, b"answer"]


HANGING = """
import threading
from zswarm import session
from zswarm.system import program

class Hanging:
    def close(self):
        threading.Event().wait()

def main():
    session.close(Hanging())
    print("closed", flush=True)
    raise SystemExit(5)

{run}
"""


@pytest.mark.parametrize("run", ["program.run(main)", "main()"])
def test_a_session_that_cannot_be_closed_does_not_keep_a_program(run: str) -> None:
    """A program of ours ends with its own code; nothing ends the program of a user before."""
    ended = subprocess.run(
        [sys.executable, "-c", HANGING.format(run=run)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert (ended.stdout, ended.returncode) == ("closed\n", 5), ended.stderr
