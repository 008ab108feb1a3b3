"""Write CSV for spreadsheets, R and pandas: texts are quoted and never taken for formulas."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from zswarm.system.files import write_for_user
from zswarm.system.text import clean

# Marks an empty cell until its quotes are removed; clean text never contains it.
EMPTY = "\0"
# Spreadsheets compute the full-width signs, too.
FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")  # noqa: RUF001


def to_csv(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table with its header; None, NaN and infinite numbers become empty cells."""
    text = io.StringIO()
    writer = csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(map(_cell, row) for row in rows)
    return text.getvalue().replace(f'"{EMPTY}"', "")


def save(path: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table into a file (``-``: stdout); raise ConfigError if that fails."""
    text = to_csv(header, rows)
    if path == "-":
        click.echo(text, nl=False)
    else:
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
