"""A slot's supervisor runs programs, and ends all that they start."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from zswarm.errors import EvaluationError
from zswarm.ros.launch import roslaunch
from zswarm.ros.launch.roslaunch import Supervisor

# Like roslaunch: a process in its own session that outlives its parent and ignores signals.
LEAVES = (
    "setsid sh -c 'trap \"\" INT TERM HUP; echo $$ > left; sleep 1000' & "
    "while [ ! -s left ]; do sleep 0.01; done; "
)
ENVIRONMENT = dict(os.environ)


def wait_until(condition: Callable[[], Any], what: str) -> None:
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.01)


def alive(process: int) -> bool:
    """Return whether a process lives; a zombie does not."""
    try:
        return ") Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False


def left(folder: Path) -> int:
    return int((folder / "left").read_text())


@pytest.fixture
def supervisor() -> Iterator[Supervisor]:
    made = Supervisor()
    yield made
    made.close()


def test_a_program_runs_to_its_end_and_its_output_is_returned(
    supervisor: Supervisor, tmp_path: Path
) -> None:
    ended = supervisor.run(
        ["sh", "-c", "echo in $PWD; echo $COLOUR >&2; exit 3"],
        tmp_path,
        {**ENVIRONMENT, "COLOUR": "red"},
    )
    assert (ended.code, ended.output) == (3, f"in {tmp_path}\nred\n")
    assert supervisor.run(["true"], tmp_path, ENVIRONMENT) == (0, "")


def test_the_program_receives_signals_that_a_slot_ignores(
    tmp_path: Path,
) -> None:
    """A slot ignores SIGINT and SIGTERM, and its children would inherit that."""
    before = [
        signal.signal(number, signal.SIG_IGN)
        for number in (signal.SIGINT, signal.SIGTERM)
    ]
    try:
        supervisor = Supervisor()
    finally:
        for number, was in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
            signal.signal(number, was)
    assert (
        supervisor.run(
            ["sh", "-c", "kill -INT $$; sleep 1000"], tmp_path, ENVIRONMENT
        ).code
        == -signal.SIGINT
    )
    assert (
        supervisor.run(
            ["sh", "-c", "kill -TERM $$; sleep 1000"], tmp_path, ENVIRONMENT
        ).code
        == -signal.SIGTERM
    )
    supervisor.close()


@pytest.mark.parametrize("how", ["true", "exit 1", "kill -KILL $$"])
def test_no_process_remains_of_an_ended_program(
    supervisor: Supervisor, how: str, tmp_path: Path
) -> None:
    """Even a process with its own session ends, and the supervisor continues."""
    supervisor.run(["sh", "-c", LEAVES + how], tmp_path, ENVIRONMENT)
    assert not alive(left(tmp_path))
    assert supervisor.run(["true"], tmp_path, ENVIRONMENT).code == 0


def test_a_program_that_takes_longer_than_its_limit_is_ended(
    supervisor: Supervisor, tmp_path: Path
) -> None:
    ended = supervisor.run(
        ["sh", "-c", LEAVES + "sleep 1000"], tmp_path, ENVIRONMENT, limit_s=0.5
    )
    assert ended.code is None
    assert not alive(left(tmp_path))


def test_a_nonexistent_program_is_named(supervisor: Supervisor, tmp_path: Path) -> None:
    with pytest.raises(
        EvaluationError,
        match=r"^\./nowhere cannot be started: No such file or directory$",
    ):
        supervisor.run(["./nowhere"], tmp_path, ENVIRONMENT)


def test_closing_ends_it_and_deletes_its_folder() -> None:
    supervisor = Supervisor()
    assert (supervisor.folder.stat().st_mode & 0o777) == 0o700
    process, folder = supervisor._process, supervisor.folder
    supervisor.close()
    assert process.poll() is not None
    assert not folder.exists()


def test_child_processes_end_with_their_requester(tmp_path: Path) -> None:
    """They end even if SIGKILL ends the requester in the middle of a program."""
    code = (
        "import os, sys; from pathlib import Path\n"
        "from zswarm.ros.launch.roslaunch import Supervisor\n"
        "supervisor = Supervisor(); print(supervisor._process.pid, supervisor.folder, flush=True)\n"
        "supervisor.run(['sh', '-c', sys.argv[1] + 'sleep 1000'], Path(), dict(os.environ))"
    )
    asking = subprocess.Popen(
        [sys.executable, "-c", code, LEAVES],
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    assert asking.stdout
    supervisor, folder = asking.stdout.readline().split()
    wait_until(
        lambda: (tmp_path / "left").exists() and (tmp_path / "left").read_text(),
        "the program runs",
    )
    assert alive(left(tmp_path))
    asking.kill()
    asking.communicate()
    wait_until(
        lambda: (
            not alive(left(tmp_path))
            and not alive(int(supervisor))
            and not Path(folder).exists()
        ),
        "all of it ends",
    )


def test_a_supervisor_that_was_killed_is_a_fault_and_its_folder_is_swept_by_the_next(
    tmp_path: Path,
) -> None:
    """The folder of a living supervisor is kept."""
    killed, living = Supervisor(), Supervisor()
    killed._process.kill()
    with pytest.raises(
        EvaluationError, match=r"^the supervisor of its processes .* was killed$"
    ):
        killed.run(["true"], tmp_path, ENVIRONMENT)
    killed._process.wait()
    assert killed.folder.exists()
    # Its supervisor was killed when it had deleted the lock.
    half = killed.folder.with_name(f"{killed.folder.name}-half")
    half.mkdir()
    third = Supervisor()
    assert not killed.folder.exists()
    assert not half.exists()
    assert living.folder.exists()
    for supervisor in (killed, living, third):
        supervisor.close()


def test_without_roslaunch_the_package_to_install_is_named(
    supervisor: Supervisor, tmp_path: Path
) -> None:
    environment = roslaunch.environment(supervisor.folder, tmp_path) | {
        "PATH": str(tmp_path)
    }
    with pytest.raises(
        EvaluationError,
        match=r"^roslaunch is not installed here, .*: apt install ros-core ",
    ):
        roslaunch.launch(supervisor, tmp_path / "x.launch", {}, environment)
