"""A slot's keeper: it runs programs, and nothing of them is left, whatever they start and whoever is killed."""

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
from zswarm.ros import launches
from zswarm.ros.launches import Keeper

# As roslaunch does: something in a session of its own that outlives its parent and minds no signal but the last.
LEAVES = "setsid sh -c 'trap \"\" INT TERM HUP; echo $$ > left; sleep 1000' & while [ ! -s left ]; do sleep 0.01; done; "
ENVIRONMENT = dict(os.environ)


def wait_until(condition: Callable[[], Any], what: str) -> None:
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.01)


def alive(process: int) -> bool:
    """Not a zombie, either."""
    try:
        return ") Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False


def left(folder: Path) -> int:
    return int((folder / "left").read_text())


@pytest.fixture
def keeper() -> Iterator[Keeper]:
    made = Keeper()
    yield made
    made.close()


def test_a_program_runs_to_its_end_and_what_it_says_is_kept(keeper: Keeper, tmp_path: Path) -> None:
    ended = keeper.run(["sh", "-c", "echo in $PWD; echo $COLOUR >&2; exit 3"], tmp_path, {**ENVIRONMENT, "COLOUR": "red"})
    assert (ended.code, ended.said) == (3, f"in {tmp_path}\nred\n")
    assert keeper.run(["true"], tmp_path, ENVIRONMENT)[::2] == (0, "")


def test_signals_are_heard_by_what_it_runs_though_a_slot_hears_none(tmp_path: Path) -> None:
    """A slot ignores SIGINT and SIGTERM, and whoever ignores a signal passes that on; roslaunch ends nodes by them."""
    before = [signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        keeper = Keeper()
    finally:
        for number, was in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
            signal.signal(number, was)
    assert keeper.run(["sh", "-c", "kill -INT $$; sleep 1000"], tmp_path, ENVIRONMENT).code == -signal.SIGINT
    assert keeper.run(["sh", "-c", "kill -TERM $$; sleep 1000"], tmp_path, ENVIRONMENT).code == -signal.SIGTERM
    keeper.close()


@pytest.mark.parametrize("how", ["true", "exit 1", "kill -KILL $$"])
def test_nothing_is_left_of_a_program_that_ended(keeper: Keeper, how: str, tmp_path: Path) -> None:
    """Not even what has a session of its own, and the keeper goes on."""
    keeper.run(["sh", "-c", LEAVES + how], tmp_path, ENVIRONMENT)
    assert not alive(left(tmp_path))
    assert keeper.run(["true"], tmp_path, ENVIRONMENT).code == 0


def test_a_program_that_takes_longer_than_its_limit_is_ended(keeper: Keeper, tmp_path: Path) -> None:
    ended = keeper.run(["sh", "-c", LEAVES + "sleep 1000"], tmp_path, ENVIRONMENT, limit_s=0.5)
    assert ended.code is None
    assert not alive(left(tmp_path))


def test_a_program_that_is_not_there_is_named(keeper: Keeper, tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"^\./nowhere cannot be started: No such file or directory$"):
        keeper.run(["./nowhere"], tmp_path, ENVIRONMENT)


def test_closing_ends_it_and_deletes_its_folder() -> None:
    keeper = Keeper()
    assert (keeper.folder.stat().st_mode & 0o777) == 0o700
    process, folder = keeper._process, keeper.folder
    keeper.close()
    assert process.poll() is not None
    assert not folder.exists()


def test_whatever_runs_goes_with_whoever_asked_for_it(tmp_path: Path) -> None:
    """Also by SIGKILL, in the middle of a program."""
    code = (
        "import sys; from pathlib import Path; from zswarm.ros.launches import Keeper; import os\n"
        "keeper = Keeper(); print(keeper._process.pid, keeper.folder, flush=True)\n"
        "keeper.run(['sh', '-c', sys.argv[1] + 'sleep 1000'], Path(), dict(os.environ))"
    )
    asking = subprocess.Popen([sys.executable, "-c", code, LEAVES], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert asking.stdout
    keeper, folder = asking.stdout.readline().split()
    wait_until(lambda: (tmp_path / "left").exists() and (tmp_path / "left").read_text(), "the program runs")
    assert alive(left(tmp_path))
    asking.kill()
    asking.communicate()
    wait_until(lambda: not alive(left(tmp_path)) and not alive(int(keeper)) and not Path(folder).exists(), "all of it ends")


def test_a_keeper_that_was_killed_is_a_fault_and_its_folder_is_swept_by_the_next(tmp_path: Path) -> None:
    """A living one's is not."""
    killed, living = Keeper(), Keeper()
    killed._process.kill()
    with pytest.raises(EvaluationError, match=r"^the program that keeps its processes .* was killed$"):
        killed.run(["true"], tmp_path, ENVIRONMENT)
    killed._process.wait()
    assert killed.folder.exists()
    half = killed.folder.with_name(f"{killed.folder.name}-half")  # its keeper was killed when it had deleted the lock
    half.mkdir()
    third = Keeper()
    assert not killed.folder.exists()
    assert not half.exists()
    assert living.folder.exists()
    for keeper in (killed, living, third):
        keeper.close()


def test_without_roslaunch_the_package_to_install_is_named(keeper: Keeper, tmp_path: Path) -> None:
    environment = launches.environment(keeper.folder, tmp_path) | {"PATH": str(tmp_path)}
    with pytest.raises(EvaluationError, match=r"^roslaunch is not installed here, .*: apt install ros-core "):
        launches.launch(keeper, tmp_path / "x.launch", {}, environment)
