"""Print tables and paragraphs for people, and JSON for programs."""

import contextlib
import errno
import os
import sys
import textwrap
from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import replace
from typing import IO, TYPE_CHECKING, Any

from zswarm.config.decode import to_json
from zswarm.system.terminal import console, moves, stdout

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

LABEL = 12  # columns
NARROW = 60  # columns: tables need more
UNFOLDED = 10_000  # columns, where output goes into a file or another program
NARROWEST = 10  # columns of a text next to numbers
LEAST = 20  # columns of a hanging paragraph
UNBROKEN: dict[str, Any] = {"break_on_hyphens": False, "break_long_words": False}
STATES = {"ok": "green", "warning": "yellow", "broken": "bold red"}


def table(*columns: str, **style: Any) -> "Table":
    """Make an empty table, whose long cells are folded.

    Args:
        columns: their headers; ``>`` before one aligns its column to the right, for numbers.
        style: of a rich table, in place of ours.
    """
    # Here and in _text: what commands import at their top must not load rich, which takes 40 ms.
    from rich import box
    from rich.table import Table

    made = Table(**{"box": box.SIMPLE, "padding": (0, 1), "pad_edge": False, **style})
    for column in columns:
        justify = "right" if column.startswith(">") else "left"
        made.add_column(column.removeprefix(">"), overflow="fold", justify=justify)  # type: ignore[arg-type]
    return made


def row(table: "Table", *cells: object) -> None:
    """Add a row of texts of one line, in which brackets are not markup."""
    table.add_row(*(_text(str(cell)) for cell in cells))


def show(table: "Table", *, stderr: bool = False) -> None:
    """Print a table, as a block of lines for each row where the terminal is too narrow.

    Numbers are broken only where nothing else helps. In a file or a pipe nothing is folded.
    """
    made = console(stderr=stderr)
    stream = sys.stderr if stderr else sys.stdout
    if not stream.isatty() and "COLUMNS" not in os.environ:
        made.width = UNFOLDED
    joined = _joined(table)
    unfolded = made.measure(
        joined, options=made.options.update(max_width=UNFOLDED)
    ).maximum
    if made.width < min(NARROW, unfolded):
        _show_blocks(table, stderr=stderr)
        return
    if made.width >= unfolded:
        made.print(joined)
        return
    numbers = [column for column in table.columns if column.justify == "right"]
    needed = NARROWEST * (len(table.columns) - len(numbers)) + 2 * len(table.columns)
    for column in numbers:
        needed += max(len(str(cell)) for cell in (column.header, *column.cells))
    for column in numbers:
        column.no_wrap = needed <= made.width
    made.print(table)


def _joined(table: "Table") -> "Table":
    """Return a table whose rows are lines of one, which rich prints five times as fast.

    It looks the same where nothing is folded.
    """
    joined = copy(table)
    joined.rows = table.rows[:1]
    joined.columns = [
        replace(column, _cells=[_text("\n".join(map(_unbroken, column.cells)))])
        for column in table.columns
    ]
    return joined


def _unbroken(cell: object) -> str:
    return str(cell).replace("\n", " ")


def _show_blocks(table: "Table", *, stderr: bool) -> None:
    headers = [f"  {column.header}" for column in table.columns]
    for cells in zip(*(column.cells for column in table.columns), strict=True):
        first, *others = (" ".join(str(cell).split()) for cell in cells)
        line(first, stderr=stderr)
        for header, text in zip(headers[1:], others, strict=True):
            if text:
                entry(header, text, label=2 + max(map(len, headers)), stderr=stderr)


def line(text: "str | Text", *, stderr: bool = False) -> None:
    """Print a text unchanged, regardless of the terminal's width."""
    console(stderr=stderr).print(text, soft_wrap=True)


def doing(text: str) -> contextlib.AbstractContextManager[object]:
    """Show on a terminal what is being done, while a ``with`` block does it."""
    if not moves(sys.stderr):
        return contextlib.nullcontext()
    return console(stderr=True, live=True).status(text)


def paragraph(text: str, *, stderr: bool = False) -> None:
    """Print lines of the terminal's width, indented from the second on; names are not broken."""
    line(wrapped(text, console(stderr=stderr).width), stderr=stderr)


def unit(trials: Iterable[int]) -> None:
    """Print what fitness is above, if candidates of some run have so many trials."""
    if max(trials, default=1) > 1:
        paragraph("fitness is the mean of a candidate's trials")


def wrapped(text: str, width: int) -> str:
    """Break a text between words; its later lines are indented by 2 columns."""
    return "\n".join(textwrap.wrap(text, width, subsequent_indent="  ", **UNBROKEN))


def entry(
    about: str,
    text: str,
    *,
    colour: str = "",
    label: int = LABEL,
    stderr: bool = False,
) -> None:
    """Print a label padded to some columns, then a text within the terminal's width."""
    _hanging(_text(f"{about:{label}}", colour), text, label, stderr=stderr)


def item(name: str, *texts: str) -> None:
    """Print the name of a list's item, and below it texts within the terminal's width."""
    line(_text(f"  {name}", "bold"))
    for text in texts:
        _hanging(_text("    "), text, 4)


def fact(state: str, about: str, text: str, remedy: str) -> None:
    """Print a state, what it is about, a text, and below it what to do."""
    lead = _text(f"{state:8}", STATES.get(state, "")) + f"{about:12}"
    _hanging(lead, text, 20)
    if remedy:
        _hanging(_text(f"{'':20}> "), remedy, 22)


def _hanging(lead: "Text", text: str, indent: int, *, stderr: bool = False) -> None:
    """Print a text after its lead, with all lines beginning in the same column."""
    made = console(stderr=stderr)
    lines = textwrap.wrap(text, max(LEAST, made.width - indent), **UNBROKEN)
    made.print(lead + f"\n{' ' * indent}".join(lines), soft_wrap=True)


def _text(text: str, style: str = "") -> "Text":
    """Return a text in which brackets are not markup."""
    from rich.text import Text

    return Text(text, style)


def print_json(value: dict[str, Any]) -> None:
    """Print an object on one line of stdout."""
    echo(to_json(value), stdout())


def echo(text: str, stream: IO[str]) -> None:
    """Print a text into a stream at once, also if the disk behind it is full."""
    with patience():
        print(text, file=stream, flush=True)


@contextlib.contextmanager
def patience() -> Iterator[None]:
    """Ignore a full disk: the stream writes the rest with its next line."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
