"""Real programs for the tests: servers and optimizers as processes on loopback, with deadlines instead of sleeps."""

import json
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

DEADLINE_S = 60.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until(condition: Callable[[], Any], what: str, deadline_s: float = DEADLINE_S) -> Any:
    """The condition's first true value; it is looked at often."""
    end = time.monotonic() + deadline_s
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(0.01)
    raise AssertionError(f"not within {deadline_s:g} s: {what}")


class Program:
    """A process with its output in files."""

    def __init__(self, folder: Path, name: str, arguments: list[str], **environment: str) -> None:
        self.out, self.err = folder / f"{name}.out", folder / f"{name}.err"
        with self.out.open("wb") as out, self.err.open("wb") as err:
            self.process = subprocess.Popen(
                [sys.executable, *arguments], stdin=subprocess.DEVNULL, stdout=out, stderr=err, cwd=folder,
                env=os.environ | environment,
            )  # fmt: skip

    def kill(self, number: int = signal.SIGKILL) -> None:
        self.process.send_signal(number)

    def wait(self) -> int:
        return self.process.wait(DEADLINE_S)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(DEADLINE_S)


class Server(Program):
    """A ``zswarm-ss``."""

    def __init__(
        self,
        folder: Path,
        name: str,
        *,
        capacity: int = 2,
        port: int = 0,
        options: tuple[str, ...] = (),
        **environment: str,
    ) -> None:
        self.endpoint = f"tcp/127.0.0.1:{port or free_port()}"
        super().__init__(
            folder,
            name,
            [
                "-m",
                "zswarm.ss",
                "--name",
                name,
                "--capacity",
                str(capacity),
                "--no-multicast",
                "--listen",
                self.endpoint,
                *options,
            ],
            **environment,
        )

    def events(self, event: str) -> list[dict[str, Any]]:
        lines = (json.loads(line) for line in self.err.read_text().splitlines() if line.startswith("{") and line.endswith("}"))
        return [line for line in lines if line["event"] == event]

    def ready(self) -> "Server":
        wait_until(lambda: self.events("server_ready") or self.process.poll() is not None, f"{self.err} says server_ready")
        assert self.process.poll() is None, self.err.read_text()
        return self


class Optimizer(Program):
    """A ``zswarm-ot``."""

    def __init__(self, folder: Path, name: str, arguments: list[str], **environment: str) -> None:
        super().__init__(folder, name, ["-m", "zswarm.ot", *arguments], **environment)

    def lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.out.read_text().splitlines() if line.endswith("}")]

    def done(self) -> dict[str, Any]:
        """The last line of a run that went well."""
        assert self.wait() == 0, self.err.read_text()
        last = self.lines()[-1]
        assert last["event"] == "done"
        return last


def query(run: Path, sql: str) -> list[tuple[Any, ...]]:
    """Rows of a run's record; none while it is not there yet."""
    try:
        database = sqlite3.connect(f"file:{run / 'run.sqlite'}?mode=ro", uri=True)
        try:
            return database.execute(sql).fetchall()
        finally:
            database.close()
    except sqlite3.OperationalError:
        return []
