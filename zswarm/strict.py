"""Mappings to structs, strictly: what does not fit is refused with the key, what was expected and the nearest key."""

import re
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from zswarm.errors import ConfigError
from zswarm.plugins import nearest

T = TypeVar("T", bound=msgspec.Struct)


def convert(mapping: Mapping[str, Any], struct: type[T], where: str) -> T:
    """A struct from a mapping, nested structs included.

    Args:
        where: put before a key in an error, such as ``experiment.toml: problem``.

    Raises:
        ConfigError: unknown or missing key, wrong type, impossible value.
    """
    _refuse_unknown(mapping, struct, where)
    try:
        return msgspec.convert(mapping, struct, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{where}: {_plain(str(error))}") from None


def _refuse_unknown(mapping: Mapping[str, Any], struct: type[msgspec.Struct], where: str) -> None:
    fields = {field.encode_name: field.type for field in msgspec.structs.fields(struct)}
    for key, value in mapping.items():
        if key not in fields:
            raise ConfigError(f"{where}: unknown key {key!r}{nearest(key, fields)}; known are: {', '.join(fields)}")
        kind = fields[key]
        if isinstance(value, Mapping) and isinstance(kind, type) and issubclass(kind, msgspec.Struct):
            _refuse_unknown(value, kind, f"{where}: {key}")


def _plain(text: str) -> str:
    """msgspec's "Expected `int`, got `str` - at `$.a.b`" as "a.b: expected int, got str"."""
    match = re.fullmatch(r"(?P<what>.*) - at `\$\.?(?P<path>.*)`", text)
    what, path = (match["what"], match["path"]) if match else (text, "")
    what = what[0].lower() + what[1:].replace("`", "")
    return f"{path}: {what}" if path else what
