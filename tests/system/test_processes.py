"""Words for how a child process ended."""

import signal

import pytest

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
