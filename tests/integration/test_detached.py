"""Runs that outlive their terminal, and the commands that find, follow and stop them."""

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.programs import Optimizer, Program, wait_until

pytestmark = pytest.mark.programs

PLAIN = {"ZSWARM_PLAIN": "1"}  # nothing is compiled for what is small
LONG = ["minisim", "--generations", "100000", "--servers", "local"]
SMALL = [
    *LONG,
    "--population",
    "4",
    "--trials",
    "1",
    "--set",
    "problem.settings.steps=25",
]


def detached(folder: Path, *arguments: str) -> dict[str, object]:
    """Start something; return what is printed of it when the command has ended."""
    arguments = ("run", *SMALL, *arguments, "--detach", "--json")
    started = Optimizer(folder, "started", list(arguments), **PLAIN)
    assert started.wait() == 0, started.err.read_text()
    (line,) = started.lines()
    assert line["event"] == "detached"
    return line


def states(folder: Path) -> dict[str, str]:
    """Return the status of each run, as a command prints it."""
    shown = Optimizer(folder, "status", ["status", "--json"])
    assert shown.wait() == 0, shown.err.read_text()
    (line,) = shown.lines()
    return {row["run"]: row["status"] for row in line["runs"]}


def stop(folder: Path, name: str) -> None:
    stopped = Optimizer(folder, "stop", ["stop", name])
    assert stopped.wait() == 0, stopped.err.read_text()
    assert f"zswarm-ot resume {name}" in stopped.out.read_text()


def stop_all(folder: Path) -> None:
    for run in (folder / "runs").glob("**/lock"):
        (run.parent / "control").write_text("stop")


@pytest.fixture(autouse=True)
def ended(tmp_path: Path) -> Iterator[None]:
    yield
    stop_all(tmp_path)  # if a test failed


def generations(program: Program) -> int:
    return program.out.read_text().count('"event": "generation"')


def test_a_detached_run_is_followed_left_alone_and_stopped(tmp_path: Path) -> None:
    started = detached(tmp_path)
    assert started["run"] == "runs/minisim"
    process = int(str(started["process"]))
    assert os.getsid(process) == process, "the end of the terminal is not for it"
    assert states(tmp_path) == {"runs/minisim": "running"}

    follower = Optimizer(tmp_path, "attach", ["attach", "runs/minisim"])
    wait_until(lambda: generations(follower) >= 2, "generations are followed")
    follower.kill(signal.SIGINT)
    assert follower.wait() == 130
    assert states(tmp_path) == {"runs/minisim": "running"}

    follower = Optimizer(tmp_path, "again", ["attach", "runs/minisim"])
    wait_until(lambda: generations(follower) >= 2, "generations are followed")
    stop(tmp_path, "runs/minisim")
    assert follower.wait() == 0
    assert "Resume with: zswarm-ot resume runs/minisim" in follower.out.read_text()
    assert states(tmp_path) == {"runs/minisim": "stopped"}
    again = Optimizer(tmp_path, "stop", ["stop", "runs/minisim"])
    assert again.wait() == 2
    assert "not running" in again.err.read_text()

    resume = ["resume", "runs/minisim", "--detach"]
    resumed = Optimizer(tmp_path, "resume", resume, **PLAIN)
    assert resumed.wait() == 0, resumed.err.read_text()
    assert states(tmp_path) == {"runs/minisim": "running"}
    stop(tmp_path, "runs/minisim")


def test_a_detached_study_is_stopped_as_a_whole(tmp_path: Path) -> None:
    assert detached(tmp_path, "--repeat", "4")["run"] == "runs/minisim"
    wait_until(lambda: "running" in states(tmp_path).values(), "a run of it runs")
    stop(tmp_path, "runs/minisim")
    assert set(states(tmp_path).values()) == {"stopped"}


def test_what_cannot_begin_is_reported_in_the_terminal(tmp_path: Path) -> None:
    wrong = Optimizer(tmp_path, "ot", ["run", "stadium", "--set", "seed=x", "--detach"])
    assert wrong.wait() == 2
    assert "--set seed=x" in wrong.err.read_text()
    assert not (tmp_path / "runs").exists()
    missing = Optimizer(tmp_path, "ot", ["attach", "runs/none"])
    assert missing.wait() == 2
    assert json.dumps("no log to follow")[1:-1] in missing.err.read_text()
