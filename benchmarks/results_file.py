"""Write measurements as readable JSON: one row a line, four significant digits."""

import json
from pathlib import Path
from typing import Any


def write(file: Path, results: Any) -> None:
    """Replace a file, whole or not at all."""
    part = file.with_suffix(".part")
    part.write_text(text(results) + "\n", encoding="utf-8")
    part.replace(file)


def text(value: Any, indent: str = "") -> str:
    """Return JSON with a line for each entry of a mapping and each row of a list."""
    inner = indent + " "
    if isinstance(value, dict) and any(
        isinstance(each, dict | list) for each in value.values()
    ):
        lines = (
            f"{inner}{json.dumps(key)}: {text(each, inner)}"
            for key, each in value.items()
        )
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(each, dict) for each in value):
        return (
            "[\n"
            + ",\n".join(inner + json.dumps(rounded(row)) for row in value)
            + f"\n{indent}]"
        )
    return json.dumps(rounded(value))


def rounded(value: Any) -> Any:
    """Return a value with its floats rounded to four significant digits."""
    match value:
        case float():
            return float(f"{value:.4g}")
        case dict():
            return {key: rounded(each) for key, each in value.items()}
        case list() | tuple():
            return [rounded(each) for each in value]
    return value
