"""A TCP proxy in user space: a slow or long link between two programs, that can be reset."""

import contextlib
import queue
import socket
import struct
import threading
import time
from types import TracebackType
from typing import Self

CHUNK = 1024  # bytes: at 20 kB/s, a chunk every 0.05 s
BUFFER = 8192  # bytes the kernel keeps for it: what a sender wrote is soon on the way
RESET = struct.pack("ii", 1, 0)  # closing sends RST


class Proxy:
    """Forward ``endpoint`` to ``target``.

    Args:
        rate: bytes/s of each direction of a connection.
        delay_s: that all bytes are later there.

    Attributes:
        connections: on which something was sent: not those that only find out who listens.
        there: bytes forwarded to the target.
        back: bytes forwarded from it.
    """

    def __init__(
        self, target: str, rate: float = float("inf"), delay_s: float = 0.0
    ) -> None:
        host, port = target.removeprefix("tcp/").split(":")
        self._target, self._rate, self._delay_s = (host, int(port)), rate, delay_s
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=8)
        # Inherited by what it accepts.
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self.connections, self.there, self.back = 0, 0, 0
        self._sockets: list[socket.socket] = []
        self._lock = threading.Lock()
        self._closed = False

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._closed = True
        self._listener.close()
        self.reset()

    def reset(self) -> None:
        """End all connections with RST; accept new ones."""
        with self._lock:
            sockets, self._sockets = self._sockets, []
        for end in sockets:
            with contextlib.suppress(OSError):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def _accept(self) -> None:
        while not self._closed:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                far = socket.socket()
                far.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
                far.connect(self._target)
            except OSError:
                near.close()
                continue
            with self._lock:
                self._sockets += [near, far]
            threading.Thread(target=self._forward, args=(near, far), daemon=True).start()
            threading.Thread(
                target=self._forward, args=(far, near), kwargs={"back": True}, daemon=True
            ).start()

    def _forward(
        self, source: socket.socket, sink: socket.socket, *, back: bool = False
    ) -> None:
        late: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()
        writer = threading.Thread(target=_write, args=(late, sink), daemon=True)
        if self._delay_s:
            writer.start()
        due = time.monotonic()
        used = back
        with contextlib.suppress(OSError):
            while data := source.recv(CHUNK):
                if not used:
                    self.connections += 1
                    used = True
                if self._delay_s:
                    late.put((time.monotonic() + self._delay_s, data))
                else:
                    sink.sendall(data)
                if back:
                    self.back += len(data)
                else:
                    self.there += len(data)
                due = max(due, time.monotonic()) + len(data) / self._rate
                time.sleep(max(0.0, due - time.monotonic()))
        if self._delay_s:
            late.put((0.0, b""))
            writer.join()
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


def _write(late: queue.SimpleQueue[tuple[float, bytes]], sink: socket.socket) -> None:
    """Write data, each when it is due, until there is none."""
    with contextlib.suppress(OSError):
        while True:
            due, data = late.get()
            if not data:
                return
            time.sleep(max(0.0, due - time.monotonic()))
            sink.sendall(data)
