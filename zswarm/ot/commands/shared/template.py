"""Write a commented experiment file: every key with its meaning, optional ones commented out."""

import inspect
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
import tomli_w

from zswarm import experiment
from zswarm.config import settings_docs
from zswarm.config.sections import ABSOLUTE
from zswarm.config.settings_docs import Key
from zswarm.plugins import registry
from zswarm.system.text import clean

WIDTH = 79
HEAD = """\
An experiment. Above each key stand its type, range and meaning. A line such as "#trials = 1" shows
the default of a key that is not set: remove the # to set it.
"""
RANGES = (
    "Instead of a value each of these may have a range, from which every trial draws: "
    "{ from = 5, to = 15 }, or { choice = [5, 10] }."
)


def blank(
    name: str, simulator: str, representation: str, optimizer: str
) -> dict[str, Any]:
    """Return the content of a file that sets only what has no default."""
    return {
        "name": name,
        "seed": 1,
        "generations": 100,
        "problem": {"simulator": simulator},
        "representation": {"kind": representation},
        "optimizer": {"kind": optimizer},
    }


def write(content: Mapping[str, Any]) -> str:
    """Write a file that sets what ``content`` sets, and explains everything else.

    Args:
        content: of a file that ``experiment.load`` takes.

    Raises:
        UnknownPlugin: a part that it names is not installed.
    """
    return "\n".join(_lines(content)).strip() + "\n"


def _lines(content: Mapping[str, Any]) -> Iterator[str]:
    yield from _comment(HEAD)
    yield ""
    top = experiment.top_level()
    yield from _keys(
        top, {key.name: content[key.name] for key in top if key.name in content}
    )
    for name, struct in experiment.TABLES.items():
        table, known = content.get(name, {}), settings_docs.keys(struct)
        yield from ("", f"[{name}]")
        if name == "problem":
            yield from _keys(
                [key for key in known if key.name != "settings"],
                {key: value for key, value in table.items() if key != "settings"},
            )
            loaded = registry.load("simulator", table["simulator"])
            yield ""
            yield from _comment((inspect.getdoc(loaded) or "").partition("\n\n")[0])
            yield from _comment(RANGES)
            yield "[problem.settings]"
            yield from _keys(
                settings_docs.keys(loaded.settings_type), table.get("settings", {})
            )
        elif name in experiment.PARTS:
            settings = dict(table)
            kind = settings.pop("kind", None)
            yield from _keys(known, {} if kind is None else {"kind": kind})
            loaded = registry.load(name, kind or ABSOLUTE)  # type: ignore[arg-type]  # PARTS are kinds
            yield from _keys(settings_docs.keys(loaded.settings_type), settings)
        else:
            yield from _keys(known, table)


def _keys(known: list[Key], table: Mapping[str, Any]) -> Iterator[str]:
    for key in known:
        yield from _comment(
            f"{key.type_text}: {key.meaning}" if key.meaning else key.type_text
        )
        if key.name in table:
            yield f"{_name(key.name)} = {_value(table[key.name])}"
        else:
            default = (
                "" if key.default is None else _value(msgspec.to_builtins(key.default))
            )
            yield f"#{_name(key.name)} = {default}".rstrip()
    names = {key.name for key in known}
    # Tables that a plug-in defines.
    for name in (name for name in table if name not in names):
        yield f"{_name(name)} = {_value(table[name])}"


def _comment(text: str) -> Iterator[str]:
    plain = settings_docs.plain(" ".join(text.split()))
    indent = {"initial_indent": "# ", "subsequent_indent": "# "}
    for line in textwrap.wrap(plain, WIDTH, break_on_hyphens=False, **indent):  # type: ignore[arg-type]
        yield clean(line)  # a plug-in's texts may contain anything


def _name(key: str) -> str:
    return tomli_w.dumps({key: 0}).rpartition(" = ")[0]


def _value(value: Any) -> str:
    """Write a value on one line, so that it can be commented out."""
    match value:
        case Mapping():
            items = ", ".join(
                f"{_name(key)} = {_value(item)}" for key, item in value.items()
            )
            return f"{{ {items} }}" if value else "{}"
        case list() | tuple():
            return f"[{', '.join(_value(item) for item in value)}]"
    return tomli_w.dumps({"value": value}).removeprefix("value = ").rstrip("\n")
