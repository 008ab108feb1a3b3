"""A commented experiment file: every key with its meaning; what is optional is commented out with its default."""

import inspect
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
import tomli_w

from zswarm import experiment, plugins, settings_sheet
from zswarm.protocol.codec import clean
from zswarm.settings_sheet import Key

WIDTH = 79
HEAD = """\
An experiment. Each key has its meaning, type and range above it. A line such as "#trials = 1" shows the default of a key that
is not set: take the # away to set it.
"""
RANGES = (
    "Instead of a value each of these may have a range, from which every trial draws anew: { from = 5, to = 15 }, or "
    "{ choice = [5, 10] }."
)


def blank(name: str, simulator: str, representation: str, optimizer: str) -> dict[str, Any]:
    """The content of a file that sets only what has no default."""
    return {
        "name": name,
        "seed": 1,
        "generations": 100,
        "problem": {"simulator": simulator},
        "representation": {"kind": representation},
        "optimizer": {"kind": optimizer},
    }


def write(content: Mapping[str, Any]) -> str:
    """The text of a file that says what ``content`` says, and explains all the rest.

    Args:
        content: that of a file which ``experiment.load`` takes.

    Raises:
        UnknownPlugin: a part that it names is not installed.
    """
    return "\n".join(_lines(content)).strip() + "\n"


def _lines(content: Mapping[str, Any]) -> Iterator[str]:
    yield from _comment(HEAD)
    yield ""
    yield from _keys(top := experiment.top_level(), {key.name: content[key.name] for key in top if key.name in content})
    for name, struct in experiment.tables().items():
        table = content.get(name, {})
        yield ""
        yield f"[{name}]"
        if name == "problem":
            sheet = [key for key in settings_sheet.keys(struct) if key.name != "settings"]
            yield from _keys(sheet, {key: value for key, value in table.items() if key != "settings"})
            yield ""
            loaded = plugins.load("simulator", table["simulator"])
            yield from _comment((inspect.getdoc(loaded) or "").partition("\n\n")[0])
            yield from _comment(RANGES)
            yield "[problem.settings]"
            yield from _keys(settings_sheet.keys(loaded.settings_type), table.get("settings", {}))
        elif name in experiment.PARTS:
            said = {key: value for key, value in table.items() if key == "kind"}
            yield from _keys(settings_sheet.keys(struct), said)
            kind: plugins.Kind = name  # type: ignore[assignment]  # PARTS are kinds
            settings = {key: value for key, value in table.items() if key != "kind"}
            loaded = plugins.load(kind, said.get("kind", experiment.ABSOLUTE))
            yield from _keys(settings_sheet.keys(loaded.settings_type), settings)
        else:
            yield from _keys(settings_sheet.keys(struct), table)


def _keys(sheet: list[Key], table: Mapping[str, Any]) -> Iterator[str]:
    for key in sheet:
        yield from _comment(f"{key.type_text}: {key.meaning}" if key.meaning else key.type_text)
        if key.name in table:
            yield f"{_name(key.name)} = {_value(table[key.name])}"
        else:
            yield f"#{_name(key.name)} = {'' if key.default is None else _value(msgspec.to_builtins(key.default))}".rstrip()
    known = {key.name for key in sheet}
    for name in (name for name in table if name not in known):  # tables of a plug-in's own
        yield f"{_name(name)} = {_value(table[name])}"


def _comment(text: str) -> Iterator[str]:
    plain = settings_sheet.plain(" ".join(text.split()))
    lines = textwrap.wrap(plain, WIDTH, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False)
    yield from (clean(line) for line in lines)  # a plug-in's texts may hold anything


def _name(key: str) -> str:
    return tomli_w.dumps({key: 0}).rpartition(" = ")[0]


def _value(value: Any) -> str:
    """On one line, so that it can be commented out."""
    match value:
        case Mapping():
            return "{ " + ", ".join(f"{_name(key)} = {_value(item)}" for key, item in value.items()) + " }" if value else "{}"
        case list() | tuple():
            return "[" + ", ".join(_value(item) for item in value) + "]"
    return tomli_w.dumps({"value": value}).removeprefix("value = ").rstrip("\n")
