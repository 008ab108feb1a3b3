"""The line of a TOML text on which a key is set: tomllib does not tell."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

LONGEST = 5_000  # lines that are looked through
TRIES = 200  # beginnings of it that are parsed


def find(text: str, path: Sequence[str]) -> int | None:
    """The line, from 1, where a key or table is first set; None where it is not, or cannot be told.

    The first lines of a text are TOML themselves wherever no statement is cut, so the first beginning that has the key
    ends with the statement that sets it.
    """
    lines = text.splitlines(keepends=True)
    if not path or len(lines) > LONGEST:
        return None
    candidates = [number for number, line in enumerate(lines) if path[-1] in line]
    header = re.compile(r"\s*\[{1,2}\s*" + r"\s*\.\s*".join(rf"[\"']?{re.escape(key)}[\"']?" for key in path) + r"\s*\]{1,2}")
    candidates.sort(key=lambda number: (header.match(lines[number]) is None, number))  # a table is rather where its name is
    tries = TRIES
    for number in candidates:
        for end in range(number + 1, len(lines) + 1):
            if not (tries := tries - 1):
                return None
            try:
                begun = tomllib.loads("".join(lines[:end]))
            except (ValueError, RecursionError):
                continue  # within a statement
            if has(begun, path):
                return number + 1
            break
    return None


def has(mapping: Any, path: Sequence[str]) -> bool:
    """Whether there is something at a path."""
    for key in path:
        if not isinstance(mapping, Mapping) or key not in mapping:
            return False
        mapping = mapping[key]
    return True


def value(mapping: Any, path: Sequence[str]) -> Any:
    """What is at a path; None where nothing is."""
    for key in path:
        if not isinstance(mapping, Mapping) or key not in mapping:
            return None
        mapping = mapping[key]
    return mapping
