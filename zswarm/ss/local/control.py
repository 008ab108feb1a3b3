"""The local control socket of a server: a JSON line as request, one as answer.

``{"ask": "status"}`` is for every user who reaches the socket, ``{"ask": "drain"}`` for the user of
the server and root; with ``"wait": true`` the connection stays open until the server ends. A thread
serves the clients and drops slow ones; only valid requests reach the server's loop.
"""

import asyncio
import contextlib
import errno
import os
import socket
import struct
import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from zswarm.system.locks import make_private, private_folder

MAX_CLIENTS = 16  # at once; one more, and the oldest is dropped
# Turns of the loop after which a client that was just accepted has a task, which is then ended.
ACCEPTED = 3
MAX_REQUEST = 1024  # bytes
CLIENT_S = 5.0  # for request and answer
SUFFIX = ".sock"


class LocalRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A request."""

    ask: Literal["status", "drain"]
    wait: bool = False


class ControlRefused(msgspec.Struct, frozen=True):
    """The answer to a request that is not valid or not allowed."""

    error: str


class Draining(msgspec.Struct, frozen=True):
    """The answer to drain."""

    server: str
    draining: Literal[True] = True


class LocalQuery(NamedTuple):
    """A request to the server's loop, and where it puts the answer."""

    request: LocalRequest
    answer: Future[msgspec.Struct]


class Control:
    """The server's end of the socket, in a thread.

    Args:
        server: id of the server, which names the socket.
        put: gives the loop the request of a user who may send it.
    """

    def __init__(self, server: str, put: Callable[[LocalQuery], None]) -> None:
        here = private_folder()
        make_private(here)
        for path in here.glob("*" + SUFFIX):
            if _is_dead(path):
                with contextlib.suppress(OSError):
                    path.unlink()
        self.path = here / (server + SUFFIX)
        self._put = put
        self._socket = socket.socket(
            socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC
        )
        try:
            self._socket.bind(str(self.path))
            self.path.chmod(0o666)  # ``_reply`` checks who may drain
            self._socket.listen()
        except OSError as error:
            self._socket.close()
            # Python gives no number for a path that is too long
            number, reason = (
                error.errno or errno.ENAMETOOLONG,
                error.strerror or str(error),
            )
            raise OSError(number, reason, str(self.path)) from None
        self._clients: list[Any] = []  # the tasks that serve them, the oldest first
        self._closing = asyncio.Event()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Drop all clients, and remove the socket."""
        self._loop.call_soon_threadsafe(self._closing.set)
        self._thread.join()
        self.path.unlink(missing_ok=True)

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._listen())

    async def _listen(self) -> None:
        server = await asyncio.start_unix_server(
            self._accept, sock=self._socket, limit=MAX_REQUEST
        )
        await self._closing.wait()
        # Not ``server.close``: a client that was just accepted could not attach to a closed server.
        self._loop.remove_reader(self._socket.fileno())
        for _ in range(ACCEPTED):
            await asyncio.sleep(0)
        server.close()

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client in a task; drop the oldest if there are too many.

        The task is made here because asyncio prints the end of its own if they are cancelled.
        """
        task = self._loop.create_task(self._serve(reader, writer))
        task.add_done_callback(lambda _: writer.transport.abort())
        self._clients.append(task)
        if len(self._clients) > MAX_CLIENTS:
            self._clients.pop(0).cancel()

    async def _serve(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Answer a client, and stay connected if it waits for the server's end."""
        task = asyncio.current_task()
        writer.transport.set_write_buffer_limits(0)  # ``drain`` waits until all is sent
        try:
            async with asyncio.timeout(CLIENT_S):
                reply, waits = await self._reply(reader, _user(writer))
                writer.write(msgspec.json.encode(reply) + b"\n")
                await writer.drain()
            self._clients.remove(task)
            while waits and await reader.read(MAX_REQUEST):
                pass
        except (OSError, EOFError):  # it is gone, or too slow
            pass
        finally:
            if task in self._clients:
                self._clients.remove(task)

    async def _reply(
        self, reader: asyncio.StreamReader, user: int
    ) -> tuple[msgspec.Struct, bool]:
        """Return the answer to a request, and whether the client waits for the server's end."""
        try:
            line = await reader.readuntil(b"\n")
            request = msgspec.json.decode(line, type=LocalRequest)
        except asyncio.LimitOverrunError:
            return ControlRefused(
                f"expected one line of at most {MAX_REQUEST} bytes"
            ), False
        except (msgspec.DecodeError, RecursionError) as error:
            expected = 'expected {"ask": "status"} or {"ask": "drain"}'
            return ControlRefused(f"{expected}: {error}"), False
        if request.ask == "drain" and user not in (0, own := os.geteuid()):
            allowed = f"only root and the user {own}, who runs this server, may drain it"
            return ControlRefused(f"{allowed}, not the user {user}"), False
        query = LocalQuery(request, Future())
        self._put(query)
        return await asyncio.wrap_future(
            query.answer
        ), request.ask == "drain" and request.wait


def _is_dead(path: Path) -> bool:
    """Return whether the server of a socket ended without removing it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        return path.is_socket() and probe.connect_ex(str(path)) == errno.ECONNREFUSED


def _user(writer: asyncio.StreamWriter) -> int:
    size = struct.calcsize("3i")
    connection = writer.get_extra_info("socket")
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
    _, user, _ = struct.unpack("3i", credentials)
    return int(user)
