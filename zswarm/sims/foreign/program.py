"""A program that is a simulator, as a child process.

Each message gets one answer; nothing is sent ahead. The program's standard error is always read, so
that writing to it never blocks the program, and its last lines are part of an error.

The program has its own process group, which is killed as a whole: with the program, and when this
process ends in any way. For that a guard, a shell, waits for the end of a pipe from this process.
"""

import contextlib
import os
import re
import select
import signal
import subprocess
import time
import weakref
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from zswarm.errors import ConfigError, EvaluationError
from zswarm.plugins.manifests import Manifest
from zswarm.sims.foreign import messages
from zswarm.sims.foreign.messages import MAX_FRAME, VERSION
from zswarm.system.processes import MAX_OUTPUT, exit_reason, wrote
from zswarm.system.text import clean

START_S = 30.0  # to send hello, or ready
ENDING_S = 1.0  # to wait for a program that closed its output or was killed
CHUNK = 1 << 16  # bytes that a pipe usually holds
LAST_CHUNKS = 16  # of standard error that are read after the program's end
# Printed text rather than the beginning of a message; colours, too.
PRINTED = re.compile(rb"[\t\n\r\x1b -~]{2,40}")
MAP = frozenset((*range(0x80, 0x90), 0xDE, 0xDF))  # first bytes of a map of msgpack
# Kills a process group when the pipe closes, unless it has read a line "done".
GUARD = 'read group && ! read done && kill -s KILL -- "-$group"'

Child = subprocess.Popen[bytes]
R = TypeVar("R", bound=messages.Reply)

_encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[messages.Reply] = msgspec.msgpack.Decoder(
    messages.Reply
)


class Program:
    """A running program of a manifest.

    Attributes:
        hello: its first message.
        set_up: what it was last set up with.

    Raises:
        ConfigError: it cannot be started, or speaks another version.
        EvaluationError: it ended, or its first message was not hello.
    """

    def __init__(self, manifest: Manifest, folder: Path) -> None:
        self._process, guard = _start(manifest, folder)
        self._pidfd = _pidfd(self._process.pid)
        self._end = weakref.finalize(self, _end, self._process, guard, self._pidfd)
        _send(guard, f"{self._process.pid}\n")
        pipes = self._process.stdin, self._process.stdout, self._process.stderr
        self._input, self._output, self._errors = (
            pipe.fileno() for pipe in pipes if pipe
        )
        for pipe in (self._input, self._output, self._errors):
            os.set_blocking(pipe, False)
        self._poll = select.poll()
        for descriptor in (self._output, self._errors, self._pidfd):
            if descriptor is not None:
                self._poll.register(descriptor, select.POLLIN)
        self._received = bytearray()
        self._errors_end = b""  # the last bytes of its standard error
        hello = self._answer("hello", time.monotonic() + START_S)
        if not isinstance(hello, messages.Hello):
            raise self._broken(f"it sent {_name(hello)} first; expected hello")
        if hello.v != VERSION:
            self.close()
            text = f"version {hello.v} of the protocol; expected version {VERSION}"
            raise ConfigError(f"its program speaks {text}")
        self.hello = hello
        self.set_up: messages.Setup | None = None

    @property
    def open(self) -> bool:
        """Return whether the program was not ended, as far as is known."""
        return self._end.alive

    def is_there(self) -> bool:
        """Return whether the program still runs according to the system."""
        return self.open and not any(
            ready == self._pidfd for ready, _ in self._poll.poll(0)
        )

    def ask(
        self,
        message: messages.Request,
        expected: tuple[type[R], ...],
        limit_s: float = 0.0,
    ) -> R | messages.Error:
        """Return the program's answer: one of the expected types, or an error.

        Args:
            message: what to send.
            expected: types of valid answers.
            limit_s: time limit; 0: none.

        Raises:
            EvaluationError: the program ended, or broke the protocol and was killed.
        """
        names = " or ".join(map(_tag, expected))
        with contextlib.suppress(BlockingIOError):  # nothing to read
            self._received += os.read(self._output, CHUNK)
        if self._received:
            raise self._broken(
                "it sent a message unasked; expected one answer to each message"
            )
        body = _encoder.encode(message)
        if len(body) > MAX_FRAME:
            text = f"has {len(body)} bytes; at most {MAX_FRAME} are sent"
            raise ValueError(f"a message to a simulator's program {text}")
        deadline = time.monotonic() + limit_s if limit_s else None
        self._write(len(body).to_bytes(4, "little") + body, names, deadline)
        answer = self._answer(names, deadline)
        if isinstance(answer, (*expected, messages.Error)):
            return answer  # type: ignore[return-value]  # mypy cannot narrow by a tuple of types
        raise self._broken(f"it sent {_name(answer)}; expected {names}")

    def close(self) -> None:
        """Kill the program and its process group."""
        self._end()

    def _write(self, frame: bytes, expected: str, deadline: float | None) -> None:
        rest = memoryview(frame)
        waits = False
        try:
            while rest:
                with contextlib.suppress(BlockingIOError):
                    rest = rest[os.write(self._input, rest) :]
                if rest and not waits:
                    self._poll.register(self._input, select.POLLOUT)
                    waits = True
                while rest and self._input not in self._wait(expected, deadline):
                    pass
        except BrokenPipeError:
            raise self._ended(expected) from None
        finally:
            if waits:
                with contextlib.suppress(KeyError, OSError):  # closed with the program
                    self._poll.unregister(self._input)

    def _answer(self, expected: str, deadline: float | None) -> messages.Reply:
        received = self._received
        while len(received) < 5 or len(received) < 4 + int.from_bytes(
            received[:4], "little"
        ):
            self._check_frame(expected)
            self._wait(expected, deadline)
        self._check_frame(expected)
        end = 4 + int.from_bytes(received[:4], "little")
        body = bytes(received[4:end])
        del received[:end]
        try:
            return _decoder.decode(body)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            text = f"it sent an invalid message: {clean(str(error))}; expected {expected}"
            raise self._broken(text) from None

    def _check_frame(self, expected: str) -> None:
        """Check that the bytes received begin a message: a length, then a map."""
        received = self._received
        if len(received) < 4:
            return
        length = int.from_bytes(received[:4], "little")
        is_map = bool(length) and (len(received) == 4 or received[4] in MAP)
        if is_map and length <= MAX_FRAME:
            return
        if printed := PRINTED.match(received):
            shown = printed[0].decode().strip().partition("\n")[0]
            text = f"its standard output has {shown!r}; print to standard error only"
        elif length > MAX_FRAME:
            text = (
                f"it sent a message of {length} bytes; at most {MAX_FRAME} are accepted"
            )
        else:
            text = "it sent a message that is not a map"
        raise self._broken(f"{text}; expected {expected}")

    def _wait(self, expected: str, deadline: float | None) -> set[int]:
        """Read what comes next; return the descriptors that were ready."""
        left = None if deadline is None else max(0.0, deadline - time.monotonic()) * 1000
        ready = {descriptor for descriptor, _ in self._poll.poll(left)}
        if not ready:
            raise self._broken(f"it sent nothing for {START_S:g} s; expected {expected}")
        if self._errors in ready and not self._read_errors():
            self._poll.unregister(self._errors)  # closed
        if self._output in ready:
            chunk = os.read(self._output, CHUNK)
            if not chunk:
                raise self._ended(expected)
            self._received += chunk
        elif self._pidfd in ready:
            # Nothing more comes, though a process that it started may hold its output open.
            raise self._ended(expected)
        return ready

    def _read_errors(self) -> bool:
        """Read standard error; return whether there may be more."""
        try:
            chunk = os.read(self._errors, CHUNK)
        except BlockingIOError:
            return True
        self._errors_end = (self._errors_end + chunk)[-4 * MAX_OUTPUT :]
        return bool(chunk)

    def _ended(self, expected: str) -> EvaluationError:
        """Return the error of a program that ended on its own."""
        reason = exit_reason(_exit_code(self._process.pid), "closed its input or output")
        return self._error(f"{reason}; expected {expected}")

    def _broken(self, why: str) -> EvaluationError:
        """Return the error of a program that broke the protocol.

        It is killed, for its next messages could not be understood.
        """
        return self._error(f"was ended: {why}")

    def _error(self, text: str) -> EvaluationError:
        for _ in range(LAST_CHUNKS):
            self._read_errors()
        self.close()
        return EvaluationError(f"its program {text}{wrote(self._errors_end)}")


def _start(manifest: Manifest, folder: Path) -> tuple[Child, Child]:
    """Start the program and its guard."""
    pipe = subprocess.PIPE
    null = subprocess.DEVNULL
    command = ["/bin/sh", "-c", GUARD]
    guard = subprocess.Popen(
        command, stdin=pipe, stdout=null, stderr=null, process_group=0
    )
    try:
        process = subprocess.Popen(
            manifest.command,
            cwd=folder,
            bufsize=0,
            process_group=0,
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
        )
    except OSError as error:
        _dismiss(guard)
        text = f"{manifest.command[0]} cannot be started: {error.strerror}"
        raise ConfigError(text) from None
    return process, guard


def _pidfd(process: int) -> int | None:
    """Return a descriptor that is ready when a process ends; None without system support."""
    try:
        return os.pidfd_open(process)
    except (AttributeError, OSError):
        return None


def _exit_code(process: int) -> int | None:
    """Return the exit code as ``subprocess`` has it; None for a process that does not end.

    The process is not reaped: its number cannot become that of another process yet.
    """
    end = time.monotonic() + ENDING_S
    while (
        found := os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT | os.WNOHANG)
    ) is None:
        if time.monotonic() > end:
            return None
        time.sleep(0.001)
    return found.si_status if found.si_code == os.CLD_EXITED else -found.si_status


def _end(process: Child, guard: Child, pidfd: int | None) -> None:
    """Kill a program's process group, and dismiss the guard."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            pipe.close()
    if pidfd is not None:
        os.close(pidfd)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(ENDING_S)
    _dismiss(guard)


def _dismiss(guard: Child) -> None:
    _send(guard, "done\ndone\n")
    with contextlib.suppress(OSError, AttributeError):
        guard.stdin.close()  # type: ignore[union-attr]  # a pipe
    with contextlib.suppress(subprocess.TimeoutExpired):
        guard.wait(ENDING_S)


def _send(guard: Child, text: str) -> None:
    assert guard.stdin  # noqa: S101  a pipe
    with contextlib.suppress(OSError):  # the guard was killed
        guard.stdin.write(text.encode())
        guard.stdin.flush()


def _name(message: messages.Reply) -> str:
    """Return the type of a message, for an error."""
    if isinstance(message, messages.Error):
        return f"error {clean(message.text)!r}"
    return _tag(type(message))


def _tag(kind: type[Any]) -> str:
    return str(kind.__struct_config__.tag)
