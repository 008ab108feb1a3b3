"""A simulator plug-in whose pace the tests set while it plays, and that notes what it played.

Its environment, none of which changes an outcome:
``PACED_FOLDER``: where a server's slots look and write. In it ``pace`` holds how long a trial
takes, busy or asleep; ``gate`` makes the first trial that sees it wait until it is gone again (it
is renamed to ``held-<pid>``); ``in-<pid>`` is there during a trial; ``played`` gets a line per
trial, its slot's process, seed and action, and ``probe`` one per trial of the probe.
"""

import contextlib
import os
import signal
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, TypeVar

from tests.integration.programs import (
    Optimizer,
    Program,
    Server,
    install,
    query,
    status,
    wait_until,
)
from tests.promise.promise import check_run

T = TypeVar("T")

SOURCE = '''
import os
import time
from pathlib import Path

import msgspec
import numpy as np

from zswarm.sims.simulator import Outcome, Simulator, Turn

FOLDER = Path(os.environ["PACED_FOLDER"]) if "PACED_FOLDER" in os.environ else None
PROBE = 1 << 32  # seeds from here on are the probe's


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """None."""


class Paced(Simulator):
    """Observe two numbers of the seed; act with one number; fitness is its closeness to a third."""

    settings_type = Settings
    inputs, outputs, owners = 2, 1, (0,)

    def fixed_seeds(self, trials):
        return range(trials)

    def reset(self, seed):
        self.seed = seed
        return Turn((0,), np.array([[seed % 7 / 7, seed % 3 / 3]], np.float32))

    def step(self, actions):
        self.action = float(actions[0, 0])
        if FOLDER is not None:
            begun = FOLDER / f"in-{os.getpid()}"
            if self.seed < PROBE:
                begun.touch()
                self.note(f"{os.getpid()} {self.seed} {self.action.hex()}\\n")
                self.pass_gate()
            else:
                self.note(f"{os.getpid()} {self.seed} {self.action.hex()}\\n", "probe")
            self.pace()
            begun.unlink(missing_ok=True)
        return None

    def outcome(self):
        return Outcome([-abs(self.action - self.seed % 5 / 5)], [])

    def note(self, line, where="played"):
        played = os.open(FOLDER / where, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        os.write(played, line.encode())
        os.close(played)

    def pass_gate(self):
        held = FOLDER / f"held-{os.getpid()}"
        try:
            (FOLDER / "gate").rename(held)
            while held.exists():
                time.sleep(0.005)
        except FileNotFoundError:
            pass

    def pace(self):
        try:
            how, seconds = (FOLDER / "pace").read_text().split()
        except (FileNotFoundError, ValueError):
            return
        if how == "asleep":
            time.sleep(float(seconds))
        else:
            end = time.monotonic() + float(seconds)
            while time.monotonic() < end:
                sum(range(100))
'''

EXPERIMENT = """
name = "paced"
seed = 5
generations = {generations}
[problem]
simulator = "paced"
trials = {trials}
[representation]
kind = "fully-meshed"
activation = "sigmoid"
hidden = {hidden}
[optimizer]
kind = "nnga"
population = {population}
[cluster]
trial_timeout_s = {trial_timeout_s}
"""


class Played(NamedTuple):
    """Describe a trial that a slot's process began."""

    process: int
    seed: int
    action: str


class Pace:
    """Control one server from a test through its ``PACED_FOLDER``."""

    def __init__(self, folder: Path, seconds: float = 0.02, how: str = "asleep") -> None:
        self.folder = folder
        folder.mkdir()
        self.set(seconds, how)

    def set(self, seconds: float, how: str = "asleep") -> None:
        """Set the seconds of each trial that begins from now on."""
        part = self.folder / "pace.part"
        part.write_text(f"{how} {seconds}")
        part.replace(self.folder / "pace")

    def arm(self) -> None:
        """Hold the next trial that begins."""
        (self.folder / "gate").touch()

    def held(self) -> int:
        """Return the process of the held trial, once there is one."""
        return wait_until(self._held, f"a trial of {self.folder.name} is held")

    def _held(self) -> int:
        return next(
            (int(path.name.partition("-")[2]) for path in self.folder.glob("held-*")), 0
        )

    def let_go(self) -> None:
        """Release the held trial."""
        for path in self.folder.glob("held-*"):
            path.unlink()

    def in_trial(self, process: int) -> bool:
        """Return whether a slot's process began a trial and did not end it."""
        return (self.folder / f"in-{process}").exists()

    def played(self, where: str = "played") -> list[Played]:
        """Return all trials begun, in order."""
        try:
            lines = (self.folder / where).read_text().splitlines()
        except FileNotFoundError:
            return []
        return [
            Played(int(process), int(seed), action)
            for process, seed, action in map(str.split, lines)
        ]


class Size(NamedTuple):
    """Define the amount of work."""

    generations: int = 3
    population: int = 20
    trials: int = 5
    hidden: int = 1
    compiled: bool = False  # compiling a tiny network takes longer than playing it
    trial_timeout_s: float = 300.0

    def write(self, file: Path) -> str:
        file.write_text(EXPERIMENT.format(**self._asdict()))
        return str(file)

    def environment(self, folder: Path) -> dict[str, str]:
        """Install the plug-in into a new folder."""
        folder.mkdir()
        return {
            "PYTHONPATH": install(
                folder, "zswarm_paced", SOURCE, "paced = zswarm_paced:Paced"
            ),
            "ZSWARM_PLAIN": "" if self.compiled else "1",
        }


class Undisturbed(NamedTuple):
    """Describe the result that a run is compared with."""

    history_hash: str
    trials: int


def play_undisturbed(folder: Path, size: Size) -> Undisturbed:
    """Run the experiment on one local slot as fast as possible."""
    arguments = [
        "run",
        size.write(folder / "paced.toml"),
        "--json",
        "--servers",
        "local",
        "--set",
        "cluster.local_slots=1",
    ]
    done = Optimizer(folder, "ot", arguments, **size.environment(folder / "site")).done()
    return Undisturbed(done["history_hash"], counted(folder / "runs" / "paced"))


def counted(run: Path, server: str = "") -> int:
    """Return the record's trials of servers whose names begin with a prefix."""
    return sum(
        count
        for name, count in query(run, "SELECT server, count FROM outcomes")
        if name.startswith(server)
    )


class Scene:
    """Servers and optimizers of one test, all ended with it. The run is ``runs/paced``.

    Attributes:
        environment: of all programs that start from now on.
        options: more of them for all servers.
    """

    def __init__(self, folder: Path, size: Size) -> None:
        self.folder, self.size = folder, size
        self.run = folder / "runs" / "paced"
        self.environment = size.environment(folder / "site")
        self.options: tuple[str, ...] = ()
        self._programs: list[Program] = []
        self._stopped: set[int] = set()
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in self._stopped:
            if status(process) is not None:
                os.kill(process, signal.SIGKILL)
        for program in self._programs:
            program.close()
        self._stack.close()

    def enter(self, part: contextlib.AbstractContextManager[T]) -> T:
        """Close something with the scene, after its programs."""
        return self._stack.enter_context(part)

    def server(
        self,
        name: str,
        *,
        capacity: int = 1,
        address: str = "127.0.0.1",
        inside: Sequence[str] = (),
    ) -> tuple[Server, Pace]:
        """Start a server with its pace and wait until it is ready."""
        pace = Pace(self.folder / f"{name}-pace")
        return self.start_server(
            name, pace, capacity=capacity, address=address, inside=inside
        ).ready(), pace

    def start_server(
        self,
        name: str,
        pace: Pace,
        *,
        capacity: int = 1,
        port: int = 0,
        address: str = "127.0.0.1",
        inside: Sequence[str] = (),
    ) -> Server:
        """Start a server."""
        server = Server(
            self.folder,
            name,
            capacity=capacity,
            port=port,
            address=address,
            inside=inside,
            options=self.options,
            PACED_FOLDER=str(pace.folder),
            **self.environment,
        )
        self._programs.append(server)
        return server

    def optimizer(
        self,
        *endpoints: str,
        resume: Path | None = None,
        inside: Sequence[str] = (),
        wait: int = 0,
    ) -> Optimizer:
        """Start an optimizer that begins with all servers, or a given number."""
        what = (
            ["resume", str(resume)]
            if resume
            else ["run", self.size.write(self.folder / "paced.toml")]
        )
        connect = [f"--connect={endpoint}" for endpoint in endpoints]
        options = [
            "--json",
            "--no-multicast",
            "--servers",
            str(wait or len(endpoints)),
            *connect,
        ]
        optimizer = Optimizer(
            self.folder,
            f"ot-{len(self._programs)}",
            [*what, *options],
            inside,
            **self.environment,
        )
        self._programs.append(optimizer)
        return optimizer

    def stop(self, process: int) -> None:
        """Send SIGSTOP and wait until the process is stopped."""
        os.kill(process, signal.SIGSTOP)
        self._stopped.add(process)
        wait_until(
            lambda: (found := status(process)) is not None and found.state == "T",
            f"{process} is stopped",
        )

    def go_on(self, process: int) -> None:
        """Send SIGCONT."""
        os.kill(process, signal.SIGCONT)
        self._stopped.remove(process)

    def counted(self, server: str = "") -> int:
        """Return the record's trials of servers whose names begin with a prefix."""
        return counted(self.run, server)

    def wait_for_more(self, server: str = "", more: int = 1) -> None:
        """Wait until that many more trials are counted."""
        enough = self.counted(server) + more
        wait_until(
            lambda: self.counted(server) >= enough,
            f"{more} more trials of {server or 'all'} are counted",
        )

    def events(self, event: str, server: str = "") -> list[str]:
        """Return texts of the record's events of servers whose names begin with a prefix."""
        rows = query(self.run, "SELECT event, server, text FROM events ORDER BY at")
        return [
            text
            for found, name, text in rows
            if found == event and name.startswith(server)
        ]

    def second_starts(self) -> int:
        """Return how many trials were sent to a second server."""
        text = "SELECT coalesce(sum(count), 0) FROM events WHERE event = 'second_start'"
        return int(query(self.run, text)[0][0])

    def check(
        self, done: dict[str, Any], undisturbed: Undisturbed, run: Path | None = None
    ) -> None:
        """Check that the history is the undisturbed one and every trial counts once."""
        assert done["history_hash"] == undisturbed.history_hash
        # This process has no plug-in to evaluate anything again.
        facts = check_run(run or self.run, sample=0)
        assert facts.finished
        assert facts.history_hash == undisturbed.history_hash
        assert len(facts.outcomes) == undisturbed.trials
