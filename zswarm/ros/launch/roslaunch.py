"""roslaunch and other programs for one slot, each in a private folder, with a private master.

A supervisor (``supervisor.py``) runs them; it ends with the slot, and ends all that they started.
"""

import contextlib
import json
import os
import re
import secrets
import select
import shutil
import subprocess
import sys
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from zswarm.errors import EvaluationError
from zswarm.ros.link.graph import LOOPBACK, free_port
from zswarm.system.processes import ending, wrote
from zswarm.system.text import clean

SUPERVISOR = Path(__file__).with_name("supervisor.py")
ENDING_S = 10.0  # for a supervisor to end
READ = 4 << 20  # bytes of output, from the end
DIED = re.compile(
    r"(?:=+REQUIRED process )?\[(?P<node>[^\]\n]*)\] (?:has died!\n)?"
    r"process has died (?:without exit code )?\[pid [^,\n]*, (?:exit code (?P<code>-?\d+))?"
)
STARTED = "]: started with pid ["  # in roslaunch's line about a process
# A node that ends before roslaunch looks at it; its pid is -1 or None then.
NOT_STARTED = re.compile(r"failed to start local process: .*\n")
# roslaunch ends: a required node ended, and later ends of nodes mean nothing; or all ended.
OVER = re.compile(
    r"Initiating shutdown!|all processes on machine have died, roslaunch will exit"
)
COLOURS = re.compile(r"\x1b\[[0-9;]*m|\x1b\]2;[^\x07]*\x07")  # and titles of a terminal
INSTALL = (
    "roslaunch is not installed here, or not on the PATH: apt install ros-core "
    "python3-geometry-msgs (Debian 12), or start the server from a shell that has read your ROS's "
    "setup.bash"
)


class LaunchEnded(NamedTuple):
    """How a program ended."""

    code: int | None  # below 0 the signal that killed it; None: it exceeded its limit
    output: str  # the end of it


class Supervisor:
    """Runs programs, one at a time.

    Attributes:
        folder: private; deleted when this is closed, or its process ends in any way.
    """

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", str(SUPERVISOR)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self.close = weakref.finalize(self, _close, self._process)
        self.folder = Path(self._answer()["folder"])

    def run(
        self,
        command: Sequence[str],
        cwd: Path,
        environment: Mapping[str, str],
        limit_s: float = 0.0,
    ) -> LaunchEnded:
        """Run a program to its end, or for at most ``limit_s`` if that is not 0."""
        self.start(command, cwd, environment, limit_s)
        return self._end()

    def start(
        self,
        command: Sequence[str],
        cwd: Path,
        environment: Mapping[str, str],
        limit_s: float = 0.0,
    ) -> None:
        """Have a program run; see ``ended``."""
        self._program, self._output = command[0], self.folder / "output"
        request = {
            "command": list(command),
            "cwd": str(cwd),
            "environment": dict(environment),
            "output": str(self._output),
            "limit_s": limit_s,
        }
        assert self._process.stdin  # noqa: S101  a pipe
        with contextlib.suppress(BrokenPipeError):  # there is no answer then
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()

    def ended(self) -> LaunchEnded | None:
        """Return how the program that was started ended; None: it runs."""
        assert self._process.stdout  # noqa: S101  a pipe
        answers = select.poll()
        answers.register(self._process.stdout, select.POLLIN)
        return self._end() if answers.poll(0) else None

    def _end(self) -> LaunchEnded:
        """Wait until the program ended."""
        answer = self._answer()
        if "failed" in answer:
            raise EvaluationError(
                f"{self._program} cannot be started: {answer['failed']}"
            )
        with self._output.open("rb") as file:
            file.seek(max(0, self._output.stat().st_size - READ))
            text = COLOURS.sub("", file.read().decode(errors="replace"))
        return LaunchEnded(answer["code"], text)

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout  # noqa: S101  a pipe
        line = self._process.stdout.readline()
        if not line:
            raise EvaluationError(
                f"the supervisor of its processes ({SUPERVISOR.name}) was killed"
            )
        answer: dict[str, Any] = json.loads(line)
        return answer


def _close(process: "subprocess.Popen[bytes]") -> None:
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.communicate(timeout=ENDING_S)  # closes its input, which ends it


def environment(folder: Path, packages: Path) -> dict[str, str]:
    """Return that of ROS programs with home and logs in a folder, that find packages in another."""
    others = {"ROS_HOSTNAME", "ROS_MASTER_URI", "ROS_NAMESPACE"}
    inherited = {name: text for name, text in os.environ.items() if name not in others}
    paths = [str(packages), *filter(None, [os.environ.get("ROS_PACKAGE_PATH", "")])]
    return inherited | {
        "ROS_PACKAGE_PATH": os.pathsep.join(paths),
        "ROS_IP": LOOPBACK,
        "ROS_HOME": str(folder / "home"),
        "ROS_LOG_DIR": str(folder / "ros-log"),
    }


def launch(
    supervisor: Supervisor,
    file: Path,
    arguments: Mapping[str, str],
    environment: Mapping[str, str],
) -> None:
    """Have roslaunch run a launch file to its end, with a private master."""
    roslaunch = shutil.which("roslaunch", path=environment.get("PATH"))
    if roslaunch is None:
        raise EvaluationError(INSTALL)
    for folder in (environment["ROS_HOME"], environment["ROS_LOG_DIR"]):
        shutil.rmtree(folder, ignore_errors=True)
        Path(folder).mkdir()
    # Another master may take a free port first: with a run_id roslaunch refuses that master.
    port, mark = free_port(), secrets.token_hex(8)
    command = [
        roslaunch,
        "-p",
        str(port),
        f"--run_id={mark}",
        "--skip-log-check",
        str(file),
    ]
    command += [f"{name}:={value}" for name, value in arguments.items()]
    with_master = {**environment, "ROS_MASTER_URI": f"http://{LOOPBACK}:{port}"}
    ended = supervisor.run(command, file.parent, with_master)
    if ended.code:
        raise EvaluationError(f"roslaunch {ending(*ended)}")
    if why := fault(ended.output):
        raise EvaluationError(why)


def fault(output: str) -> str:
    """Return how a node, or roslaunch, ended as it should not have, from its output; else ""."""
    over = OVER.search(output)
    if died := DIED.search(output[: over.start() if over else None]):
        before = NOT_STARTED.sub("", output[: died.start()])
        own = before.rpartition(STARTED)[2].partition("\n")[2]
        if died["code"] is None:
            return f"node {clean(died['node'])} ended without an exit code{wrote(own)}"
        return f"node {clean(died['node'])} {ending(int(died['code']), own)}"
    if over is None:
        return f"roslaunch was told to end before its nodes had ended{wrote(output)}"
    return ""
