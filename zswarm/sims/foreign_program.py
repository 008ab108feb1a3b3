"""A program that is a simulator, as a child process: starts it, asks it, ends it.

One message is asked, one comes back; nothing is sent ahead. What the program writes to its standard error is read so that it
never waits for that, and the last of it is told when it ends.

The program has a process group of its own, which is ended as a whole: with the program, and when this process ends in whatever
way. For that there is a guard, a shell that waits for the end of a pipe from this process.
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

import msgspec

from zswarm.errors import ConfigError, EvaluationError
from zswarm.manifests import Manifest
from zswarm.protocol.codec import clean
from zswarm.sims.foreign_messages import MAX_FRAME, VERSION, Asked, Error, Hello, Said, Setup

START_S = 30.0  # to say hello, or that it is ready
ENDING_S = 1.0  # a program that closed its output, or was killed, is waited for
CHUNK = 1 << 16  # bytes that a pipe has, mostly
MAX_LAST_WORDS = 200  # characters of its standard error in an error
LISTENED = 16  # pipes full of it that are read when it ended
PRINTED = re.compile(rb"[\t\n\r\x1b -~]{2,40}")  # rather than the beginning of a message; colours, too
MAP = frozenset((*range(0x80, 0x90), 0xDE, 0xDF))  # how a map of msgpack begins
# Ends a process group when the pipe closes; a line "done" says that it need not.
GUARD = 'read group && ! read done && kill -s KILL -- "-$group"'

_encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[Said] = msgspec.msgpack.Decoder(Said)


class Program:
    """A program of a manifest, started.

    Attributes:
        hello: what it said first.
        set_up: what it was last set up with.
    """

    def __init__(self, manifest: Manifest, folder: Path) -> None:
        """Start it.

        Raises:
            ConfigError: it cannot be started, or speaks another version.
            EvaluationError: it said something else than hello, nothing, or ended.
        """
        guard = subprocess.Popen(
            ["/bin/sh", "-c", GUARD], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            process_group=0,
        )  # fmt: skip
        try:
            self._process = subprocess.Popen(
                manifest.command, cwd=folder, bufsize=0, process_group=0,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
        except OSError as error:
            _release(guard)
            raise ConfigError(f"{manifest.command[0]} cannot be started: {error.strerror}") from None
        watch = _watched(self._process.pid)
        self._end = weakref.finalize(self, _end, self._process, guard, watch)
        _tell(guard, f"{self._process.pid}\n")
        assert self._process.stdin and self._process.stdout and self._process.stderr  # noqa: S101, PT018  pipes, as asked for
        self._input, self._output = self._process.stdin.fileno(), self._process.stdout.fileno()
        self._errors: int = self._process.stderr.fileno()
        for pipe in (self._input, self._output, self._errors):
            os.set_blocking(pipe, False)
        self._poll = select.poll()
        for pipe in (self._output, self._errors):
            self._poll.register(pipe, select.POLLIN)
        self._watch = watch
        if watch is not None:
            self._poll.register(watch, select.POLLIN)
        self._said = bytearray()  # what came and was not taken yet
        self._words = b""  # the last of its standard error
        hello = self._answer("hello", time.monotonic() + START_S)
        if not isinstance(hello, Hello):
            raise self._broken(f"it said {_type(hello)} first; hello was expected")
        if hello.v != VERSION:
            self.close()
            raise ConfigError(f"its program speaks version {hello.v} of the protocol; version {VERSION} was expected")
        self.hello = hello
        self.set_up: Setup | None = None

    @property
    def open(self) -> bool:
        """Whether it can be asked; not once it ended or was ended."""
        return self._end.alive

    def is_there(self) -> bool:
        """Whether it can be asked, and did not end since it was; where the system does not say, it is."""
        return self.open and not any(happened == self._watch for happened, _ in self._poll.poll(0))

    def ask(self, message: Asked, expected: tuple[type[Said], ...], limit_s: float = 0.0) -> Said:
        """Its answer.

        Args:
            expected: kinds of answers that fit.
            limit_s: it may take so long; 0: any time.

        Raises:
            EvaluationError: it ended, or broke the protocol and was ended for it; the text says what was expected.
        """
        what = " or ".join(_tag(kind) for kind in expected if kind is not Error)
        with contextlib.suppress(BlockingIOError):  # nothing
            self._said += os.read(self._output, CHUNK)
        if self._said:
            raise self._broken("it said more than was asked; one answer to each message was expected")
        body = _encoder.encode(message)
        if len(body) > MAX_FRAME:
            raise ValueError(f"a message to a simulator's program has {len(body)} bytes; at most {MAX_FRAME} are sent")
        deadline = time.monotonic() + limit_s if limit_s else None
        self._write(len(body).to_bytes(4, "little") + body, what, deadline)
        answer = self._answer(what, deadline)
        if not isinstance(answer, expected):
            raise self._broken(f"it said {_type(answer)} where {what} was expected")
        return answer

    def close(self) -> None:
        """End it and all that it started."""
        self._end()

    def _write(self, frame: bytes, what: str, deadline: float | None) -> None:
        rest = memoryview(frame)
        try:
            rest = rest[os.write(self._input, rest) :]
            if not rest:
                return
        except BlockingIOError:
            pass
        except BrokenPipeError:
            raise self._ended(what) from None
        self._poll.register(self._input, select.POLLOUT)
        try:
            while rest:
                if self._input not in self._wait(what, deadline):
                    continue
                with contextlib.suppress(BlockingIOError):
                    rest = rest[os.write(self._input, rest) :]
        except BrokenPipeError:
            raise self._ended(what) from None
        finally:
            with contextlib.suppress(KeyError, OSError):  # it is closed when the program was ended
                self._poll.unregister(self._input)

    def _answer(self, what: str, deadline: float | None) -> Said:
        said = self._said
        while len(said) < 5 or len(said) < 4 + int.from_bytes(said[:4], "little"):
            self._check_frame(what)
            self._wait(what, deadline)
        self._check_frame(what)
        end = 4 + int.from_bytes(said[:4], "little")
        body = bytes(said[4:end])
        del said[:end]
        try:
            return _decoder.decode(body)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise self._broken(f"it said what is no message: {clean(str(error))}; {what} was expected") from None

    def _check_frame(self, what: str) -> None:
        """See whether what came may be a message: a length, then the beginning of a map."""
        length = int.from_bytes(self._said[:4], "little") if len(self._said) >= 4 else 0
        no_map = (len(self._said) > 4 and self._said[4] not in MAP) or (len(self._said) >= 4 and not length)
        if not no_map and length <= MAX_FRAME:
            return
        printed = PRINTED.match(self._said)
        if printed:
            shown = printed[0].decode().strip().partition("\n")[0]
            raise self._broken(
                f"its standard output has {shown!r} where {what} was expected; messages alone belong there, "
                "whatever else to standard error"
            )
        said = f"a message of {length} bytes; at most {MAX_FRAME} are taken" if length > MAX_FRAME else "what is no map"
        raise self._broken(f"it said {said}; {what} was expected")

    def _wait(self, what: str, deadline: float | None) -> set[int]:
        """Wait until something comes, and take it; the pipes on which something happened."""
        left = None if deadline is None else max(0.0, deadline - time.monotonic()) * 1000
        happened = {pipe for pipe, _ in self._poll.poll(left)}
        if not happened:
            raise self._broken(f"it said nothing for {START_S:g} s; {what} was expected")
        if self._errors in happened and not self._listen():
            self._poll.unregister(self._errors)  # closed
        if self._output in happened:
            chunk = os.read(self._output, CHUNK)
            if not chunk:
                raise self._ended(what)
            self._said += chunk
        elif self._watch in happened:  # and nothing more comes, though a process that it started may hold its output open
            raise self._ended(what)
        return happened

    def _listen(self) -> bool:
        """Take what it wrote to its standard error; whether there may be more."""
        try:
            chunk = os.read(self._errors, CHUNK)
        except BlockingIOError:
            return True
        self._words = (self._words + chunk)[-4 * MAX_LAST_WORDS :]
        return bool(chunk)

    def _ended(self, what: str) -> EvaluationError:
        """It ended by itself."""
        how = _how_it_ended(self._process.pid)
        for _ in range(LISTENED):
            self._listen()
        self.close()
        return EvaluationError(f"its program {how}; {what} was expected{self._last_words()}")

    def _broken(self, why: str) -> EvaluationError:
        """It broke the protocol; it is ended, for nobody knows what it would say next."""
        for _ in range(LISTENED):
            self._listen()
        self.close()
        return EvaluationError(f"its program was ended: {why}{self._last_words()}")

    def _last_words(self) -> str:
        lines = [line.strip() for line in self._words.decode(errors="replace").splitlines() if line.strip()]
        text = clean(" / ".join(lines[-3:]))[-MAX_LAST_WORDS:]
        return f"; it wrote: {text}" if text else ""


def _watched(process: int) -> int | None:
    """What can be polled for the end of a process; None where the system has no such thing."""
    try:
        return os.pidfd_open(process)
    except (AttributeError, OSError):
        return None


def _how_it_ended(process: int) -> str:
    """In words; it stays to be waited for, so that its number is nobody else's yet."""
    end = time.monotonic() + ENDING_S
    while (found := os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT | os.WNOHANG)) is None:
        if time.monotonic() > end:
            return "closed its input or output"
        time.sleep(0.001)
    if found.si_code == os.CLD_EXITED:
        return f"ended with code {found.si_status}"
    names = {number.value: f" ({number.name})" for number in signal.Signals}
    return f"was killed by signal {found.si_status}{names.get(found.si_status, '')}"


def _end(process: "subprocess.Popen[bytes]", guard: "subprocess.Popen[bytes]", watch: int | None) -> None:
    """End a program with all of its group, and the guard."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            pipe.close()
    if watch is not None:
        os.close(watch)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(ENDING_S)
    _release(guard)


def _release(guard: "subprocess.Popen[bytes]") -> None:
    _tell(guard, "done\ndone\n")
    with contextlib.suppress(subprocess.TimeoutExpired):
        guard.wait(ENDING_S)


def _tell(guard: "subprocess.Popen[bytes]", text: str) -> None:
    assert guard.stdin  # noqa: S101  a pipe, as asked for
    with contextlib.suppress(OSError):  # somebody killed it
        guard.stdin.write(text.encode())
        guard.stdin.flush()
        if text.startswith("done"):
            guard.stdin.close()


def _type(message: Said) -> str:
    """Of a message, for an error."""
    return f"error {clean(message.text)!r}" if isinstance(message, Error) else _tag(type(message))


def _tag(kind: type[Said]) -> str:
    return str(kind.__struct_config__.tag)
