"""Adapt output to where it goes: colours, live lines, encodings, JSON on stdout."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def prepare() -> None:
    """Write characters that the output's encoding lacks as escapes instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


_json: list[IO[str]] = []  # stdout, while only JSON may be written there


def stdout() -> IO[str]:
    """Return the stream for JSON."""
    return _json[-1] if _json else sys.stdout


@contextlib.contextmanager
def json_alone() -> Iterator[None]:
    """Reserve stdout for JSON: what simulators print in this process, also in C, goes to stderr."""
    own = sys.stdout
    own.flush()
    try:
        saved = os.dup(1) if own.fileno() == 1 else None
    except (OSError, ValueError):  # not a file
        saved = None
    stream = own
    if saved is not None:
        stream = os.fdopen(
            os.dup(1), "w", encoding=own.encoding, errors="backslashreplace"
        )
        os.dup2(2, 1)
    sys.stdout = sys.stderr
    _json.append(stream)
    try:
        yield
    finally:
        _json.pop()
        sys.stdout = own
        if saved is not None:
            os.dup2(saved, 1)
            os.close(saved)
            stream.close()


def coloured(stream: IO[str]) -> bool:
    """Return whether to colour output: by FORCE_COLOR, NO_COLOR, TERM, or if it is a terminal."""
    if force := os.environ.get("FORCE_COLOR"):
        return force != "0"
    return (
        not os.environ.get("NO_COLOR")
        and os.environ.get("TERM") != "dumb"
        and stream.isatty()
    )


def moves(stream: IO[str]) -> bool:
    """Return whether lines can be overwritten there."""
    return stream.isatty() and os.environ.get("TERM") not in ("dumb", None, "")


def console(*, stderr: bool = False, live: bool = False) -> "Console":
    """Return a console that prints text as it is, without markup.

    Args:
        live: for lines that are overwritten, where ``moves`` allows it; otherwise only colours
            produce escape sequences.
    """
    from rich.console import Console

    with_colour = coloured(sys.stderr if stderr else sys.stdout)
    return Console(
        stderr=stderr,
        force_terminal=live or with_colour,
        color_system="auto" if with_colour else None,
        no_color=not with_colour,
        highlight=False,
        emoji=False,
        markup=False,
    )
