"""What the commands print: tables and paragraphs for people, JSON for programs."""

import contextlib
import errno
import textwrap
from collections.abc import Iterator
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from zswarm.strict import to_json

NUMBERS = {
    *("slots", "free", "runs", "generations", "best", "worst", "q25", "median", "q75", "quartiles", "evaluations", "time"),
    *("U", "p", "p (Holm)", "A12"),
}  # columns that stand at the right


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
    """Print a table; numbers are not broken unless nothing else helps."""
    console = Console()
    numbers = [column for column in table.columns if column.header in NUMBERS]
    texts = [column for column in table.columns if column.header not in NUMBERS]
    widths = [max(len(str(cell)) for cell in (column.header, *column.cells)) for column in numbers]
    if sum(widths) + len(texts) * NARROWEST + 2 * len(table.columns) <= console.width:
        for column in numbers:
            column.no_wrap = True
    console.print(table)


def line(text: object, *, stderr: bool = False) -> None:
    """Print a text as it is, however wide the terminal."""
    Console(stderr=stderr).print(Text(str(text)), soft_wrap=True)


def paragraph(text: str, *, stderr: bool = False) -> None:
    """Lines of the terminal's width, the second and later ones indented; names are not broken."""
    lines = textwrap.wrap(
        text, Console(stderr=stderr).width, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False
    )
    line("\n".join(lines), stderr=stderr)


def print_json(value: dict[str, Any]) -> None:
    """One object on a line of stdout."""
    with patience():
        print(to_json(value), flush=True)


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
