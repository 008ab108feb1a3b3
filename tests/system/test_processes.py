"""Words for how a child process ended."""

import re
import signal
from pathlib import Path

import pytest

import zswarm
from zswarm.system.processes import MAX_OUTPUT, exit_reason, last_lines, wrote


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (7, "ended with code 7"),
        (-signal.SIGSEGV, "was killed by signal 11 (SIGSEGV)"),
        (
            -signal.SIGKILL,
            "was killed by signal 9 (SIGKILL; the machine may have run out of memory)",
        ),
        (-signal.SIGRTMIN - 3, f"was killed by signal {signal.SIGRTMIN + 3}"),
        (None, "closed its pipe"),
    ],
)
def test_exit_codes_have_words(code: int | None, words: str) -> None:
    assert exit_reason(code, "closed its pipe") == words


def test_the_last_lines_are_bounded_and_safe_for_a_terminal() -> None:
    assert last_lines("a\n\nb\n----\n  c\nd\n") == "b / c / d"
    assert last_lines(b"a\nb\x1b[1m\xff", 1) == "b\\x1b[1m\ufffd"
    assert len(last_lines("x" * 1000)) == MAX_OUTPUT
    assert wrote("no map") == "; it wrote: no map"
    assert wrote("\n--\n") == ""


def test_every_command_with_our_python_leaves_the_current_folder_out() -> None:
    """By -P, or -I; ``zswarm.ros.link.child`` asks older Pythons in the folder /."""
    found = []
    for path in sorted(Path(zswarm.__file__).parent.rglob("*.py")):
        text = path.read_text()
        commands = re.findall(r"\[\s*sys\.executable,\s*([^,\]]+)", text)
        safe = ("*MODULE", "*CODE", '"-I"')
        found += [(path.name, option) for option in commands if option not in safe]
        found += [(path.name, option) for option in re.findall(r'"-[mc]",', text)]
    assert found == [("child.py", '"-c",'), ("program.py", '"-c",')], "sh -c is the last"
