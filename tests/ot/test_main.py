"""``zswarm-ot`` while it loads its parts."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

# Instead of click, which is what it loads first: Ctrl-C comes while this one loads.
LOADING = """
import os, sys
print("loading", flush=True)
sys.stdin.read()
print("went on", flush=True)
os._exit(0)
"""


@pytest.mark.parametrize("begun", ["in the foreground", "in the background"])
def test_ctrl_c_during_start_up_ends_the_program_silently(
    tmp_path: Path, begun: str
) -> None:
    """A program that a shell started in the background ignores Ctrl-C."""
    (tmp_path / "click.py").write_text(LOADING)
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    how = signal.SIG_IGN if begun == "in the background" else signal.SIG_DFL
    with subprocess.Popen(
        [sys.executable, "-m", "zswarm.ot", "--version"],
        env=os.environ | {"PYTHONPATH": path},
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, how),
    ) as program:
        assert program.stdout is not None
        first = program.stdout.readline()
        program.send_signal(signal.SIGINT)
        rest, err = program.communicate(timeout=60)
    assert (first, err) == ("loading\n", "")
    assert (program.returncode, rest) == (
        (0, "went on\n") if how == signal.SIG_IGN else (130, "")
    )
