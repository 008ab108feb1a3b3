"""Find the line of a TOML file on which a key is set, which tomllib does not report."""

import contextlib
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from zswarm.config.decode import parse, value_at
from zswarm.errors import ConfigError

LONGEST = 5_000  # lines
TRIES = 200  # prefixes that are parsed


def find(text: str, path: Sequence[str]) -> int | None:
    """Return the line, from 1, where a key or table is first set; None if it cannot be found.

    The first n lines are TOML unless they cut a statement, so the shortest prefix that contains
    the key ends with the statement that sets it.
    """
    lines = text.splitlines(keepends=True)
    if not path or len(lines) > LONGEST:
        return None
    keys = r"\s*\.\s*".join(rf"[\"']?{re.escape(key)}[\"']?" for key in path)
    header = re.compile(rf"\s*\[{{1,2}}\s*{keys}\s*\]{{1,2}}")
    candidates = [number for number, line in enumerate(lines) if path[-1] in line]
    # Prefer the header of a table to other lines.
    candidates.sort(key=lambda number: (header.match(lines[number]) is None, number))
    tries = TRIES
    for number in candidates:
        for end in range(number + 1, len(lines) + 1):
            tries -= 1
            if not tries:
                return None
            try:
                prefix = tomllib.loads("".join(lines[:end]))
            except (ValueError, RecursionError):
                continue  # the prefix ends within a statement
            if has(prefix, path):
                return number + 1
            break
    return None


@contextlib.contextmanager
def located(
    where: str, used: Callable[[], Mapping[str, Any]], *path: str
) -> Iterator[None]:
    """Add the line of the file ``where`` to a ``ConfigError`` about a key at or below ``path``.

    The line is omitted if ``used()`` has another value there than the file: an override set it.
    """
    try:
        yield
    except ConfigError as error:
        full = (*path, *error.path)
        try:
            text = Path(where).read_text(encoding="utf-8")
            written = value_at(parse(text), full)
            # Compare texts, because 1 == 1.0 == True.
            same = written is not None and repr(written) == repr(value_at(used(), full))
            line = find(text, full) if same else None
        except (OSError, ValueError, RecursionError):  # RecursionError: nested too deep
            raise error from None
        if line is None:
            raise type(error)(str(error), full) from error
        raise type(error)(
            f"{where}:{line}{str(error).removeprefix(where)}", full
        ) from error


def has(mapping: Any, path: Sequence[str]) -> bool:
    """Return whether there is a value at a path. TOML has no null."""
    return value_at(mapping, path) is not None
