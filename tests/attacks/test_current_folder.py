"""What lies in the current folder is never run: a folder may come from somebody else."""

import asyncio
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.integration.programs import Server
from zswarm.ot.dashboard.replay_cache import ReplayCache

pytestmark = pytest.mark.attacks

BIN = Path(sys.executable).parent
# Modules of Python and of packages that zswarm's programs, and multiprocessing, import.
SHADOWED = ("queue", "selectors", "random", "structlog", "msgspec", "tempfile", "socket")
LONGEST_S = 300.0


@pytest.fixture
def trap(tmp_path: Path) -> Path:
    """Make a folder whose modules write the file ``ran``."""
    for name in SHADOWED:
        ran = f"open({str(tmp_path / 'ran')!r}, 'a').write({name!r})"
        (tmp_path / f"{name}.py").write_text(f"{ran}\nraise ImportError('trap')\n")
    return tmp_path


def ran(trap: Path) -> str:
    return (trap / "ran").read_text() if (trap / "ran").exists() else ""


def test_the_trap_works(trap: Path) -> None:
    subprocess.run([sys.executable, "-c", "import queue"], cwd=trap, capture_output=True)
    assert ran(trap) == "queue"


def test_an_optimizer_runs_nothing_of_it(trap: Path) -> None:
    """Its slots, its replay in the dashboard, and what ``doctor`` asks."""
    run = ["run", "xor", "--servers", "local", "--set", "generations=2"]
    for command in (run, ["doctor"]):
        done = subprocess.run(
            [BIN / "zswarm-ot", *command],
            cwd=trap,
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
        )
        assert ran(trap) == "", done.stderr
    assert (trap / "runs" / "xor" / "champion.zsc").is_file()
    before = os.getcwd()
    os.chdir(trap)
    try:
        asked = ReplayCache().get(Path("runs/xor"), 0, 0, 0)
        # In a thread: where tests drove a browser before, this one has a loop that runs.
        with ThreadPoolExecutor() as pool:
            assert pool.submit(asyncio.run, asked).result()
    finally:
        os.chdir(before)
    assert ran(trap) == ""


class InstalledServer(Server):
    """A server whose program is the installed one, not a module of the tests' Python."""

    python = str(BIN / "zswarm-ss")

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "lab-01", capacity=1)


def test_a_server_and_its_fork_server_run_nothing_of_it(
    trap: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[list[str]] = []
    start = subprocess.Popen.__init__

    def without_module(self: object, command: list[str], **more: object) -> None:
        begun.append([word for word in command if word not in ("-m", "zswarm.ss")])
        start(self, begun[-1], **more)  # type: ignore[arg-type]  # what was given

    monkeypatch.setattr(subprocess.Popen, "__init__", without_module)
    server = InstalledServer(trap)
    try:
        server.ready()
        assert begun[0][0] == InstalledServer.python
        server.kill(signal.SIGTERM)
        server.wait()
    finally:
        server.close()
    assert ran(trap) == ""
