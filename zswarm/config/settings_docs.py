"""Describe the keys of a settings struct: type and range, default and meaning.

The struct is the only source: its annotations limit a key, and ``Meta(description=...)`` explains
it in Markdown. ``zswarm-ot init`` and the tables of docs/experiment.md are made from it.
"""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect

from zswarm.config import meta, ranges


class Key(NamedTuple):
    """A key of a settings struct."""

    name: str
    type_text: str  # such as "int, 1 to 100,000"
    default: Any  # msgspec.NODEFAULT: required
    meaning: str  # Markdown
    only_with: Mapping[
        str, Any
    ] = {}  # values of other keys without which it has no effect

    @property
    def required(self) -> bool:
        """Return whether there is no default."""
        return self.default is msgspec.NODEFAULT


def keys(struct: type[msgspec.Struct]) -> list[Key]:
    """Return the keys of a struct in order, without those that are structs themselves."""
    info = inspect.type_info(struct)
    assert isinstance(info, inspect.StructType)  # noqa: S101  of a struct
    fields = [(field, *_without_metadata(field.type)) for field in info.fields]
    return [
        _key(field, kind, notes)
        for field, kind, notes in fields
        if not isinstance(kind, inspect.StructType)
    ]


def unused(struct: type[msgspec.Struct], values: Mapping[str, Any]) -> set[str]:
    """Return the keys that have no effect with these values, some of which may be ranges."""
    return {
        key.name
        for key in keys(struct)
        for other, needed in key.only_with.items()
        if needed not in ranges.ends(values.get(other, needed))
    }


def markdown(sheet: Sequence[Key]) -> str:
    """Return a table of keys, or an empty string if there are none."""
    lines = ["| key | type | default | meaning |", "| --- | --- | --- | --- |"]
    for key in sheet:
        default = "required" if key.required else json.dumps(key.default)
        cells = [f"`{key.name}`", key.type_text, default, key.meaning.replace("|", r"\|")]
        lines.append(" | ".join(["", *cells, ""]).strip().replace("|  |", "| |"))
    return "\n".join(lines) + "\n" if sheet else ""


def plain(text: str) -> str:
    """Return Markdown without the marks of links and code."""
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).replace("`", "")


def _key(field: inspect.Field, kind: inspect.Type, notes: dict[str, Any]) -> Key:
    default = field.default
    if field.default_factory is not msgspec.NODEFAULT:
        default = field.default_factory()
    type_text = notes.get("type") or _type_text(kind)
    meaning, only_with = notes.get("description", ""), notes.get(meta.ONLY_WITH, {})
    return Key(field.encode_name, type_text, default, meaning, only_with)


def _without_metadata(kind: inspect.Type) -> tuple[inspect.Type, dict[str, Any]]:
    """Return the type inside of annotations, and what these say; the outermost wins."""
    notes: dict[str, Any] = {}
    while isinstance(kind, inspect.Metadata):
        notes = {**(kind.extra_json_schema or {}), **(kind.extra or {}), **notes}
        kind = kind.type
    return kind, notes


def _type_text(kind: inspect.Type) -> str:
    *others, last = _alternatives(kind) or ["value"]
    return f"{', '.join(others)} or {last}" if others else last


def _alternatives(kind: inspect.Type) -> list[str]:
    kind, _ = _without_metadata(kind)
    match kind:
        case inspect.IntType() | inspect.FloatType():
            return [_number_text(kind)]
        case inspect.LiteralType(values=values):
            return [json.dumps(value) for value in values]
        case inspect.ListType(item_type=item) if not isinstance(item, inspect.AnyType):
            return [f"list of {_type_text(item).partition(',')[0]}s"]
        case inspect.UnionType(types=types):
            literals_first = sorted(
                types, key=lambda one: not isinstance(one, inspect.LiteralType)
            )
            return [text for one in literals_first for text in _alternatives(one)]
    return NAMES.get(type(kind), ["value"])


NAMES: dict[type, list[str]] = {
    inspect.BoolType: ["bool"],
    inspect.DictType: ["table"],
    inspect.ListType: ["list"],
    inspect.NoneType: [],
    inspect.StrType: ["text"],
}


def _number_text(kind: inspect.IntType | inspect.FloatType) -> str:
    at_least, above, at_most, below = kind.ge, kind.gt, kind.le, kind.lt
    name = "float"
    if isinstance(kind, inspect.IntType):
        name = "int"
        at_least, above = (at_least if above is None else above + 1), None
        at_most, below = (at_most if below is None else below - 1), None
    high = _limit("", at_most, "below ", below)
    low = _limit("" if high else "from ", at_least, "above ", above)
    if not low:
        high = _limit("up to ", at_most, "below ", below)
        return f"{name}, {high}" if high else name
    joint = " to " if above is None else ", to "
    return f"{name}, {low}{joint}{high}" if high else f"{name}, {low}"


def _limit(
    word: str, inclusive: float | None, other: str, exclusive: float | None
) -> str:
    if exclusive is not None:
        return other + _figure(exclusive)
    return "" if inclusive is None else word + _figure(inclusive)


def _figure(value: float) -> str:
    """Return a number with thousands separated, long powers of ten and two as powers."""
    if value != int(value):
        return f"{value:g}"
    whole = int(value)
    if abs(whole) < 10**9 and isinstance(value, int):
        return f"{whole:,}"
    if (text := str(whole)).rstrip("0") == "1" and len(text) > 4:
        return f"10^{len(text) - 1}"
    for rest in (0, 1, 2):
        if (whole + rest).bit_count() == 1 and whole >= 2**30:
            return f"2^{(whole + rest).bit_length() - 1}" + (f" - {rest}" if rest else "")
    return f"{whole:,}"
