"""Tables as CSV that spreadsheets, R and pandas read: texts are quoted, and none is taken for a formula."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from zswarm.files import write_for_user
from zswarm.protocol.codec import clean

EMPTY = "\0"  # stands for a cell without a value until its quotes are taken away; no cleaned text holds it
FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")  # noqa: RUF001  a spreadsheet computes these, too


def to_csv(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """The table with a line of names first; what is no number (None, NaN, infinite) is empty."""
    text = io.StringIO()
    writer = csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow([_cell(value) for value in row])
    return text.getvalue().replace(f'"{EMPTY}"', "")


def save(path: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Into a file; ``-`` is stdout.

    Raises:
        ConfigError: it cannot be written.
    """
    text = to_csv(header, rows)
    if path == "-":
        click.echo(text, nl=False)
        return
    write_for_user(Path(path), text.encode())


def _cell(value: object) -> object:
    match value:
        case bool():
            return int(value)
        case int():
            return value
        case float():
            return value if math.isfinite(value) else EMPTY
        case None:
            return EMPTY
    text = clean(str(value))
    return f"'{text}" if text.startswith(FORMULA) else text
