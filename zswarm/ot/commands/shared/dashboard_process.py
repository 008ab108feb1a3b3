"""Run the dashboard of a run in another program, which ends with this one."""

import contextlib
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from zswarm.system.processes import MODULE

END_S = 5.0  # until it is killed


@contextlib.contextmanager
def dashboard(
    folder: Path, say: Callable[[str], None], *, wanted: bool
) -> Iterator[None]:
    """Show the folder of a run or a study while the context is open, if that is wanted.

    Args:
        folder: what to show.
        say: takes the lines that the dashboard prints, its address first; called by a thread.
        wanted: otherwise nothing is started.
    """
    if not wanted:
        yield
        return
    program = subprocess.Popen(
        [
            sys.executable,
            *MODULE,
            "zswarm.ot",
            "dashboard",
            str(folder),
            "--until-stdin-closes",
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,  # Ctrl-C is for this program, which ends the other one
    )
    assert program.stdin is not None  # noqa: S101  it was asked for above
    assert program.stderr is not None  # noqa: S101  likewise
    lines = program.stderr

    def forward() -> None:
        for line in lines:
            say(line.rstrip("\n"))

    reader = threading.Thread(target=forward, name="dashboard", daemon=True)
    reader.start()
    try:
        yield
    finally:
        program.stdin.close()
        try:
            program.wait(END_S)
        except subprocess.TimeoutExpired:
            program.kill()
            program.wait()
        reader.join()
        lines.close()
