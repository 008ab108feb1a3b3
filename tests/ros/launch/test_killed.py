"""What roslaunch started ends in seconds after the program, or the slot, that plays was killed."""

import signal
from pathlib import Path

import psutil
import pytest

from tests.integration.programs import Optimizer, Server, wait_until
from tests.repository import REPOSITORY
from tests.ros.ros_here import need

pytestmark = pytest.mark.robots
FILES = REPOSITORY / "examples" / "ros" / "files"
EXPERIMENT = FILES / "run" / "exit.toml"


def launched(process: int) -> list[psutil.Process]:
    """Return a program's descendants once roslaunch and a node are among them."""

    def found() -> list[psutil.Process]:
        below = psutil.Process(process).children(recursive=True)
        lines = " ".join(line for each in below for line in command_line(each))
        return below if "roslaunch" in lines and "__name:=" in lines else []

    return wait_until(found, "roslaunch and a node run")  # type: ignore[no-any-return]


def command_line(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def wait_for_end(processes: list[psutil.Process]) -> None:
    """Wait until all have ended; zombies have."""
    for process in processes:
        wait_until(lambda process=process: ended(process), f"{process} ended", 60.0)


def ended(process: psutil.Process) -> bool:
    try:
        return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def test_they_end_after_the_program_that_evolves_was_killed(tmp_path: Path) -> None:
    """Its slots end with it, and end what their supervisors left."""
    need("rospy")
    arguments = ["run", str(EXPERIMENT), "--servers", "local"]
    optimizer = Optimizer(tmp_path, "ot", arguments, ZSWARM_SIMULATORS=str(FILES))
    try:
        processes = launched(optimizer.process.pid)
    finally:
        optimizer.close()
    wait_for_end(processes)


def test_they_end_after_a_slot_was_killed(tmp_path: Path) -> None:
    """The server goes on, and its new slot launches again."""
    need("rospy")
    variable = {"ZSWARM_SIMULATORS": str(FILES)}
    server = Server(tmp_path, "ss", capacity=1, **variable).ready()
    arguments = ["run", str(EXPERIMENT), "--servers", "1", "--no-multicast"]
    arguments += ["--connect", server.endpoint]
    optimizer = Optimizer(tmp_path, "ot", arguments, **variable)
    try:
        launched(server.process.pid)
        (slot,) = server.workers()
        below = psutil.Process(slot).children(recursive=True)
        assert below
        psutil.Process(slot).kill()
        wait_for_end(below)
        assert not set(below) & set(launched(server.fork_server()))
    finally:
        optimizer.close()
        server.kill(signal.SIGTERM)
        server.wait()
