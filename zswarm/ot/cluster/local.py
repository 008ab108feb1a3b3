"""This machine's slots: a private ``zswarm-ss`` child that listens in a private folder."""

import contextlib
import fcntl
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from pathlib import Path
from typing import IO

from zswarm.system.processes import MODULE

NAME = "local"  # of the server; its id is this, "-" and 8 hex digits
PREFIX = "zswarm-local-"  # of its folder
YOUNG_S = 60.0  # a folder's program may not have locked it yet
AGAIN, AGAIN_S = 3, 60.0  # how often it is started again, if it is killed within so long
LOG_TAIL = 1000  # characters shown if it ended by itself


class LocalServer:
    """A server of this machine as a child process; it ends when this program does."""

    def __init__(self, slots: int, realm: str) -> None:
        self.slots = slots
        remove_orphans(Path(tempfile.gettempdir()))
        self._folder = tempfile.TemporaryDirectory(prefix=PREFIX)  # mode 0700
        self._lock = os.open(self._folder.name, os.O_RDONLY)
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        self.endpoint = f"unixsock-stream/{Path(self._folder.name) / 'ss.sock'}"
        self._log = Path(self._folder.name) / "log"
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
            often = len(self._started) > AGAIN
            often = often and time.monotonic() - self._started[0] < AGAIN_S
            if code is None or code >= 0 or often or self._stdin().closed:
                return ""
            self._stdin().close()
            self._start()
            return (
                f"the slots of this machine were killed by signal {-code}: started again"
            )

    def close(self) -> None:
        """End the child."""
        with self._owner:
            self._stdin().close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()
        os.close(self._lock)

    def _stdin(self) -> IO[bytes]:
        assert self._process.stdin is not None  # noqa: S101  it is asked for
        return self._process.stdin

    def ended(self) -> str:
        """Return its last words if it ended by itself, which it should not; "" while it runs."""
        code = self._process.poll()
        if code is None:
            return ""
        return f"exit code {code}: {self._log.read_text(errors='replace')[-LOG_TAIL:].strip()}"


def remove_orphans(parent: Path) -> None:
    """Remove the private folders that killed programs of this user have left.

    A program holds a lock on its folder while it lives.
    """
    for folder in parent.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            found = folder.lstat()
            young = time.time() - found.st_mtime < YOUNG_S
            if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode) or young:
                continue
            lock = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
            finally:
                os.close(lock)


def is_local(server: str) -> bool:
    """Return whether a server is this machine's own."""
    return server.startswith(f"{NAME}-")
