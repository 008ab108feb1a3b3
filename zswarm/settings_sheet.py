"""What the keys of a settings struct are, in words: their type and range, default and meaning.

The struct is the one source: its annotations bound a key, and ``Meta(description=...)`` says what it means, in Markdown.
``zswarm-ot init`` writes comments of it, and the tables of docs/experiment.md are the same.
"""

import json
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect


class Key(NamedTuple):
    """A key of a settings struct."""

    name: str
    type_text: str  # such as "int, 1 to 100,000"
    default: Any  # msgspec.NODEFAULT: it is required
    meaning: str  # Markdown; "" where its author said nothing

    @property
    def required(self) -> bool:
        """Whether there is no default."""
        return self.default is msgspec.NODEFAULT


def keys(struct: type[msgspec.Struct]) -> list[Key]:
    """The keys in their order, those that are tables of their own left out."""
    info = inspect.type_info(struct)
    assert isinstance(info, inspect.StructType)  # noqa: S101  of a struct
    return [_key(field) for field in info.fields if not isinstance(_bare(field.type), inspect.StructType)]


def markdown(sheet: Sequence[Key]) -> str:
    """Keys as a table; nothing where there are none."""
    lines = ["| key | type | default | meaning |", "| --- | --- | --- | --- |"]
    for key in sheet:
        default = "required" if key.required else json.dumps(key.default)
        cells = [f"`{key.name}`", key.type_text, default, key.meaning.replace("|", r"\|")]
        lines.append(" | ".join(["", *cells, ""]).strip().replace("|  |", "| |"))
    return "\n".join(lines) + "\n" if sheet else ""


def plain(text: str) -> str:
    """Markdown without its marks for links and code."""
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).replace("`", "")


def _key(field: inspect.Field) -> Key:
    default = field.default
    if field.default_factory is not msgspec.NODEFAULT:
        default = field.default_factory()
    said: dict[str, Any] = {}
    kind = field.type
    while isinstance(kind, inspect.Metadata):  # the outermost says it
        said = {**(kind.extra_json_schema or {}), **(kind.extra or {}), **said}
        kind = kind.type
    return Key(field.encode_name, said.get("type") or _words(kind), default, said.get("description", ""))


def _bare(kind: inspect.Type) -> inspect.Type:
    while isinstance(kind, inspect.Metadata):
        kind = kind.type
    return kind


def _words(kind: inspect.Type) -> str:
    kind = _bare(kind)
    match kind:
        case inspect.BoolType():
            return "bool"
        case inspect.IntType() | inspect.FloatType():
            return _number(kind)
        case inspect.StrType():
            return "text"
        case inspect.LiteralType(values=values):
            return _either([json.dumps(value) for value in values])
        case inspect.ListType(item_type=item):
            return "list" if isinstance(item, inspect.AnyType) else f"list of {_words(item).partition(',')[0]}s"
        case inspect.DictType():
            return "table"
        case inspect.UnionType(types=types):
            parts = [_words(each) for each in types if not isinstance(each, inspect.NoneType)]
            literals = [json.dumps(value) for each in types if isinstance(each, inspect.LiteralType) for value in each.values]
            others = [part for part, each in zip(parts, types, strict=False) if not isinstance(each, inspect.LiteralType)]
            return _either([*literals, *others])
    return "value"


def _number(kind: inspect.IntType | inspect.FloatType) -> str:
    whole = isinstance(kind, inspect.IntType)
    low = "" if kind.ge is None else _figure(kind.ge)
    if kind.gt is not None:
        low = _figure(kind.gt + 1) if whole else f"above {_figure(kind.gt)}"
    high = "" if kind.le is None else _figure(kind.le)
    if kind.lt is not None:
        high = _figure(kind.lt - 1) if whole else f"below {_figure(kind.lt)}"
    name = "int" if whole else "float"
    if low and high:
        return f"{name}, {low} to {high}" if kind.gt is None or whole else f"{name}, {low}, to {high}"
    if low:
        return f"{name}, {low}" if low.startswith("above") else f"{name}, from {low}"
    if high:
        return f"{name}, {high}" if high.startswith("below") else f"{name}, up to {high}"
    return name


def _figure(value: float) -> str:
    """Powers of ten and two as such where they are long."""
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


def _either(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
