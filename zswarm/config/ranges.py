"""Ranges: settings of a simulator that differ from trial to trial (docs/experiment.md, "Ranges").

In ``[problem.settings]`` a range replaces a value: ``{ from = 5, to = 15 }`` or
``{ choice = [5, 10] }``. ``sims/randomized.py`` draws from it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from zswarm.config.decode import convert, value_at
from zswarm.errors import ConfigError

FORMS = ({"from", "to"}, {"choice"})
EXPECTED = "expected { from = 5, to = 15 } or { choice = [5, 10] }"
MAX_CHOICES = 100
MAX_DEPTH = 8  # of the tables that are searched for ranges; servers take no deeper ones
LARGEST = 8e307  # absolute value of an end: the width of a range must be finite

Path = tuple[str, ...]  # the keys that lead to a setting: mostly one


def is_range(value: Any) -> bool:
    """Return whether a setting's value is a range."""
    return isinstance(value, Mapping) and set(value) in FORMS


def ends(value: Any) -> Sequence[Any]:
    """Return both ends of a range, or each value of a choice; otherwise the value itself."""
    if not is_range(value):
        return (value,)
    values: Sequence[Any] = (
        value["choice"] if "choice" in value else (value["from"], value["to"])
    )
    return values


def words(value: Any) -> str:
    """Return ``5 to 15`` or ``5, 10 or 20``; a value that is not a range as JSON."""
    *others, last = (shown(end) for end in ends(value))
    return (
        f"{', '.join(others)} {'or' if 'choice' in value else 'to'} {last}"
        if others
        else last
    )


def name(path: Path) -> str:
    """Return a path with dots."""
    return ".".join(path)


def shown(value: Any) -> str:
    """Return a string as it is, another value as JSON."""
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()


def found(settings: Mapping[str, Any]) -> dict[Path, Mapping[str, Any]]:
    """Return the ranges in settings and their nested tables."""
    ranges: dict[Path, Mapping[str, Any]] = {}
    replaced(settings, ranges.setdefault)
    return ranges


def replaced(
    settings: Mapping[str, Any],
    replace: Callable[[Path, Mapping[str, Any]], Any],
    above: Path = (),
) -> dict[str, Any]:
    """Return the settings with ``replace(path, range)`` in place of each range."""
    result = {}
    for key, item in settings.items():
        path = (*above, key)
        if is_range(item):
            item = replace(path, item)
        elif isinstance(item, Mapping) and len(path) <= MAX_DEPTH:
            item = replaced(item, replace, path)
        result[key] = item
    return result


def complete(
    settings: Mapping[str, Any], struct: type[msgspec.Struct], where: str
) -> dict[str, Any]:
    """Return the settings with every default; numbers in ranges get the setting's type.

    Args:
        where: prefix of errors, such as ``experiment.toml: problem.settings``.
    """
    ranges = found(settings)
    for path, one in ranges.items():
        _check(one, f"{where}: {name(path)}", path)
    first = {path: ends(one)[0] for path, one in ranges.items()}
    whole = _completed(settings, first, struct, where)
    for path, one in ranges.items():
        typed = [
            value_at(
                _completed(settings, {**first, path: end}, struct, where, path), path
            )
            for end in ends(one)
        ]
        table = value_at(whole, path[:-1])
        table[path[-1]] = (
            {"choice": typed}
            if "choice" in one
            else dict(zip(("from", "to"), typed, strict=True))
        )
    return whole


def _completed(
    settings: Mapping[str, Any],
    values: Mapping[Path, Any],
    struct: type[msgspec.Struct],
    where: str,
    tried: Path = (),
) -> dict[str, Any]:
    """Return all settings, with ``values`` for ranges; errors name the value at ``tried``."""
    try:
        fixed = replaced(settings, lambda path, _: values[path])
        return dict(msgspec.to_builtins(convert(fixed, struct, where)))
    except ConfigError as error:
        key, text = name(tried or error.path), str(error)
        if error.path in values:
            text = f"{text} (in its range: {shown(values[error.path])})"
        elif tried:
            text = f"{text} (with {key} = {shown(values[tried])})"
        elif isinstance(value_at(settings, error.path), Mapping) and text.endswith(
            "got object"
        ):
            text = f"{where}: {key}: {EXPECTED}, or one value"
        raise ConfigError(text, error.path) from None


def _check(one: Mapping[str, Any], where: str, path: Path) -> None:
    if "choice" in one:
        choice = one["choice"]
        if not isinstance(choice, list | tuple) or not 1 <= len(choice) <= MAX_CHOICES:
            expected = f"expected a list of 1 to {MAX_CHOICES} values, such as [5, 10]"
            raise ConfigError(f"{where}: choice: {expected}", path)
        return
    for key, end in one.items():
        number = isinstance(end, int | float) and not isinstance(end, bool)
        if not number or not -LARGEST <= end <= LARGEST:
            expected = (
                f"expected a finite number, not {end!r:.40}; other values: choice = [...]"
            )
            raise ConfigError(f"{where}: {key}: {expected}", path)
    if one["from"] > one["to"]:
        raise ConfigError(
            f"{where}: from {one['from']} must not be above to {one['to']}", path
        )
