"""What a program may show where its output goes: colours, lines that move, characters."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def prepare() -> None:
    """A character that the output's encoding does not have is written as its number: it ends no program."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


_apart: list[IO[str]] = []  # stdout, while nothing else is to write there


def stdout() -> IO[str]:
    """Where JSON goes."""
    return _apart[-1] if _apart else sys.stdout


@contextlib.contextmanager
def json_alone() -> Iterator[None]:
    """Have nothing but JSON go to stdout: what simulators print in this process, in C, too, goes to stderr."""
    own = sys.stdout
    own.flush()
    try:
        kept = os.dup(1) if own.fileno() == 1 else None
    except (OSError, ValueError):  # it is no file
        kept = None
    if kept is None:
        stream = own
    else:
        stream = os.fdopen(os.dup(1), "w", encoding=own.encoding, errors="backslashreplace")
        os.dup2(2, 1)
    sys.stdout = sys.stderr
    _apart.append(stream)
    try:
        yield
    finally:
        _apart.pop()
        sys.stdout = own
        if kept is not None:
            os.dup2(kept, 1)
            os.close(kept)
            stream.close()


def coloured(stream: IO[str]) -> bool:
    """Whether to colour what goes there: FORCE_COLOR, else NO_COLOR, else a dumb terminal, else whether it is a terminal."""
    if force := os.environ.get("FORCE_COLOR"):
        return force != "0"
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb" and stream.isatty()


def moves(stream: IO[str]) -> bool:
    """Whether a line there can be written over."""
    return stream.isatty() and os.environ.get("TERM") not in ("dumb", None, "")


def console(*, stderr: bool = False, live: bool = False) -> "Console":
    """To print on; texts are taken as they are.

    Args:
        live: for lines that move, where ``moves`` says that they can; else nothing but colours makes an escape byte.
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
