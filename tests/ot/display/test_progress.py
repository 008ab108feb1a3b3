"""How a run shows itself where there is little room."""

import os
import pty
import re
import select
import struct
import sys
import time
from fcntl import ioctl
from pathlib import Path
from subprocess import Popen
from termios import TIOCSWINSZ

import pytest

from zswarm.ot.display.progress import fitting, next_steps
from zswarm.ot.display.tables import wrapped
from zswarm.ot.logger import Result

DEADLINE_S = 60.0
UNSET = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR")
SCRIPT = """
from pathlib import Path
from zswarm import experiment
from zswarm.ot.display.progress import display
from zswarm.ot.logger import Generation, Started
path = experiment.find("minisim")
shown = display(as_json=False)
shown.on_start(Started(Path("runs/minisim"), experiment.load(path, ["generations=100000"]), 0))
shown.on_wait("lab-01-0123abcd: compiling kernel 3 of 14, once (5 s)")
shown._progress.refresh()
def played(generation):
    evaluations = 10**generation.bit_length()
    numbers = (-123.456789, -1234.56789, evaluations, 1024, 4096, {})
    shown.on_generation(Generation(generation, *numbers, last=100_000, after=0.25))
def left():
    return f"{shown._progress.tasks[0].remaining:.0f}"
played(99_998)
shown.on_say(f"{left()} generations are left")
shown.on_progress(100_000, 30, 120)
shown.on_say(f"{left()} are left in the assessment")
for generation in (0, 99_998):
    played(generation)
shown.on_say("a line")
shown.on_end(None)
"""


def test_a_narrow_line_shows_the_most_important_parts() -> None:
    parts = ["best 1", "mean 2", "3/s", "4 slots"]
    assert fitting(parts, 80) == "best 1  mean 2  3/s  4 slots"
    assert fitting(parts, 27) == "best 1  3/s  4 slots"
    assert fitting(parts, 15) == "best 1  4 slots"
    assert fitting(parts, 3) == "best 1"


@pytest.mark.parametrize("columns", [80, 40])
@pytest.mark.parametrize(
    "environment", [{}, {"NO_COLOR": "1"}, {"PYTHONIOENCODING": "ascii"}]
)
def test_the_line_of_a_run_is_one_line(
    columns: int, environment: dict[str, str], tmp_path: Path
) -> None:
    """The terminal is real and has this width; colour is left out where it is not wanted."""
    ours, its = pty.openpty()
    ioctl(its, TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    base = {name: value for name, value in os.environ.items() if name not in UNSET}
    done = Popen(
        [sys.executable, "-c", SCRIPT],
        stdin=its,
        stdout=its,
        stderr=its,
        cwd=tmp_path,
        env=base | {"TERM": "xterm"} | environment,
    )
    os.close(its)
    seen, end = "", time.monotonic() + DEADLINE_S
    while time.monotonic() < end:
        if select.select([ours], [], [], 0.1)[0]:
            try:
                seen += os.read(ours, 4096).decode()
            except OSError:  # it ended
                break
    os.close(ours)
    assert done.wait(DEADLINE_S) == 0, seen
    lines = [
        re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", line) for line in re.split(r"[\r\n]+", seen)
    ]
    assert "a line" in lines
    assert "25001 generations are left" in lines
    assert "18750 are left in the assessment" in lines
    assert any("lab-01-0123abcd:" in line for line in lines), lines
    assert any(
        line.startswith("99999/100000 ") and "best -123.46" in line for line in lines
    ), lines
    assert all(len(line.rstrip()) <= columns for line in lines)
    assert not any("…" in line or "..." in line for line in lines)
    coloured = re.search(r"\x1b\[[0-9;]*[1-9][0-9;]*m", seen) is not None
    assert coloured == ("NO_COLOR" not in environment)
    if "PYTHONIOENCODING" in environment:
        assert seen.isascii()


def test_lines_above_a_live_one_are_broken_between_words() -> None:
    text = f"lab-01-0123abcd: getting emergency-exit ready {'/a-long-path' * 8}"
    lines = wrapped(text, 40).splitlines()
    assert lines[0] == "lab-01-0123abcd: getting emergency-exit"
    assert [line.strip() for line in lines[1:]] == ["ready", "/a-long-path" * 8]


@pytest.mark.parametrize(("trials", "second"), [(1, "plot"), (10, "evaluate")])
def test_three_commands_that_show_a_run_are_named(trials: int, second: str) -> None:
    """A champion whose only trial is the same for every seed is not evaluated."""
    ended = Result("runs/x", 3, 1.0, 150, 0, "00", 0.1, 0, 0, trials=trials)
    assert next_steps(ended).split() == [
        "next",
        *"zswarm-ot replay runs/x".split(),
        *f"zswarm-ot {second} runs/x".split(),
        *"zswarm-ot report runs/x".split(),
    ]
