"""What a check found."""

from typing import Literal, NamedTuple

State = Literal["ok", "warning", "broken"]


class Finding(NamedTuple):
    """A fact about this machine or network."""

    check: str
    state: State  # warning: it works, but slower, or not in all cases; broken: runs fail
    text: str
    mend: str = ""  # what to do


def ok(check: str, text: str) -> Finding:
    """Nothing to do."""
    return Finding(check, "ok", text)


def warning(check: str, text: str, mend: str) -> Finding:
    """It works, but not as it should."""
    return Finding(check, "warning", text, mend)


def broken(check: str, text: str, mend: str) -> Finding:
    """A run would fail."""
    return Finding(check, "broken", text, mend)
