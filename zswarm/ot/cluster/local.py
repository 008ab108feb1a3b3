"""This machine's slots: a private ``zswarm-ss`` child that listens in a private folder."""

import contextlib
import fcntl
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from zswarm.system.processes import MODULE

NAME = "local"  # of the server; its id is this, "-" and 8 hex digits
PREFIX = "zswarm-local-"  # of its folder
YOUNG_S = 60.0  # a folder's program may not have locked it yet
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
        server = ["--name", NAME, "--capacity", str(slots), "--realm", realm]
        private = ["--listen", self.endpoint, "--no-multicast", "--until-stdin-closes"]
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

    def close(self) -> None:
        """End the child."""
        assert self._process.stdin is not None  # noqa: S101  it was asked for above
        self._process.stdin.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()
        os.close(self._lock)

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
