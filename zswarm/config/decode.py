"""Decode TOML and JSON strictly to structs: each error is one line naming what was expected.

All functions raise ``ConfigError``, except ``parse``.
"""

import functools
import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeGuard, TypeVar, get_args, get_origin

import msgspec

from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError

T = TypeVar("T", bound=msgspec.Struct)


def read(path: Path) -> dict[str, Any]:
    """Read a TOML file; a byte order mark, as Windows' Notepad writes it, is skipped."""
    try:
        return parse(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None


def parse(text: str) -> dict[str, Any]:
    """Parse TOML; raise ``ValueError`` if it is not, or nested too deep."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None


def overridden(
    path: Path | None, given: Mapping[str, Any], kind: type[T], program: str
) -> T:
    """Return a program's options: those of a TOML file, overridden by those of the command line.

    Args:
        given: from click; None and () stand for options that were not given.
    """
    mapping: dict[str, Any] = read(path) if path else {}
    # Refuse a mistake in the file even if it is overridden.
    convert(mapping, kind, str(path))
    mapping |= {name: value for name, value in given.items() if value not in (None, ())}
    return convert(mapping, kind, str(path or program))


def convert(mapping: Mapping[str, Any], struct: type[T], where: str) -> T:
    """Convert a mapping to a struct. Unknown keys are refused, in nested structs too.

    Args:
        where: prefix of errors, such as ``experiment.toml: problem``.
    """
    _refuse_unknown(mapping, struct, where)
    try:
        return msgspec.convert(mapping, struct, strict=True)
    except msgspec.ValidationError as error:
        path, text = _path_and_text(str(error), struct)
        keys = tuple(path.partition("[")[0].split(".")) if path else ()
        raise ConfigError(": ".join(filter(None, (where, path, text))), keys) from None


def from_json(body: bytes | str, struct: type[T], where: str) -> T:
    """Convert a JSON object to a struct."""
    try:
        mapping = msgspec.json.decode(body)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        raise ConfigError(f"{where}: not JSON") from None
    if not isinstance(mapping, dict):
        raise ConfigError(f"{where}: not a JSON object")
    return convert(mapping, struct, where)


def to_json(values: Mapping[str, Any]) -> str:
    """Encode as one line of strict JSON: NaN and infinity become null, times become strings."""
    return json.dumps(_finite(values), default=str)


def value_at(mapping: Any, path: Sequence[str]) -> Any:
    """Return the value at a path of keys, or None."""
    for key in path:
        mapping = mapping.get(key) if isinstance(mapping, Mapping) else None
    return mapping


def is_struct(kind: Any) -> TypeGuard[type[msgspec.Struct]]:
    """Return whether a type is a struct."""
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _finite(value: Any) -> Any:
    match value:
        case Mapping():
            return {key: _finite(item) for key, item in value.items()}
        case list() | tuple():
            return [_finite(item) for item in value]
        case float() if not math.isfinite(value):
            return None
    return value


def _refuse_unknown(
    mapping: Mapping[str, Any],
    struct: type[msgspec.Struct],
    where: str,
    path: tuple[str, ...] = (),
) -> None:
    fields = _types(struct)
    for key, value in mapping.items():
        full = (*path, key)
        if key not in fields:
            known = f"known are: {', '.join(fields)}" if fields else "there are none"
            meant = _in_a_table(key, mapping, fields) or nearest(key, fields)
            raise ConfigError(f"{where}: unknown key {key!r}{meant}; {known}", full)
        if isinstance(value, Mapping) and is_struct(fields[key]):
            _refuse_unknown(value, fields[key], f"{where}: {key}", full)


def _in_a_table(key: str, mapping: Mapping[str, Any], fields: Mapping[str, Any]) -> str:
    """Return `` (did you mean 'table.key'?)`` if a table may have the key, or has it, else ""."""
    for table, kind in fields.items():
        value = mapping.get(table)
        below = value if isinstance(value, Mapping) else {}
        inner = [
            name
            for name, part in below.items()
            if isinstance(part, Mapping) and key in part
        ]
        if key in {*below, *(_types(kind) if is_struct(kind) else ())}:
            return f" (did you mean {f'{table}.{key}'!r}?)"
        if inner:
            return f" (did you mean {f'{table}.{inner[0]}.{key}'!r}?)"
    return ""


@functools.cache
def _types(struct: type[msgspec.Struct]) -> dict[str, Any]:
    """Return the types of a struct's fields; a list of runs reads hundreds of files."""
    found = {}
    for field in msgspec.structs.fields(struct):
        described = get_origin(field.type) is Annotated
        found[field.encode_name] = get_args(field.type)[0] if described else field.type
    return found


def _path_and_text(message: str, struct: type[msgspec.Struct]) -> tuple[str, str]:
    """Split msgspec's "Expected `int`, got `str` - at `$.a.b`" in "a.b" and "expected int, ..."."""
    match = re.fullmatch(r"(?P<text>.*) - at `\$\.?(?P<path>.*)`", message, re.DOTALL)
    text, path = (match["text"], match["path"]) if match else (message, "")
    text = re.sub(
        r"^Object missing required field `(?P<key>.*)`$", r"key \g<key> is missing", text
    )
    word = re.fullmatch(r"Invalid enum value '(.*)'", text, re.DOTALL)
    if word and (known := _choices(struct, path)):
        choices = " or ".join([", ".join(known[:-1]), known[-1]] if known[1:] else known)
        return path, f"expected {choices}, not '{word[1]}'{nearest(word[1], known)}"
    return path, text[0].lower() + text[1:].replace("`", "")


def _choices(struct: type[msgspec.Struct], path: str) -> list[str]:
    """Return the strings that a field may be; empty if it is not in nested structs."""
    kind: Any = struct
    for key in path.split("."):
        if not is_struct(kind):
            return []
        kind = _types(kind).get(key)
    return list(dict.fromkeys(_strings(kind)))


def _strings(kind: Any) -> Iterator[str]:
    if get_origin(kind) is Literal:
        yield from (text for text in get_args(kind) if isinstance(text, str))
        return
    for part in get_args(kind):
        yield from _strings(part)
    if kind in (int, float):
        yield "a number"
