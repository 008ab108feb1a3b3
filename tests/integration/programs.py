"""Servers and optimizers as real processes on loopback, with deadlines instead of sleeps."""

import contextlib
import functools
import itertools
import json
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

DEADLINE_S = 600.0  # for what ends at once, on a machine that computes much else
PORTS = 500  # of a process of tests
NO_PICTURES = "import sys\nsys.modules['matplotlib'] = None\n"


@functools.cache
def _ports() -> tuple[Iterator[int], socket.socket]:
    """Return ports, again and again, that no other process of tests uses while this one lives.

    The kernel gives none of them to an outgoing connection. The socket, which is kept, claims them
    by its name.
    """
    claim = socket.socket(socket.AF_UNIX)
    for first in range(10_000, 30_000, PORTS):
        with contextlib.suppress(OSError):
            claim.bind(f"\0zswarm-ports-{first}")
            return itertools.cycle(range(first, first + PORTS)), claim
    raise AssertionError("other processes of tests claim all ports")


def free_port() -> int:
    """Return a port that nobody listens on."""
    ports, _ = _ports()
    for port in itertools.islice(ports, PORTS):
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
    raise AssertionError("no port is free")


def wait_until(
    condition: Callable[[], Any],
    what: str,
    deadline_s: float = DEADLINE_S,
    every_s: float = 0.02,
) -> Any:
    """Return the condition's first true value, polled often."""
    end = time.monotonic() + deadline_s
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(every_s)
    raise AssertionError(f"not within {deadline_s:g} s: {what}")


def without_pictures(folder: Path) -> str:
    """Return what PYTHONPATH must begin with for programs that find no matplotlib."""
    hidden = folder / "no-pictures"
    hidden.mkdir(exist_ok=True)
    (hidden / "sitecustomize.py").write_text(NO_PICTURES)
    return str(hidden)


class Program:
    """A process with its output in files; ``inside`` (a ``lab.Host``'s) precedes its command."""

    python = sys.executable

    def __init__(
        self,
        folder: Path,
        name: str,
        arguments: list[str],
        inside: Sequence[str] = (),
        **environment: str,
    ) -> None:
        self.out, self.err = folder / f"{name}.out", folder / f"{name}.err"
        with self.out.open("wb") as out, self.err.open("wb") as err:
            self.process = subprocess.Popen(
                [*inside, self.python, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd=folder,
                env=os.environ | {"RUNTIME_DIRECTORY": str(folder)} | environment,
            )

    def kill(self, number: int = signal.SIGKILL) -> None:
        self.process.send_signal(number)

    def events(self, event: str) -> list[dict[str, Any]]:
        lines = (
            json.loads(line)
            for line in self.err.read_text().splitlines()
            if event in line and line.startswith("{") and line.endswith("}")
        )
        return [line for line in lines if line["event"] == event]

    def wait(self) -> int:
        return self.process.wait(DEADLINE_S)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(DEADLINE_S)


class Server(Program):
    """Run a ``zswarm-ss``."""

    def __init__(
        self,
        folder: Path,
        name: str,
        *,
        capacity: int = 2,
        port: int = 0,
        options: tuple[str, ...] = (),
        address: str = "127.0.0.1",
        protocol: str = "tcp",
        inside: Sequence[str] = (),
        **environment: str,
    ) -> None:
        self.endpoint = f"{protocol}/{address}:{port or free_port()}"
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
            inside,
            **environment,
        )

    def ready(self) -> "Server":
        wait_until(
            lambda: self.events("server_ready") or self.process.poll() is not None,
            f"{self.err} says server_ready",
        )
        assert self.process.poll() is None, self.err.read_text()
        return self

    def fork_server(self) -> int:
        """Return the process its slots are forked from; 0 before there is one."""
        return next(
            (
                child
                for child in children(self.process.pid)
                if "forkserver" in command_line(child)
            ),
            0,
        )

    def workers(self) -> list[int]:
        """Return the processes of its slots."""
        return children(self.fork_server())


class Optimizer(Program):
    """A ``zswarm-ot``, which finds no matplotlib unless its run's picture is wanted.

    To load it takes longer than everything else that the program does in most tests.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        arguments: list[str],
        inside: Sequence[str] = (),
        *,
        picture: bool = False,
        **environment: str,
    ) -> None:
        if not picture:
            path = environment.get("PYTHONPATH", os.environ.get("PYTHONPATH", ""))
            without = [without_pictures(folder), path]
            environment["PYTHONPATH"] = os.pathsep.join(filter(None, without))
        super().__init__(
            folder, name, ["-m", "zswarm.ot", *arguments], inside, **environment
        )

    def lines(self) -> list[dict[str, Any]]:
        return [
            json.loads(line)
            for line in self.out.read_text().splitlines()
            if line.endswith("}")
        ]

    def done(self) -> dict[str, Any]:
        """Return the last line of a successful run."""
        assert self.wait() == 0, self.err.read_text()
        last = self.lines()[-1]
        assert last["event"] == "done"
        return last


def query(run: Path, sql: str) -> list[tuple[Any, ...]]:
    """Return rows of a run's record; empty before it exists."""
    try:
        database = sqlite3.connect(f"file:{run / 'run.sqlite'}?mode=ro", uri=True)
        try:
            return database.execute(sql).fetchall()
        finally:
            database.close()
    except sqlite3.OperationalError:
        return []


class Status(NamedTuple):
    """Describe the state of a process according to the kernel."""

    state: str  # R runs, S sleeps, T is stopped, Z has ended
    parent: int
    ticks: int  # of processor time


def status(process: int) -> Status | None:
    """Return a process's state, or None when it is gone."""
    try:
        text = Path(f"/proc/{process}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return None
    fields = text.rpartition(") ")[2].split()
    return Status(fields[0], int(fields[1]), int(fields[11]) + int(fields[12]))


def command_line(process: int) -> str:
    """Return a process's command line, or "" when it is gone."""
    try:
        return Path(f"/proc/{process}/cmdline").read_text(errors="replace")
    except (FileNotFoundError, ProcessLookupError):
        return ""


def children(process: int) -> list[int]:
    """Return a process's children that have not ended."""
    found: list[int] = []
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        for thread in Path(f"/proc/{process}/task").iterdir():
            # A thread may end between the two looks, and its process does not.
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                found += map(int, (thread / "children").read_text().split())
    states = [(child, status(child)) for child in found]
    return [child for child, state in states if state and state.state != "Z"]


def install(folder: Path, module: str, source: str, simulators: str) -> str:
    """Put a plug-in into a folder as pip would.

    Args:
        module: its name, such as ``zswarm_rough``.
        simulators: its entry points, a line each.

    Returns:
        What PYTHONPATH must be to have it.
    """
    (folder / f"{module}.py").write_text(source)
    metadata = folder / f"{module}-1.0.dist-info"
    metadata.mkdir()
    name = module.replace("_", "-")
    (metadata / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n"
    )
    (metadata / "entry_points.txt").write_text(f"[zswarm.simulators]\n{simulators}\n")
    return os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
