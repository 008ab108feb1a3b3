"""What a program may show where its output goes: colours, lines that move, characters."""

import os
import sys
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def prepare() -> None:
    """A character that the output's encoding does not have is written as its number: it ends no program."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


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
