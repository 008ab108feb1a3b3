"""The results of checks."""

from collections.abc import Iterator
from functools import partial
from typing import Literal, NamedTuple

State = Literal["ok", "warning", "broken"]


class Finding(NamedTuple):
    """A fact about this machine or network."""

    check: str
    state: State  # warning: it works, but slower, or not always; broken: runs fail
    text: str
    fix: str = ""  # what to do


Findings = Iterator[Finding]
# Called with a text and what to do; ``examine`` names the check.
ok = partial(Finding, "", "ok")
warning = partial(Finding, "", "warning")
broken = partial(Finding, "", "broken")
