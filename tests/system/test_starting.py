"""Programs see that a daemon of this machine is starting."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from zswarm.ot.cluster import diagnosis
from zswarm.session import Reach
from zswarm.system.starting import SUFFIX, Starting, daemons

STARTS = """
from zswarm.system.starting import Starting
mark = Starting()
print("marked", flush=True)
input()
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of all programs here; other ones of this machine are not seen."""
    monkeypatch.setattr("zswarm.system.starting.visible_folders", lambda: [tmp_path])
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    return tmp_path


def test_a_daemon_is_starting_until_it_says_otherwise(folder: Path) -> None:
    assert daemons() == 0
    first = Starting()
    assert daemons() == 1
    first.end()
    first.end()
    assert (daemons(), list(folder.iterdir())) == (0, [])


def test_a_killed_daemon_is_not_starting(folder: Path) -> None:
    """Its file stays until the next one starts."""
    with subprocess.Popen(
        [sys.executable, "-c", STARTS],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == b"marked\n"
        assert daemons() == 1
        program.send_signal(signal.SIGKILL)
    assert daemons() == 0
    assert len(list(folder.glob("*" + SUFFIX))) == 1
    mark = Starting()
    assert daemons() == len(list(folder.glob("*" + SUFFIX))) == 1
    mark.end()


def test_without_a_folder_a_daemon_starts_unmarked(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(folder / "none" / "below"))
    mark = Starting()
    assert daemons() == 0
    mark.end()


def test_a_missing_server_of_this_machine_is_said_to_be_starting() -> None:
    """It is the reason, and nothing on the network is blamed."""
    mark = Starting()
    assert diagnosis.diagnose("default", [], Reach()) == [diagnosis.STARTING]
    mark.end()
    # It can have become ready after the search.
    found = diagnosis.diagnose("default", [], Reach(), starting=True)
    assert found == [diagnosis.STARTING]
