"""The control socket, with real connections."""

import json
import os
import select
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from zswarm.ss import control
from zswarm.ss.control import CLIENTS, Control, Question


class Told(msgspec.Struct):
    """What the server answers here."""

    ask: str
    text: str = "x" * 1_000_000  # more than a socket takes at once


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="zs-") as name:
        Path(name).chmod(0o755)
        monkeypatch.setenv("RUNTIME_DIRECTORY", name)
        yield Path(name)


@pytest.fixture
def server(folder: Path) -> Iterator[Control]:
    made = Control("ss-1", lambda question: Told(question.ask))
    yield made
    made.close()
    assert list(folder.iterdir()) == []


def turn(server: Control, wait_s: float = 0.0) -> None:
    """What the owner loop does."""
    poll = select.poll()
    for descriptor, flags in server.wants().items():
        poll.register(descriptor, flags)
    server.serve([descriptor for descriptor, _ in poll.poll(wait_s * 1000)])


def connected(server: Control) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.connect(str(server.path))
    connection.setblocking(False)
    return connection


def asked(server: Control, line: bytes, user: int = os.geteuid()) -> dict[str, object]:
    """The answer to a user."""
    before = os.geteuid()
    os.seteuid(user)
    connecting = connected(server)
    os.seteuid(before)
    with connecting as connection:
        connection.send(line)
        answer = b""
        while True:
            try:
                came = connection.recv(1 << 20)
            except BlockingIOError:
                turn(server, 5.0)
                continue
            except ConnectionResetError:  # it was let go before it said all
                came = b""
            if not came:
                return json.loads(answer)  # type: ignore[no-any-return]
            answer += came


def test_a_question_has_its_answer(server: Control) -> None:
    assert asked(server, b'{"ask": "status"}\n') == {"ask": "status", "text": "x" * 1_000_000}
    assert asked(server, b'{"ask": "drain"}\n')["ask"] == "drain"


@pytest.mark.parametrize(
    "line",
    [
        b"\n", b"status\n", b'{"ask": "stop"}\n', b'{"ask": "status", "more": 1}\n', b'{"ask": "drain", "wait": 1}\n',
        b"[" * 1000 + b"\n", b"\xff\xfe\n", b"x" * 1025, b"null\n",
    ],
)  # fmt: skip
def test_what_is_no_question_is_refused_with_what_was_expected(server: Control, line: bytes) -> None:
    assert str(asked(server, line)["error"]).startswith(
        ("expected one line of at most 1024 bytes", 'expected {"ask": "status"} or')
    )


def test_who_says_nothing_reads_nothing_or_hangs_up_is_let_go(server: Control, monkeypatch: pytest.MonkeyPatch) -> None:
    silent, half, deaf, gone = (connected(server) for _ in range(4))
    for _ in range(4):
        turn(server)
    half.send(b'{"ask": ')
    deaf.send(b'{"ask": "status"}\n')
    gone.send(b'{"ask": "status"}\n')
    gone.close()
    for _ in range(10):
        turn(server)
    assert asked(server, b'{"ask": "status"}\n')["ask"] == "status"
    assert len(server.wants()) == 1 + 3
    monkeypatch.setattr(control.time, "monotonic", lambda: server.until() + 1.0)
    server.serve([])
    monkeypatch.undo()
    assert len(server.wants()) == 1
    for connection in (silent, half, deaf):
        connection.close()


def test_no_more_than_so_many_are_kept(server: Control) -> None:
    """The newest is served, the oldest goes."""
    crowd = [connected(server) for _ in range(CLIENTS)]
    for _ in crowd:
        turn(server)
    assert asked(server, b'{"ask": "status"}\n')["ask"] == "status"
    assert len(server.wants()) == CLIENTS
    assert crowd[0].recv(1) == b""
    for connection in crowd:
        connection.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="another user is needed: root only")
def test_others_may_look_and_not_drain(server: Control) -> None:
    assert asked(server, b'{"ask": "status"}\n', 65534)["ask"] == "status"
    refused = asked(server, b'{"ask": "drain"}\n', 65534)
    assert refused == {"error": "only root and the user 0, who runs this server, may drain it, not the user 65534"}


def test_a_socket_that_a_killed_server_left_is_taken_away_and_a_living_ones_is_not(folder: Path, server: Control) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as left:
        left.bind(str(folder / "dead-1.sock"))
        left.listen()
    (folder / "file.sock").touch()
    other = Control("ss-2", lambda question: Told(question.ask))
    assert sorted(path.name for path in folder.iterdir()) == ["file.sock", "ss-1.sock", "ss-2.sock"]
    other.close()
    (folder / "file.sock").unlink()


def test_a_folder_that_others_can_write_in_is_not_used(folder: Path) -> None:
    folder.chmod(0o777)
    with pytest.raises(PermissionError, match="others can write in it"):
        Control("ss-1", lambda question: Told(question.ask))


def test_a_path_that_is_too_long_is_told(folder: Path) -> None:
    with pytest.raises(OSError, match="too long"):
        Control("s" * 120, lambda question: Told(question.ask))


def test_where_the_socket_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """systemd's folder, root's, the session's, or one in the temporary folder."""
    assert control.folder({"RUNTIME_DIRECTORY": "/run/a:/run/b"}) == Path("/run/a")
    monkeypatch.setattr(control.os, "geteuid", lambda: 0)
    assert control.folder({"XDG_RUNTIME_DIR": "/run/user/0"}) == Path("/run/zswarm")
    monkeypatch.setattr(control.os, "geteuid", lambda: 7)
    assert control.folder({"XDG_RUNTIME_DIR": "/run/user/7"}) == Path("/run/user/7/zswarm")
    assert control.folder({}).name == "zswarm-7"


def test_a_question_is_one_of_two() -> None:
    assert msgspec.json.decode(b'{"ask": "drain", "wait": true}', type=Question) == Question("drain", True)
