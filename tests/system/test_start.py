"""Programs whose surroundings lack something: standard streams, memory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from zswarm.system import start

CLOSED = 'exec "$0" "$@" <&- >&- 2>&-'
LOOKS = """
import json, os, sys, syslog
from zswarm.system import start
lines = []
syslog.syslog = lambda _, line: lines.append(line)
start.prepare("zswarm-x")
print("nobody reads this")
sys.stderr.write("a line\\nhalf ")
print("of another", file=sys.stderr)
same = [os.path.samestat(os.fstat(number), os.stat(os.devnull)) for number in range(3)]
with open(sys.argv[1], "w") as file:
    json.dump([lines, same, sys.stdin.read(), sys.stderr.isatty(), file.fileno() > 2], file)
"""


def test_closed_standard_streams_are_opened_and_errors_go_to_the_systems_log(
    tmp_path: Path,
) -> None:
    """No other file gets their numbers, and would be written to."""
    found = tmp_path / "found"
    command = ["sh", "-c", CLOSED, sys.executable, "-c", LOOKS, str(found)]
    assert subprocess.run(command, check=False).returncode == 0
    assert found.read_text() == (
        '[["a line", "half of another"], [true, true, true], "", false, true]'
    )


def test_open_standard_streams_stay_as_they_are() -> None:
    code = "import sys; from zswarm.system import start; before = sys.stderr"
    code += "; start.prepare('zswarm-x'); print(sys.stderr is before)"
    command = [sys.executable, "-c", code]
    assert subprocess.run(command, capture_output=True, check=True).stdout == b"True\n"


@pytest.mark.parametrize("program", ["ss", "ot"])
def test_too_little_address_space_is_named_in_one_line(program: str) -> None:
    limited = ["sh", "-c", 'ulimit -v 300000; exec "$0" "$@"', sys.executable]
    ended = subprocess.run(
        [
            *limited,
            "-m",
            f"zswarm.{program}",
            "list" if program == "ot" else "--capacity=1",
        ],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ,
    )
    assert ended.returncode == 1
    assert ended.stderr == (
        f"zswarm-{program}: the address space is limited to 292 MB; expected at least 600 MB "
        "(ulimit -v unlimited)\n"
    )


THREADS = """
import sys
from zswarm.system import start
start.prepare("zswarm-x")
import numpy, psutil
print(psutil.Process().num_threads())
"""


@pytest.mark.parametrize(
    ("asked", "threads"),
    [({}, 1), ({"OPENBLAS_NUM_THREADS": "2"}, min(2, os.cpu_count() or 1))],
)
def test_numpy_starts_no_threads_unless_it_is_asked_to(
    asked: dict[str, str], threads: int
) -> None:
    """They would spin for a tenth of a second of every program."""
    environment = {
        name: value for name, value in os.environ.items() if name not in start.ONE_THREAD
    }
    command = [sys.executable, "-c", THREADS]
    ended = subprocess.run(
        command, capture_output=True, check=True, env=environment | asked
    )
    assert int(ended.stdout) == threads
