"""This machine's slots: a private ``zswarm-ss`` child that listens in a private folder."""

import subprocess
import sys
import threading
import time
from collections import deque
from typing import IO

from zswarm.system.processes import MODULE
from zswarm.system.temporary import LockedFolder

NAME = "local"  # of the server; its id is this, "-" and 8 hex digits
AGAIN, AGAIN_S = 3, 60.0  # how often it is started again, if it is killed within so long
LOG_TAIL = 1000  # characters shown if it ended by itself


class LocalServer:
    """A server of this machine as a child process; it ends when this program does."""

    def __init__(self, slots: int, realm: str) -> None:
        self.slots = slots
        self._folder = LockedFolder()
        self.endpoint = f"unixsock-stream/{self._folder.path / 'ss.sock'}"
        self._log = self._folder.path / "log"
        self._realm, self._owner = realm, threading.Lock()  # runs of a study share it
        self._started: deque[float] = deque(maxlen=1 + AGAIN)  # the last times
        self._start()

    def _start(self) -> None:
        server = ["--name", NAME, "--capacity", str(self.slots), "--realm", self._realm]
        private = ["--listen", self.endpoint, "--no-multicast", "--until-stdin-closes"]
        self._started.append(time.monotonic())
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    *MODULE,
                    "zswarm.ss",
                    *server,
                    *private,
                    "--log-level",
                    "warning",
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=log,
                # Ctrl-C is for this program, which decides what ends: a notebook continues.
                process_group=0,
            )

    def start_again(self) -> str:
        """Start the child again if a signal killed it; return what happened, or "".

        It stays ended if it was started again several times in a minute: something kills it.
        """
        with self._owner:
            code = self._process.poll()
            if code is None or not self._starts_again(code):
                return ""
            self._stdin().close()
            self._start()
            return (
                f"the slots of this machine were killed by signal {-code}: started again"
            )

    def _starts_again(self, code: int) -> bool:
        """Return whether the child is started again after it ended with an exit code."""
        often = len(self._started) > AGAIN
        often = often and time.monotonic() - self._started[0] < AGAIN_S
        return code < 0 and not often and not self._stdin().closed

    def close(self) -> None:
        """End the child."""
        with self._owner:
            self._stdin().close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.remove()

    def _stdin(self) -> IO[bytes]:
        assert self._process.stdin is not None  # noqa: S101  it is asked for
        return self._process.stdin

    def ended(self) -> str:
        """Return its last words if it ended for good, which it should not; else ""."""
        with self._owner:
            code = self._process.poll()
            if code is None or self._starts_again(code):
                return ""
        return f"exit code {code}: {self._log.read_text(errors='replace')[-LOG_TAIL:].strip()}"
