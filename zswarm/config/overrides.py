"""Changes to the mapping of a TOML file: ``--set a.b=value``, and values by dotted paths."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from zswarm.config import ranges
from zswarm.config.decode import parse
from zswarm.errors import ConfigError

MAX_DEPTH = 10  # of nested tables


def parse_override(override: str) -> tuple[str, Any]:
    """Return the path and the value of ``a.b=value``; a value that is not TOML is a string."""
    path, equals, text = override.partition("=")
    if not equals or not path.strip():
        raise ConfigError(
            f"--set {override}: expected key=value, such as optimizer.population=100"
        )
    try:
        value = parse(f"value = {text}")["value"]
    except ValueError:
        value = text
    return path.strip(), value


def set_value(mapping: dict[str, Any], path: str, value: Any, where: str) -> None:
    """Set the value at a dotted path, creating the tables that are missing."""
    *tables, key = path.split(".")
    for table in tables:
        mapping = mapping.setdefault(table, {})
        if not isinstance(mapping, dict):
            raise ConfigError(f"{where}: {table} is not a table")
    mapping[key] = plain(value)


def changed(
    mapping: Mapping[str, Any], values: Mapping[str, Any], where: str
) -> dict[str, Any]:
    """Return a copy of a mapping with the given values by dotted path; errors as ``set_value``."""
    copy: dict[str, Any] = plain(mapping)
    for path, value in values.items():
        set_value(copy, str(path), value, f"{where}: {path}")
    return copy


@contextlib.contextmanager
def blamed(given: Sequence[tuple[str, str]], where: str) -> Iterator[None]:
    """Report an error in a value that was given with the words that gave it, not with the file.

    Args:
        given: keys, and words such as ``--set a.b=1``; the last ones that fit are named.
        where: the file in errors.
    """
    try:
        yield
    except ConfigError as error:
        key, text = ".".join(error.path), str(error)
        for changed, words in reversed(given) if text.startswith(f"{where}: ") else ():
            if f"{key}.".startswith(f"{changed}."):
                text = f"{words}{text.removeprefix(where)}"
                raise type(error)(text, error.path) from error
        raise


def plain(value: Any) -> Any:
    """Copy a value as a TOML file would hold it: NumPy's numbers and arrays become Python's."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    return (
        [plain(item) for item in value]
        if isinstance(value, (list, tuple, range))
        else value
    )


def with_flat_study(mapping: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Return a file's mapping with dotted paths in place of nested tables in its study."""
    study = mapping.get("study")
    if not isinstance(study, Mapping):
        return mapping
    flat = dict(study)
    if isinstance(grid := flat.get("grid"), Mapping):
        flat["grid"] = _by_path(grid, f"{where}: study.grid")
    if isinstance(variants := flat.get("variants"), Mapping):
        at = f"{where}: study.variants"
        flat["variants"] = {
            name: _by_path(row, f"{at}.{name}") if isinstance(row, Mapping) else row
            for name, row in variants.items()
        }
    if isinstance(rows := flat.get("list"), list):
        at = f"{where}: study.list"
        flat["list"] = [
            _by_path(row, at) if isinstance(row, Mapping) else row for row in rows
        ]
    return {**mapping, "study": flat}


def _by_path(tables: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the values of nested tables by dotted path. A range is one value."""
    flat: dict[str, Any] = {}
    for path, value in _leaves(tables, "", where):
        if path in flat:
            raise ConfigError(f"{where}: {path} is given twice")
        flat[path] = value
    return flat


def _leaves(
    tables: Mapping[str, Any], prefix: str, where: str
) -> Iterator[tuple[str, Any]]:
    if prefix.count(".") > MAX_DEPTH:
        raise ConfigError(f"{where}: nested too deep")
    for key, value in tables.items():
        if isinstance(value, Mapping) and not ranges.is_range(value):
            yield from _leaves(value, f"{prefix}{key}.", where)
        else:
            yield f"{prefix}{key}", value
