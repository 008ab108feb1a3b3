"""A bridge as a child process: started, written to, read from, ended.

It has a process group of its own, so that Ctrl-C does not reach it. It ends when its standard input closes, so also when this
process dies; and is killed if it takes long.
"""

import collections
import contextlib
import functools
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zswarm.errors import ConfigError, EvaluationError
from zswarm.protocol.codec import clean
from zswarm.ros.bridges import frames

FOLDER = Path(__file__).parent / "bridges"
PYTHONS = {"rospy": "ZSWARM_ROS1_PYTHON", "rclpy": "ZSWARM_ROS2_PYTHON"}  # environment variables that name them
START_S = 30.0  # a bridge takes at most to say that it is there
ENDING_S = 3.0  # and to end
LAST_WORDS = 300  # characters of its standard error in an error


class Child:
    """A bridge, started.

    Attributes:
        said: what it said first.
    """

    def __init__(self, name: str, command: list[str], environment: Mapping[str, str], set_up: Mapping[str, Any]) -> None:
        """Start it and wait until it says that it is there.

        Args:
            name: what it is, for errors.

        Raises:
            ConfigError: it refused, with its reason; or cannot be started.
            EvaluationError: it ended otherwise, or said nothing.
        """
        self._name = name
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  closed with the child
        try:
            self._process = subprocess.Popen(
                command, env={**os.environ, **environment}, process_group=0, bufsize=0,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors,
            )  # fmt: skip
        except OSError as error:
            self._errors.close()
            raise ConfigError(f"{command[0]} cannot be started for {name}: {error.strerror}") from None
        assert self._process.stdin and self._process.stdout  # noqa: S101, PT018  pipes, as asked for
        self._input, self._output = self._process.stdin.fileno(), self._process.stdout.fileno()
        for pipe in (self._input, self._output):
            os.set_blocking(pipe, False)
        self._reading, self._both = select.poll(), select.poll()
        self._reading.register(self._output, select.POLLIN)
        self._both.register(self._output, select.POLLIN)
        self._both.register(self._input, select.POLLOUT)
        self._rest = bytearray()
        self._came: collections.deque[tuple[int, bytes]] = collections.deque()
        try:
            self.write(frames.frame(frames.CONTROL, json.dumps(set_up).encode()))
            first = self.next(START_S)
            if first is None:
                raise EvaluationError(f"{name} said nothing for {START_S:g} s{self._last_words()}")
        except BaseException:
            self.close()
            raise
        self.said = first[1]

    def write(self, body: bytes | bytearray) -> None:
        """Write frames; what it says meanwhile is kept.

        Raises:
            EvaluationError: it ended.
        """
        rest = memoryview(body)
        while rest:
            try:
                rest = rest[os.write(self._input, rest) :]
            except BlockingIOError:
                if any(pipe == self._output for pipe, _ in self._both.poll()):
                    self._read()
            except BrokenPipeError:
                raise self._ended() from None

    def next(self, timeout_s: float) -> tuple[int, bytes] | None:
        """Topic and body of its next frame; None when none came in time.

        Raises:
            EvaluationError: it ended.
        """
        if self._came:
            return self._came.popleft()
        deadline = time.monotonic() + timeout_s
        while not self._came:
            if not self._reading.poll(max(0.0, deadline - time.monotonic()) * 1000):
                return None
            self._read()
        return self._came.popleft()

    def put_back(self, came: list[tuple[int, bytes]]) -> None:
        """Have ``next`` give these first."""
        self._came.extendleft(reversed(came))

    def close(self) -> None:
        """End it; a second time does nothing."""
        if self._errors.closed:
            return
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe  # noqa: S101
            pipe.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDING_S)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._errors.close()

    def _read(self) -> None:
        try:
            chunk = os.read(self._output, frames.CHUNK)
        except BlockingIOError:
            return
        if not chunk:
            raise self._ended()
        self._rest += chunk
        self._came.extend(frames.taken(self._rest))

    def _ended(self) -> Exception:
        """What to raise: it closed its output."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDING_S)
        code, words = self._process.returncode, self._last_words()
        self.close()
        if code == frames.REFUSED:
            return ConfigError(words.removeprefix("; it wrote: "))
        how = "closed its output" if code is None else f"ended with code {code}" if code >= 0 else f"was killed by signal {-code}"
        return EvaluationError(f"{self._name} {how}{words}")

    def _last_words(self) -> str:
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, size - 4 * LAST_WORDS))
        lines = [line.strip() for line in self._errors.read().decode(errors="replace").splitlines() if line.strip()]
        text = clean(lines[-1])[-LAST_WORDS:] if lines else ""
        return f"; it wrote: {text}" if text else ""


def command(program: str, library: str) -> list[str]:
    """How to run a program of ``bridges/``: with the Python that has a library; if none has, the program refuses."""
    python = sys.executable
    if variable := PYTHONS.get(library):
        python = os.environ.get(variable) or _python_with(library)
    return [python, str(FOLDER / f"{program}.py")]


@functools.cache
def _python_with(library: str) -> str:
    """The first of this Python, the one on the path and the system's that has a library, and can load it."""
    candidates = (sys.executable, "python3", "/usr/bin/python3")
    for python in candidates:
        with contextlib.suppress(OSError):
            if subprocess.run([python, "-c", f"import {library}"], capture_output=True, check=False).returncode == 0:
                return python
    return candidates[-1]
