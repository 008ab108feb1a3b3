"""Make text from other machines and programs safe to show."""

import html
import unicodedata
from collections.abc import Mapping
from typing import Any

MAX_LENGTH = 500  # characters
NESTED = 32  # levels of tables and lists
# Unicode categories: controls, formats, surrogates, private use, unassigned, line separators.
UNSAFE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def clean(text: str) -> str:
    """Escape control and format characters, and limit the length: safe in terminals and logs."""
    if text.isascii() and text.isprintable():
        return text[:MAX_LENGTH]
    return "".join(map(_escaped, text))[:MAX_LENGTH]


def clean_all(value: Any, levels: int = NESTED) -> Any:
    """Return a value, table or list with its texts made safe to show.

    Raises:
        RecursionError: it is nested deeper than anything that zswarm writes.
    """
    if isinstance(value, str):
        return clean(value)
    if not isinstance(value, dict | list):
        return value
    if not levels:
        raise RecursionError(f"nested deeper than {NESTED} levels")
    if isinstance(value, dict):
        return {
            clean(str(key)): clean_all(item, levels - 1) for key, item in value.items()
        }
    return [clean_all(item, levels - 1) for item in value]


def _escaped(character: str) -> str:
    unsafe = unicodedata.category(character) in UNSAFE
    return f"\\x{ord(character):02x}" if unsafe else character


def html_table(rows: Mapping[str, str]) -> str:
    """Return a table of two columns, whose texts are escaped."""
    left = "style='text-align:left'"
    cells = "".join(
        f"<tr><th {left}>{html.escape(key)}</th><td {left}>{html.escape(value)}</td></tr>"
        for key, value in rows.items()
    )
    return f"<table>{cells}</table>"
