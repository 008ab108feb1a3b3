"""TOML files to mappings and these to structs, strictly: what does not fit is refused in one line that says why.

JSON to structs likewise, and mappings to JSON that strict readers take.
"""

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec

from zswarm.errors import ConfigError
from zswarm.nearest import nearest

T = TypeVar("T", bound=msgspec.Struct)


def read(path: Path) -> dict[str, Any]:
    """What a TOML file says.

    Raises:
        ConfigError: it cannot be read, or is no TOML.
    """
    try:
        return parse(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None


def parse(text: str) -> dict[str, Any]:
    """What a TOML text says.

    Raises:
        ValueError: it is no TOML, is nested too deep, or has a number of thousands of digits.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None


def overridden(path: Path | None, given: Mapping[str, Any], kind: type[T], program: str) -> T:
    """A program's options: those of a TOML file, where the command line does not say otherwise.

    Raises:
        ConfigError: the file cannot be read, or something is wrong in it or on the command line.
    """
    mapping: dict[str, Any] = read(path) if path else {}
    convert(mapping, kind, str(path))  # what is wrong in the file is wrong even where the command line overrides it
    return convert({**mapping, **given}, kind, str(path or program))


def convert(mapping: Mapping[str, Any], struct: type[T], where: str) -> T:
    """A struct from a mapping: unknown keys are refused with the nearest known one, nested structs included.

    Args:
        where: put before a key in an error, such as ``experiment.toml: problem``.

    Raises:
        ConfigError: unknown or missing key, wrong type, impossible value.
    """
    _refuse_unknown(mapping, struct, where)
    try:
        return msgspec.convert(mapping, struct, strict=True)
    except msgspec.ValidationError as error:
        path, what = _taken_apart(str(error), struct)
        told = f"{path}: {what}" if path else what
        keys = tuple(path.partition("[")[0].split(".")) if path else ()
        raise ConfigError(f"{where}: {told}", keys) from None


def from_json(body: bytes, struct: type[T], where: str) -> T:
    """A struct from JSON, as ``convert``.

    Raises:
        ConfigError: no JSON, no object, or as ``convert``.
    """
    try:
        mapping = msgspec.json.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise ConfigError(f"{where}: not JSON") from None
    if not isinstance(mapping, dict):
        raise ConfigError(f"{where}: not a JSON object")
    return convert(mapping, struct, where)


def to_json(values: Mapping[str, Any]) -> str:
    """One line; numbers that JSON does not have become null, times texts."""
    return json.dumps(_finite(values), default=str)


def _finite(value: Any) -> Any:
    match value:
        case Mapping():
            return {key: _finite(item) for key, item in value.items()}
        case list() | tuple():
            return [_finite(item) for item in value]
        case float() if not math.isfinite(value):
            return None
    return value


def _refuse_unknown(mapping: Mapping[str, Any], struct: type[msgspec.Struct], where: str, inside: tuple[str, ...] = ()) -> None:
    fields = {field.encode_name: field.type for field in msgspec.structs.fields(struct)}
    for key, value in mapping.items():
        if key not in fields:
            known = f"known are: {', '.join(fields)}" if fields else "there are none"
            raise ConfigError(f"{where}: unknown key {key!r}{nearest(key, fields)}; {known}", (*inside, key))
        kind = fields[key]
        if isinstance(value, Mapping) and isinstance(kind, type) and issubclass(kind, msgspec.Struct):
            _refuse_unknown(value, kind, f"{where}: {key}", (*inside, key))


def _taken_apart(text: str, struct: type[msgspec.Struct]) -> tuple[str, str]:
    """msgspec's "Expected `int`, got `str` - at `$.a.b`" as "a.b" and "expected int, got str"."""
    match = re.fullmatch(r"(?P<what>.*) - at `\$\.?(?P<path>.*)`", text, re.DOTALL)
    what, path = (match["what"], match["path"]) if match else (text, "")
    what = re.sub(r"^Object missing required field `(?P<key>.*)`$", r"key \g<key> is missing", what)
    if (word := re.fullmatch(r"Invalid enum value '(.*)'", what, re.DOTALL)) and (known := _choices(struct, path)):
        choices = " or ".join([", ".join(known[:-1]), known[-1]] if known[1:] else known)
        return path, f"expected {choices}, not '{word[1]}'{nearest(word[1], known)}"
    return path, what[0].lower() + what[1:].replace("`", "")


def _choices(struct: type[msgspec.Struct], path: str) -> list[str]:
    """The texts that a field may be; none where it cannot be told."""
    kind: Any = struct
    for key in path.split("."):
        if not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
            return []
        kind = next((field.type for field in msgspec.structs.fields(kind) if field.encode_name == key), None)
    return list(dict.fromkeys(_texts(kind)))


def _texts(kind: Any) -> Iterator[str]:
    if get_origin(kind) is Literal:
        yield from (text for text in get_args(kind) if isinstance(text, str))
        return
    for part in get_args(kind):
        yield from _texts(part)
    if kind in (int, float):
        yield "a number"
