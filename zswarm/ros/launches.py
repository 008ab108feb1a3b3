"""roslaunch and other programs for one slot: each in a private folder, with a master of its own, and nothing is left of them.

A keeper (``keeper.py``) runs them; it goes with the slot, and with it all that they started.
"""

import contextlib
import json
import os
import re
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from zswarm.errors import EvaluationError
from zswarm.protocol.codec import clean

KEEPER = Path(__file__).with_name("keeper.py")
ENDING_S = 10.0  # a keeper is waited for when it is closed
LAST_WORDS = 300  # characters of what a program said, in an error
READ = 4 << 20  # bytes of it, from the end
DIED = re.compile(
    r"(?:=+REQUIRED process )?\[(?P<node>[^\]\n]*)\] (?:has died!\n)?process has died \[pid \d+, exit code (?P<code>-?\d+)"
)
STARTED = "]: started with pid ["  # what roslaunch says of a process
# What it says when it has done: a required node ended, and how others end then says nothing; or all ended.
OVER = re.compile(r"Initiating shutdown!|all processes on machine have died, roslaunch will exit")
COLOURS = re.compile(r"\x1b\[[0-9;]*m|\x1b\]2;[^\x07]*\x07")  # and titles of a terminal
INSTALL = (
    "roslaunch is not installed here, or not on the PATH: apt install ros-core python3-geometry-msgs (Debian 12), or start the "
    "server from a shell that has read your ROS's setup.bash"
)


class Ended(NamedTuple):
    """How a program ended."""

    code: int | None  # below 0 the signal that killed it; None: its time was over
    seconds: float
    said: str  # the last of its output


class Keeper:
    """Runs programs, one at a time.

    Attributes:
        folder: a private one; it is deleted when this is closed, or the process of it ends in whatever way.
    """

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", str(KEEPER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        self.close = weakref.finalize(self, _close, self._process)
        self.folder = Path(self._answer()["folder"])

    def run(self, command: Sequence[str], cwd: Path, environment: Mapping[str, str], limit_s: float = 0.0) -> Ended:
        """Run a program to its end.

        Args:
            limit_s: it is ended after so long; 0: never.

        Raises:
            EvaluationError: it cannot be started, or the keeper was killed.
        """
        output = self.folder / "output"
        asked = {
            "command": list(command), "cwd": str(cwd), "environment": dict(environment), "output": str(output), "limit_s": limit_s
        }  # fmt: skip
        assert self._process.stdin  # noqa: S101  a pipe, as asked for
        with contextlib.suppress(BrokenPipeError):  # the answer tells
            self._process.stdin.write(json.dumps(asked).encode() + b"\n")
            self._process.stdin.flush()
        answer = self._answer()
        if "failed" in answer:
            raise EvaluationError(f"{command[0]} cannot be started: {answer['failed']}")
        with output.open("rb") as file:
            file.seek(max(0, output.stat().st_size - READ))
            said = COLOURS.sub("", file.read().decode(errors="replace"))
        return Ended(answer["code"], answer["seconds"], said)

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout  # noqa: S101  a pipe, as asked for
        line = self._process.stdout.readline()
        if not line:
            raise EvaluationError("the program that keeps its processes (zswarm/ros/keeper.py) was killed")
        answer: dict[str, Any] = json.loads(line)
        return answer


def _close(process: "subprocess.Popen[bytes]") -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(ENDING_S)


def environment(folder: Path, packages: Path) -> dict[str, str]:
    """That of ROS programs whose home and logs are in a folder, and to whom the packages in another one go before all others."""
    told = {name: value for name, value in os.environ.items() if name not in ("ROS_HOSTNAME", "ROS_MASTER_URI", "ROS_NAMESPACE")}
    paths = [str(packages), *filter(None, [os.environ.get("ROS_PACKAGE_PATH", "")])]
    home, logs = folder / "home", folder / "ros-log"
    return {
        **told, "ROS_PACKAGE_PATH": os.pathsep.join(paths), "ROS_IP": "127.0.0.1", "ROS_HOME": str(home), "ROS_LOG_DIR": str(logs)
    }  # fmt: skip


def launch(keeper: Keeper, file: Path, arguments: Mapping[str, str], environment: Mapping[str, str]) -> Ended:
    """Have roslaunch run a launch file to its end, with a master of its own.

    Raises:
        EvaluationError: it is not there, it failed, or a node of it did.
    """
    roslaunch = shutil.which("roslaunch", path=environment.get("PATH"))
    if roslaunch is None:
        raise EvaluationError(INSTALL)
    for folder in (environment["ROS_HOME"], environment["ROS_LOG_DIR"]):
        shutil.rmtree(folder, ignore_errors=True)
        Path(folder).mkdir()
    # A free port may be taken before the master has it: with this mark roslaunch refuses the master of another trial.
    mark = secrets.token_hex(8)
    port = _free_port()
    command = [roslaunch, "-p", str(port), f"--run_id={mark}", "--skip-log-check", str(file)]
    told = {**environment, "ROS_MASTER_URI": f"http://127.0.0.1:{port}"}
    ended = keeper.run([*command, *(f"{name}:={value}" for name, value in arguments.items())], file.parent, told)
    if ended.code:
        raise EvaluationError(f"roslaunch {how_it_ended(ended.code)}{last_words(ended.said)}")
    over = OVER.search(ended.said)
    if died := DIED.search(ended.said[: over.start() if over else None]):
        its_own = ended.said[: died.start()].rpartition(STARTED)[2].partition("\n")[2]
        raise EvaluationError(f"node {clean(died['node'])} {how_it_ended(int(died['code']))}{last_words(its_own)}")
    if over is None:
        raise EvaluationError(f"roslaunch was told to end before its nodes had ended{last_words(ended.said)}")
    return ended


def how_it_ended(code: int | None) -> str:
    """A program, in words."""
    if code is None:
        return "took longer than its limit and was ended"
    if code >= 0:
        return f"ended with code {code}"
    names = {number.value: f" ({number.name})" for number in signal.Signals}
    return f"was killed by signal {-code}{names.get(-code, '')}"


def last_words(said: str) -> str:
    """The last lines of a program, for an error."""
    lines = [line.strip() for line in said.splitlines() if re.search(r"\w", line)]
    text = clean(" / ".join(lines[-3:]))[-LAST_WORDS:]
    return f"; it wrote: {text}" if text else ""


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
