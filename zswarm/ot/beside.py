"""The dashboard of a run that goes on: another program, which ends with this one."""

import contextlib
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path


@contextlib.contextmanager
def dashboard(folder: Path, say: Callable[[str], None]) -> Iterator[None]:
    """Show a run's or a study's folder meanwhile.

    Args:
        say: takes the lines that the dashboard says, its address first; called by another thread.
    """
    program = subprocess.Popen(
        [sys.executable, "-m", "zswarm.ot", "dashboard", str(folder), "--until-stdin-closes"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,  # Ctrl-C is for this program, which ends the other one
    )
    assert program.stdin is not None  # noqa: S101  it was asked for above
    assert program.stderr is not None  # noqa: S101  likewise
    lines = program.stderr

    def pass_on() -> None:
        for line in lines:
            say(line.rstrip("\n"))

    told = threading.Thread(target=pass_on, name="dashboard", daemon=True)
    told.start()
    try:
        yield
    finally:
        program.stdin.close()
        try:
            program.wait(5.0)
        except subprocess.TimeoutExpired:
            program.kill()
            program.wait()
        told.join()
        lines.close()
