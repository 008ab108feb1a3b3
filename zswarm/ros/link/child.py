"""A bridge as a child process: started, written to, read from, ended.

It has its own process group, so that Ctrl-C does not reach it. It ends when its standard input
closes, so also when this process dies; it is killed if that takes long.
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
from zswarm.ros.link.bridges import frames
from zswarm.system.processes import MAX_OUTPUT, ending, last_lines, wrote

FOLDER = Path(__file__).parent / "bridges"
# Environment variables that name the Python for a library.
PYTHONS = {"rospy": "ZSWARM_ROS1_PYTHON", "rclpy": "ZSWARM_ROS2_PYTHON"}
START_S = 30.0  # for a bridge to report that it is ready
ENDING_S = 3.0


class Child:
    """A bridge, started.

    Attributes:
        greeting: the body of its first control frame.
    """

    def __init__(
        self,
        name: str,
        command: list[str],
        environment: Mapping[str, str],
        set_up: Mapping[str, Any],
    ) -> None:
        """Start it and wait until it is ready; errors have its name."""
        self._name = name
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  closed with the child
        try:
            self._process = subprocess.Popen(
                command,
                env={**os.environ, **environment},
                process_group=0,
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
            )
        except OSError as error:
            self._errors.close()
            text = f"{command[0]} cannot be started for {name}: {error.strerror}"
            raise ConfigError(text) from None
        assert self._process.stdin and self._process.stdout  # noqa: S101, PT018  pipes
        self._input, self._output = (
            self._process.stdin.fileno(),
            self._process.stdout.fileno(),
        )
        for pipe in (self._input, self._output):
            os.set_blocking(pipe, False)
        self._reading, self._both = select.poll(), select.poll()
        self._reading.register(self._output, select.POLLIN)
        self._both.register(self._output, select.POLLIN)
        self._both.register(self._input, select.POLLOUT)
        self._partial = bytearray()
        self._received: collections.deque[tuple[int, bytes]] = collections.deque()
        try:
            self.write(frames.frame(frames.CONTROL, json.dumps(set_up).encode()))
            self.greeting = self._await_greeting()
        except BaseException:
            self.close()
            raise

    def write(self, body: bytes | bytearray) -> None:
        """Write frames; frames that arrive meanwhile are queued."""
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
        """Return topic and body of its next frame; None when none arrived in time."""
        deadline = time.monotonic() + timeout_s
        while not self._received:
            if not self._reading.poll(max(0.0, deadline - time.monotonic()) * 1000):
                return None
            self._read()
        return self._received.popleft()

    def put_back(self, received: list[tuple[int, bytes]]) -> None:
        """Have ``next`` return these first."""
        self._received.extendleft(reversed(received))

    def close(self) -> None:
        """End it; a second call does nothing."""
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

    def _await_greeting(self) -> bytes:
        """Return the body of its first control frame; others, which may overtake it, are queued."""
        deadline = time.monotonic() + START_S
        early: list[tuple[int, bytes]] = []
        while (frame := self.next(max(0.0, deadline - time.monotonic()))) is not None:
            if frame[0] == frames.CONTROL:
                self.put_back(early)
                return frame[1]
            early.append(frame)
        raise EvaluationError(
            f"{self._name} was not ready within {START_S:g} s{wrote(self._stderr())}"
        )

    def _read(self) -> None:
        try:
            chunk = os.read(self._output, frames.CHUNK)
        except BlockingIOError:
            return
        if not chunk:
            raise self._ended()
        self._partial += chunk
        self._received.extend(frames.take(self._partial))

    def _ended(self) -> Exception:
        """Return the error after it closed its output."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDING_S)
        code, output = self._process.returncode, self._stderr()
        self.close()
        if code == frames.REFUSED:
            return ConfigError(last_lines(output, 1))
        return EvaluationError(f"{self._name} {ending(code, output)}")

    def _stderr(self) -> bytes:
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, size - 4 * MAX_OUTPUT))
        return self._errors.read()


def command(program: str, library: str) -> list[str]:
    """Return the command of a program in ``bridges/``, with a Python that has a library.

    Without such a Python the program refuses.
    """
    python = sys.executable
    if variable := PYTHONS.get(library):
        python = os.environ.get(variable) or _python_with(library)
    return [python, str(FOLDER / f"{program}.py")]


@functools.cache
def _python_with(library: str) -> str:
    """Return the first of this Python, the one on the path and the system's with a library."""
    candidates = (sys.executable, "python3", "/usr/bin/python3")
    for python in candidates:
        with contextlib.suppress(OSError, subprocess.CalledProcessError):
            subprocess.run(
                [python, "-c", f"import {library}"],
                capture_output=True,
                check=True,
                cwd="/",  # which -c puts on the path; Pythons before 3.11 have no -P
            )
            return python
    return candidates[-1]
