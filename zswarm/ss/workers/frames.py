"""Frames on the pipe between a server and a slot's process.

A frame is a header and a body. The header begins with a key that the server draws for each process,
so what a simulator writes into the pipe by a stray descriptor is noticed at its first byte; then
come the body's length and checksum. The server's end never blocks: what the pipe does not take is
kept until it is writable.
"""

import fcntl
import os
import resource
import secrets
import socket
import struct
import threading
import zlib

KEY_BYTES = 8
MAX_BODY = 64 << 20
READ_BYTES = 1 << 18
HIGH = 8192  # descriptors above the soft limit, of which the process's end gets one
MANY_FILES = 1 << 16  # where they are not limited
_SIZES = struct.Struct(
    "<II"
)  # of the body: its length, and its CRC-32 or 0 if not checked
_HEADER_BYTES = KEY_BYTES + _SIZES.size


class BrokenFrameError(Exception):
    """What came is not a frame."""


class FrameReader:
    """Cut received bytes into frames."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._received = bytearray()

    def feed(self, received: bytes) -> None:
        """Append received bytes."""
        self._received += received

    def next(self) -> bytes | None:
        """Return the body of the next frame; None until it is complete.

        Raises:
            BrokenFrameError: the bytes are not a frame of this key.
        """
        received = self._received
        if not self._key.startswith(begun := bytes(received[:KEY_BYTES])):
            raise BrokenFrameError(f"{begun!r}... is not the beginning of a message")
        if len(received) < _HEADER_BYTES:
            return None
        size, checksum = _SIZES.unpack_from(received, KEY_BYTES)
        if size > MAX_BODY:
            raise BrokenFrameError(f"a message of {size} bytes; at most {MAX_BODY}")
        end = _HEADER_BYTES + size
        if len(received) < end:
            return None
        body = bytes(memoryview(received)[_HEADER_BYTES:end])
        del received[:end]
        if checksum and zlib.crc32(body) != checksum:
            raise BrokenFrameError("the checksum of a message is wrong")
        return body


class ServerEnd:
    """The server's end of the pipe of one process; it never blocks.

    Args:
        pipe: this end.
        key: what every frame begins with.
    """

    def __init__(self, pipe: socket.socket, key: bytes) -> None:
        pipe.setblocking(False)
        self._pipe, self._key = pipe, key
        self._reader = FrameReader(key)
        self._lock = (
            threading.Lock()
        )  # answers of the optimizer come from zenoh's threads
        self._unsent: list[memoryview] = []

    def fileno(self) -> int:
        """Return the descriptor to wait for."""
        return self._pipe.fileno()

    def close(self) -> None:
        """Close this end, and drop what was not sent."""
        with self._lock:
            self._unsent.clear()
            self._pipe.close()

    @property
    def sending(self) -> bool:
        """Return whether something was not handed over yet."""
        return bool(self._unsent)

    def send(self, body: bytes) -> bool:
        """Send a frame as far as the pipe takes it; return whether all was handed over."""
        header = self._key + _SIZES.pack(len(body), 0)
        with self._lock:
            self._unsent += [memoryview(header), memoryview(body)]
            return self._flush()

    def flush(self) -> bool:
        """Send on; return whether all was handed over."""
        with self._lock:
            return self._flush()

    def _flush(self) -> bool:
        unsent = self._unsent
        try:
            while unsent:
                sent = self._pipe.sendmsg(unsent)
                while unsent and sent >= len(unsent[0]):
                    sent -= len(unsent.pop(0))
                if unsent:
                    unsent[0] = unsent[0][sent:]
        except BlockingIOError:
            pass
        except OSError:  # it ended, and its closed pipe wakes the loop
            unsent.clear()
        return not unsent

    def receive(self) -> bytes | None:
        """Return the body of the next frame; None until more has come.

        Raises:
            EOFError: the process closed its end.
            BrokenFrameError: something else than frames was written there.
        """
        if (body := self._reader.next()) is not None:
            return body
        try:
            received = self._pipe.recv(READ_BYTES)
        except BlockingIOError:
            return None
        except OSError:
            received = b""
        if not received:
            raise EOFError
        self._reader.feed(received)
        return self._reader.next()


class ProcessEnd:
    """The process's end; it blocks. Messages may be sent by any thread."""

    def __init__(self, pipe: socket.socket, key: bytes) -> None:
        self._pipe, self._key = pipe, key
        self._reader = FrameReader(key)
        self._lock = threading.Lock()

    def fileno(self) -> int:
        """Return the descriptor; below 0 if it was closed here."""
        return self._pipe.fileno()

    def close(self) -> None:
        """Close this end."""
        self._pipe.close()

    def hide(self) -> None:
        """Move to a random descriptor that other code does not reach by counting."""
        limits = soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        if resource.RLIM_INFINITY in limits:
            soft, hard = MANY_FILES, MANY_FILES
        end = min(hard, soft + HIGH)
        first = soft if end > soft else soft // 2
        wanted = first + secrets.randbelow(max(1, end - first - 1))
        try:
            if end > soft:
                resource.setrlimit(resource.RLIMIT_NOFILE, (end, limits[1]))
            number = fcntl.fcntl(self._pipe, fcntl.F_DUPFD_CLOEXEC, wanted)
        except (OSError, ValueError):  # a sandbox may refuse it
            os.set_inheritable(self._pipe.fileno(), False)
        else:
            self._pipe.close()
            self._pipe = socket.socket(fileno=number)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)

    def connected(self) -> bool:
        """Return whether the descriptor is still this pipe's; a simulator may have closed it."""
        try:
            return self._pipe.getsockopt(socket.SOL_SOCKET, socket.SO_TYPE) == (
                socket.SOCK_STREAM
            )
        except OSError:
            return False

    def send(self, body: bytes) -> None:
        """Send a frame."""
        sizes = _SIZES.pack(len(body), zlib.crc32(body))
        with self._lock:
            self._pipe.sendall(self._key + sizes + body)

    def receive(self) -> bytes:
        """Wait for a frame, and return its body.

        Raises:
            EOFError: the server closed its end.
            BrokenFrameError: something else read or wrote here.
        """
        while (body := self._reader.next()) is None:
            received = self._pipe.recv(READ_BYTES)
            if not received:
                raise EOFError
            self._reader.feed(received)
        return body


def new_pipe(key: bytes) -> tuple[ServerEnd, socket.socket]:
    """Return the server's end of a new pipe, and the socket for the process's end."""
    here, there = socket.socketpair()
    return ServerEnd(here, key), there


def new_key() -> bytes:
    """Draw the key of a process's frames."""
    return secrets.token_bytes(KEY_BYTES)
