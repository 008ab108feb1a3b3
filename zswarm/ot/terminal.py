"""What the commands print: tables and paragraphs for people, JSON for programs."""

import contextlib
import errno
import os
import sys
import textwrap
from collections.abc import Iterator
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from zswarm.screen import console, stdout
from zswarm.strict import to_json

LABEL = 12  # columns
NARROW = 60  # columns: tables need more
STATES = {"ok": "green", "warning": "yellow", "broken": "bold red"}
NUMBERS = {
    *("slots", "free", "runs", "generations", "best", "worst", "q25", "median", "q75", "quartiles", "evaluations", "time"),
    *("evaluated", "messages", "slots of use", "evaluations/run", "U", "p", "p (Holm)", "A12"),
}  # columns that stand at the right


UNFOLDED = 10_000  # columns, of what goes into a file or another program
NARROWEST = 10  # column of texts beside numbers


def table(*columns: str, box: box.Box | None = box.SIMPLE, padding: tuple[int, int, int, int] = (0, 1, 0, 1)) -> Table:
    """An empty table; long cells are folded into the terminal's width."""
    made = Table(box=box, padding=padding, pad_edge=False)
    for column in columns:
        made.add_column(column, overflow="fold", justify="right" if column in NUMBERS else "left")
    return made


def row(table: Table, *cells: object) -> None:
    """Another row; a cell's brackets are no markup."""
    table.add_row(*(Text(str(cell)) for cell in cells))


def show(table: Table) -> None:
    """Print a table; numbers are not broken unless nothing else helps. On a narrow terminal each row is a block of lines.

    Where it is no terminal that it goes to nothing is folded.
    """
    made = console()
    if not sys.stdout.isatty() and "COLUMNS" not in os.environ:
        made.width = UNFOLDED
    numbers = [column for column in table.columns if column.header in NUMBERS]
    texts = [column for column in table.columns if column.header not in NUMBERS]
    widths = [max(len(str(cell)) for cell in (column.header, *column.cells)) for column in numbers]
    if made.width >= NARROW or made.measure(table, options=made.options.update(max_width=UNFOLDED)).maximum <= made.width:
        if sum(widths) + len(texts) * NARROWEST + 2 * len(table.columns) <= made.width:
            for column in numbers:
                column.no_wrap = True
        made.print(table)
        return
    for cells in zip(*(column.cells for column in table.columns), strict=True):
        for number, (column, cell) in enumerate(zip(table.columns, cells, strict=True)):
            if str(cell):
                text = " ".join(str(cell).split())
                entry(f"  {column.header}", text, label=len("  generations  ")) if number else line(text)


def line(text: object, *, stderr: bool = False) -> None:
    """Print a text as it is, however wide the terminal."""
    console(stderr=stderr).print(Text(str(text)), soft_wrap=True)


def paragraph(text: str, *, stderr: bool = False) -> None:
    """Lines of the terminal's width, the second and later ones indented; names are not broken."""
    line(wrapped(text, console(stderr=stderr).width), stderr=stderr)


def wrapped(text: str, width: int) -> str:
    """A text as lines of a paragraph."""
    return "\n".join(textwrap.wrap(text, width, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False))


def entry(about: str, text: str, *, colour: str = "", label: int = LABEL) -> None:
    """What a text is about, in ``label`` columns, and the text beside it within the terminal's width."""
    made = console()
    words = textwrap.wrap(text, max(20, made.width - label), break_on_hyphens=False, break_long_words=False) or [""]
    made.print(Text(f"{about:{label}}", style=colour) + Text(f"\n{' ' * label}".join(words)), soft_wrap=True)


def item(name: str, *texts: str) -> None:
    """Something of a list: its name, and below it texts within the terminal's width."""
    made = console()
    lines = [
        line
        for text in texts
        for line in textwrap.wrap(text, max(20, made.width - 4), break_on_hyphens=False, break_long_words=False)
    ]
    made.print(Text(f"  {name}", style="bold") + Text("".join(f"\n    {line}" for line in lines)), soft_wrap=True)


def fact(state: str, about: str, text: str, mend: str) -> None:
    """A state, what it is about, a text, and in lines of its own what to do; all within the terminal's width."""
    made = console()
    indent = " " * 20
    words = textwrap.wrap(text, max(20, made.width - len(indent)), break_on_hyphens=False) or [""]
    shown = Text(f"{state:8}", style=STATES.get(state, "")) + Text(f"{about:12}" + f"\n{indent}".join(words))
    made.print(shown, soft_wrap=True)
    if mend:
        steps = textwrap.wrap(mend, max(20, made.width - len(indent) - 2), break_on_hyphens=False, break_long_words=False)
        made.print(Text(indent + "> " + f"\n{indent}  ".join(steps)), soft_wrap=True)


def print_json(value: dict[str, Any]) -> None:
    """One object on a line of stdout."""
    with patience():
        print(to_json(value), file=stdout(), flush=True)


@contextlib.contextmanager
def patience() -> Iterator[None]:
    """A full disk that output goes to stops no run: the stream writes with a later line what its buffer could keep."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise


def plural(count: int, noun: str) -> str:
    """``1 slot``, ``2 slots``."""
    return f"{count} {noun}{'s' if count != 1 else ''}"
