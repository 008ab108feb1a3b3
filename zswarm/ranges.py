"""Ranges: settings of a simulator that differ from trial to trial (docs/experiment.md, "Ranges").

In ``[problem.settings]`` a range stands in the place of a value: ``{ from = 5, to = 15 }`` or ``{ choice = [5, 10] }``. Here is
what may be written; ``varied`` draws from it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from zswarm.errors import ConfigError
from zswarm.strict import convert

FORMS = ({"from", "to"}, {"choice"})
EXPECTED = "expected { from = 5, to = 15 } or { choice = [5, 10] }"
MAX_CHOICES = 100
DEEPEST = 8  # tables in tables where ranges are looked for; servers take no deeper ones
FARTHEST = 8e307  # an end from 0, so that the width of a range is finite

Path = tuple[str, ...]  # the keys that lead to a setting: mostly one


def is_range(value: Any) -> bool:
    """Whether a setting's value is a range."""
    return isinstance(value, Mapping) and set(value) in FORMS


def ends(value: Any) -> Sequence[Any]:
    """The least and the greatest number that a setting has, or each value of a choice; of no range the value itself."""
    if not is_range(value):
        return (value,)
    listed: Sequence[Any] = value["choice"] if "choice" in value else (value["from"], value["to"])
    return listed


def words(value: Any) -> str:
    """``5 to 15``, ``5, 10 or 20``; a value that is no range as JSON."""
    *others, last = (shown(end) for end in ends(value))
    return f"{', '.join(others)} {'or' if 'choice' in value else 'to'} {last}" if others else last


def name(path: Path) -> str:
    """A setting's path for people."""
    return ".".join(path)


def shown(value: Any) -> str:
    """A value for people."""
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()


def found(settings: Mapping[str, Any]) -> dict[Path, Mapping[str, Any]]:
    """The ranges among settings, also in tables of theirs."""
    ranges: dict[Path, Mapping[str, Any]] = {}
    replaced(settings, lambda path, one: ranges.setdefault(path, one))
    return ranges


def replaced(settings: Mapping[str, Any], value: Callable[[Path, Mapping[str, Any]], Any], above: Path = ()) -> dict[str, Any]:
    """The settings with something else in the place of each range.

    Args:
        value: what, from the path and the range.
    """
    return {
        key: value((*above, key), item)
        if is_range(item)
        else replaced(item, value, (*above, key))
        if isinstance(item, Mapping) and len(above) < DEEPEST
        else item
        for key, item in settings.items()
    }


def complete(settings: Mapping[str, Any], struct: type[msgspec.Struct], where: str) -> dict[str, Any]:
    """The settings with every default written out; a range has its numbers as the setting takes them: 1 may become 1.0.

    Args:
        where: put before a key in an error, such as ``experiment.toml: problem.settings``.

    Raises:
        ConfigError: a range that is none, or one of its ends is impossible; or as ``convert``.
    """
    ranges = found(settings)
    for path, one in ranges.items():
        _check(one, f"{where}: {name(path)}", path)
    first = {path: ends(one)[0] for path, one in ranges.items()}
    whole = _plain(settings, first, struct, where)
    for path, one in ranges.items():
        taken = [_at(_plain(settings, {**first, path: end}, struct, where, path), path) for end in ends(one)]
        table = _at(whole, path[:-1])
        table[path[-1]] = {"choice": taken} if "choice" in one else {"from": taken[0], "to": taken[1]}
    return whole


def _plain(
    settings: Mapping[str, Any], values: Mapping[Path, Any], struct: type[msgspec.Struct], where: str, tried: Path = ()
) -> dict[str, Any]:
    """All settings, with values in the place of ranges."""
    try:
        plain: dict[str, Any] = msgspec.to_builtins(convert(replaced(settings, lambda path, _: values[path]), struct, where))
    except ConfigError as error:
        key, text = name(tried or error.path), str(error)
        if error.path in values:
            text = f"{text} (in its range: {shown(values[error.path])})"
        elif tried:
            text = f"{text} (with {key} = {shown(values[tried])})"
        elif isinstance(_at(settings, error.path), Mapping) and text.endswith("got object"):
            text = f"{where}: {key}: {EXPECTED}, or one value"
        raise ConfigError(text, error.path) from None
    return plain


def _at(settings: Any, path: Path) -> Any:
    """What is at a path, None where nothing is."""
    for key in path:
        settings = settings.get(key) if isinstance(settings, Mapping) else None
    return settings


def _check(one: Mapping[str, Any], where: str, path: Path) -> None:
    if "choice" in one:
        choice = one["choice"]
        if not isinstance(choice, list | tuple) or not 1 <= len(choice) <= MAX_CHOICES:
            raise ConfigError(f"{where}: choice: expected a list of 1 to {MAX_CHOICES} values, such as [5, 10]", path)
        return
    low, high = one["from"], one["to"]
    for key, end in one.items():
        if not isinstance(end, int | float) or isinstance(end, bool) or not -FARTHEST <= end <= FARTHEST:
            raise ConfigError(f"{where}: {key}: expected a finite number, not {end!r:.40}; other values: choice = [...]", path)
    if low > high:
        raise ConfigError(f"{where}: from {low} must not be above to {high}", path)
