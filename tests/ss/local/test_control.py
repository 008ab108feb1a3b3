"""The control socket, with real connections."""

import contextlib
import json
import os
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from zswarm.ss.local import control
from zswarm.ss.local.control import MAX_CLIENTS, Control, LocalQuery, LocalRequest


class Told(msgspec.Struct):
    """Define the server's answer in these tests."""

    ask: str
    text: str = "x" * 1_000_000  # more than a socket takes at once


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="zs-") as name:
        Path(name).chmod(0o755)
        monkeypatch.setenv("RUNTIME_DIRECTORY", name)
        yield Path(name)


def new(name: str) -> Control:
    def put(query: LocalQuery) -> None:
        query.answer.set_result(Told(query.request.ask))

    return Control(name, put)


@pytest.fixture
def server(folder: Path) -> Iterator[Control]:
    made = new("ss-1")
    yield made
    made.close()
    assert list(folder.iterdir()) == []


def connected(server: Control) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.connect(str(server.path))
    connection.settimeout(20.0)
    return connection


def asked(server: Control, line: bytes, user: int = os.geteuid()) -> dict[str, object]:
    """Return the server's answer to a user."""
    before = os.geteuid()
    os.seteuid(user)
    connecting = connected(server)
    os.seteuid(before)
    with connecting as connection:
        connection.send(line)
        return json.loads(rest(connection))  # type: ignore[no-any-return]


def rest(connection: socket.socket) -> bytes:
    """Return what comes until the server drops the connection."""
    received = b""
    with contextlib.suppress(ConnectionResetError):  # it was dropped before it sent all
        while came := connection.recv(1 << 20):
            received += came
    return received


def test_a_request_is_answered(server: Control) -> None:
    assert asked(server, b'{"ask": "status"}\n') == {
        "ask": "status",
        "text": "x" * 1_000_000,
    }
    assert asked(server, b'{"ask": "drain"}\n')["ask"] == "drain"


@pytest.mark.parametrize(
    "line",
    [
        b"\n",
        b"status\n",
        b'{"ask": "stop"}\n',
        b'{"ask": "status", "more": 1}\n',
        b'{"ask": "drain", "wait": 1}\n',
        b"[" * 1000 + b"\n",
        b"\xff\xfe\n",
        b"x" * 1025,
        b"null\n",
    ],
)
def test_an_invalid_request_is_refused_with_what_was_expected(
    server: Control, line: bytes
) -> None:
    assert str(asked(server, line)["error"]).startswith(
        ("expected one line of at most 1024 bytes", 'expected {"ask": "status"} or')
    )


def test_silent_unresponsive_and_disconnected_clients_are_dropped(
    server: Control, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "CLIENT_S", 0.5)
    # The time of ``silent`` begins last: when it is over, that of ``deaf`` is over, too.
    deaf, gone, half, silent = (connected(server) for _ in range(4))
    half.send(b'{"ask": ')
    deaf.send(b'{"ask": "status"}\n')
    gone.send(b'{"ask": "status"}\n')
    gone.close()
    assert asked(server, b'{"ask": "status"}\n')["ask"] == "status"
    assert (rest(half), rest(silent)) == (b"", b"")
    assert not rest(deaf).endswith(b"\n")
    for connection in (silent, half, deaf):
        connection.close()


def test_a_waiting_client_stays_connected_until_the_server_ends(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing is logged when it is dropped then."""
    server = new("ss-1")
    with connected(server) as connection:
        connection.send(b'{"ask": "drain", "wait": true}\n')
        with connection.makefile("rb") as answers:
            assert json.loads(answers.readline())["ask"] == "drain"
            connection.settimeout(0.1)
            with pytest.raises(TimeoutError):
                answers.read(1)
        server.close()
        assert rest(connection) == b""
    assert not caplog.records


def test_too_many_clients_drop_the_oldest(
    server: Control, caplog: pytest.LogCaptureFixture
) -> None:
    """The newest is served, the oldest goes."""
    crowd = [connected(server) for _ in range(MAX_CLIENTS)]
    assert asked(server, b'{"ask": "status"}\n')["ask"] == "status"
    assert crowd[0].recv(1) == b""
    crowd[1].settimeout(0.1)
    with pytest.raises(TimeoutError):
        crowd[1].recv(1)
    assert not caplog.records
    for connection in crowd:
        connection.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="another user is needed: root only")
def test_other_users_may_ask_for_the_status_and_not_drain(server: Control) -> None:
    assert asked(server, b'{"ask": "status"}\n', 65534)["ask"] == "status"
    refused = asked(server, b'{"ask": "drain"}\n', 65534)
    assert refused == {
        "error": "only root and the user 0, who runs this server, may drain it, not the user 65534"
    }


def test_only_the_sockets_of_dead_servers_are_removed(
    folder: Path, server: Control
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as left:
        left.bind(str(folder / "dead-1.sock"))
        left.listen()
    (folder / "file.sock").touch()
    other = new("ss-2")
    assert sorted(path.name for path in folder.iterdir()) == [
        "file.sock",
        "ss-1.sock",
        "ss-2.sock",
    ]
    other.close()
    (folder / "file.sock").unlink()


def test_a_folder_that_others_can_write_in_is_not_used(folder: Path) -> None:
    folder.chmod(0o777)
    with pytest.raises(PermissionError, match="others can write in it"):
        new("ss-1")


def test_a_path_that_is_too_long_is_reported(folder: Path) -> None:
    with pytest.raises(OSError, match="too long"):
        new("s" * 120)


def test_a_request_is_decoded() -> None:
    assert msgspec.json.decode(
        b'{"ask": "drain", "wait": true}', type=LocalRequest
    ) == LocalRequest("drain", True)
