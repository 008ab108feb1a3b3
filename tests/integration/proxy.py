"""A TCP proxy in user space: a slow link between two programs, that can be reset."""

import contextlib
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
    """Forward ``endpoint`` to ``target``, each direction of a connection at ``rate`` bytes/s."""

    def __init__(self, target: str, rate: float = float("inf")) -> None:
        host, port = target.removeprefix("tcp/").split(":")
        self._target, self._rate = (host, int(port)), rate
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=8)
        # Inherited by what it accepts.
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self.connections = 0
        self.there, self.back = 0, 0  # bytes forwarded to the target, and from it
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
            self.connections += 1
            threading.Thread(target=self._forward, args=(near, far), daemon=True).start()
            threading.Thread(
                target=self._forward, args=(far, near), kwargs={"back": True}, daemon=True
            ).start()

    def _forward(
        self, source: socket.socket, sink: socket.socket, *, back: bool = False
    ) -> None:
        due = time.monotonic()
        with contextlib.suppress(OSError):
            while data := source.recv(CHUNK):
                sink.sendall(data)
                if back:
                    self.back += len(data)
                else:
                    self.there += len(data)
                due = max(due, time.monotonic()) + len(data) / self._rate
                time.sleep(max(0.0, due - time.monotonic()))
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
