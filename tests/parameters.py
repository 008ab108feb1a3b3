"""Parameters of which ``make test`` plays some, and ``make long`` the others."""

from collections.abc import Iterable
from typing import Any

import pytest


def some(every: Iterable[Any], *now: Any) -> list[Any]:
    """Return all parameters, those that are not named marked as long; a tuple is several values."""
    return [
        each
        if each in now
        else pytest.param(
            *(each if isinstance(each, tuple) else (each,)), marks=pytest.mark.long
        )
        for each in every
    ]
