"""The slots of this machine: a private ``zswarm-ss`` child on a socket in a private folder, evaluated through like any other."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType
from typing import IO, Self

LOG_TAIL = 1000  # characters shown when it ended by itself


class LocalServer:
    """A server of this machine for one run; it ends with this program, however that ends."""

    def __init__(self, slots: int, realm: str) -> None:
        self.slots = slots
        self._folder = tempfile.TemporaryDirectory(prefix="zswarm-")  # mode 0700: nobody else reaches the socket
        self.endpoint = f"unixsock-stream/{Path(self._folder.name) / 'ss.sock'}"
        self._log = Path(self._folder.name) / "log"
        with self._log.open("wb") as log:
            self._process = self._start(slots, realm, log)

    def _start(self, slots: int, realm: str, log: IO[bytes]) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            [
                sys.executable, "-m", "zswarm.ss", "--name", "local", "--capacity", str(slots), "--realm", realm,
                "--listen", self.endpoint, "--no-multicast", "--until-stdin-closes", "--log-level", "warning",
            ],
            env={key: value for key, value in os.environ.items() if key != "ZSWARM_PLAIN"},  # it does evaluate
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=log,
            process_group=0,  # Ctrl-C is for this program, which decides what ends: a notebook goes on afterwards
        )  # fmt: skip

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        assert self._process.stdin is not None  # noqa: S101  it was asked for above
        self._process.stdin.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def ended(self) -> str:
        """Its last words when it ended by itself, which it should not; "" while it runs."""
        code = self._process.poll()
        return "" if code is None else f"exit code {code}: {self._log.read_text(errors='replace')[-LOG_TAIL:].strip()}"
