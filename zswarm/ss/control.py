"""The local control socket of a server: one JSON line asked, one answered, in the owner loop and without ever blocking it.

``{"ask": "status"}`` is for everybody who reaches the socket, ``{"ask": "drain"}`` for the server's own user and root; with
``"wait": true`` the connection then stays open until the server ended. What is too long, too slow or too many is dropped.
"""

import contextlib
import errno
import math
import os
import select
import socket
import stat
import struct
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import msgspec

CLIENTS = 16  # at once; one more, and the oldest goes
MAX_QUESTION = 1024  # bytes
CLIENT_S = 5.0  # for question and answer
SUFFIX = ".sock"


class Question(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is asked."""

    ask: Literal["status", "drain"]
    wait: bool = False


class Refused(msgspec.Struct, frozen=True):
    """The answer when there is none."""

    error: str


class Draining(msgspec.Struct, frozen=True):
    """The answer to drain."""

    server: str
    draining: Literal[True] = True


def folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Where a server of this user puts its socket."""
    if runtime := environment.get("RUNTIME_DIRECTORY", "").split(":")[0]:  # systemd's, for this service
        return Path(runtime)
    if os.geteuid() == 0:
        return Path("/run/zswarm")
    if runtime := environment.get("XDG_RUNTIME_DIR", ""):
        return Path(runtime) / "zswarm"
    return Path(tempfile.gettempdir()) / f"zswarm-{os.geteuid()}"


class _Client:
    """A connection."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.until = time.monotonic() + CLIENT_S
        self.question = b""
        self.answer = b""
        self.stays = False  # until the server ends


class Control:
    """The server's end.

    Attributes:
        path: of the socket.
    """

    def __init__(self, server: str, answer: Callable[[Question], msgspec.Struct]) -> None:
        """Listen.

        Args:
            server: id of the server, which names the socket.
            answer: gives the answer to a question; whether who asks may drain was checked.

        Raises:
            OSError: that is not possible here; ``strerror`` says why.
        """
        self._answer = answer
        self._clients: dict[int, _Client] = {}
        here = folder()
        _make(here)
        for path in here.glob("*" + SUFFIX):
            if _is_dead(path):
                with contextlib.suppress(OSError):
                    path.unlink()
        self.path = here / (server + SUFFIX)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)
        try:
            self._socket.bind(str(self.path))
            self.path.chmod(0o666)  # who may drain is checked
            self._socket.listen()
        except OSError as error:  # Python says of a long path only that it is too long, without a number
            self._socket.close()
            raise OSError(error.errno or errno.ENAMETOOLONG, error.strerror or str(error), str(self.path)) from None

    def wants(self) -> dict[int, int]:
        """Descriptors to poll, and for what."""
        wants = {number: select.POLLOUT if client.answer else select.POLLIN for number, client in self._clients.items()}
        return wants | {self._socket.fileno(): select.POLLIN}

    def until(self) -> float:
        """When to call ``serve`` if nothing happens, by the monotonic clock."""
        return min((client.until for client in self._clients.values()), default=math.inf)

    def serve(self, ready: list[int]) -> None:
        """Take what came on these descriptors, and let go who takes too long."""
        for number in ready:
            if number == self._socket.fileno():
                self._accept()
            elif client := self._clients.get(number):
                try:
                    done = self._write(client) if client.answer else self._read(client)
                except BlockingIOError:
                    done = False
                except OSError:
                    done = True
                if done:
                    self._drop(number)
        now = time.monotonic()
        for number in [number for number, client in self._clients.items() if client.until <= now]:
            self._drop(number)

    def close(self) -> None:
        """Let go all, and take the socket away."""
        for number in list(self._clients):
            self._drop(number)
        self._socket.close()
        with contextlib.suppress(OSError):
            self.path.unlink()

    def _accept(self) -> None:
        for _ in range(CLIENTS):  # at once: the loop goes on
            try:
                connection, _ = self._socket.accept()
            except OSError:  # nobody is left, or there are too many open files: they wait
                return
            connection.setblocking(False)
            if len(self._clients) >= CLIENTS:
                self._drop(min(self._clients, key=lambda number: self._clients[number].until))
            self._clients[connection.fileno()] = _Client(connection)

    def _drop(self, number: int) -> None:
        self._clients.pop(number).connection.close()

    def _read(self, client: _Client) -> bool:
        """Whether the connection has done its work."""
        came = client.connection.recv(MAX_QUESTION)
        if not came or client.stays:
            return not came
        client.question += came
        if b"\n" in client.question:
            line, _, _ = client.question.partition(b"\n")
            client.answer = msgspec.json.encode(self._reply(client, line)) + b"\n"
        elif len(client.question) > MAX_QUESTION:
            client.answer = msgspec.json.encode(Refused(f"expected one line of at most {MAX_QUESTION} bytes")) + b"\n"
        return bool(client.answer) and self._write(client)  # at once: the loop may end on what was asked

    def _reply(self, client: _Client, line: bytes) -> msgspec.Struct:
        try:
            question = msgspec.json.decode(line, type=Question)
        except (msgspec.DecodeError, RecursionError) as error:
            return Refused(f'expected {{"ask": "status"}} or {{"ask": "drain"}}: {error}')
        if question.ask == "drain":
            asker = _user(client.connection)
            if asker not in (0, os.geteuid()):
                return Refused(f"only root and the user {os.geteuid()}, who runs this server, may drain it, not the user {asker}")
            client.stays = question.wait
        return self._answer(question)

    def _write(self, client: _Client) -> bool:
        client.answer = client.answer[client.connection.send(client.answer) :]
        if client.stays and not client.answer:
            client.until = math.inf
        return not client.answer and not client.stays


def _make(here: Path) -> None:
    """The folder; one that others can write in is not used."""
    if not here.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(here.parent))
    with contextlib.suppress(FileExistsError):
        here.mkdir(mode=0o755 if os.geteuid() == 0 else 0o700)
    found = here.stat(follow_symlinks="RUNTIME_DIRECTORY" in os.environ)  # systemd's is a link where the user is dynamic
    if not stat.S_ISDIR(found.st_mode) or found.st_uid not in (0, os.geteuid()) or found.st_mode & 0o022:
        raise PermissionError(errno.EPERM, "it is no folder of this user, or others can write in it", str(here))


def _is_dead(path: Path) -> bool:
    """Whether the server of a socket ended without taking it away."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        return path.is_socket() and probe.connect_ex(str(path)) == errno.ECONNREFUSED


def _user(connection: socket.socket) -> int:
    """Who is at the other end."""
    _, user, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
    return int(user)
