"""Describe the installed parts of experiments, by the docstrings and settings of their classes."""

import contextlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from zswarm import experiment
from zswarm.config import settings_docs
from zswarm.config.settings_docs import Key
from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.plugins import manifests, registry
from zswarm.system.text import clean

KINDS = tuple(registry.BUNDLED)
# A line of a docstring that begins a paragraph without an empty line above it.
TITLED = re.compile(r"[A-Z][^.:]{0,40}:( |$)|- |\d\. ")


class CatalogEntry(NamedTuple):
    """An installed part; its texts are safe to print."""

    kind: registry.Kind
    name: str
    about: str = ""  # the first paragraph of its docstring
    reference: tuple[str, ...] = ()  # its other paragraphs, then those of its module
    settings: tuple[Key, ...] = ()
    # Attributes of its class, such as ("portable", True).
    facts: tuple[tuple[str, Any], ...] = ()
    unstarted: bool = False  # a program that was not started: only its manifest is known
    error: str = ""  # why it cannot be used; then nothing else is known


def installed() -> list[CatalogEntry]:
    """Return all parts, kind by kind, sorted by name; programs are not started."""
    return [_described(kind, name) for kind in KINDS for name in registry.names(kind)]


def plugged() -> list[CatalogEntry]:
    """Return the parts that are not bundled, as `installed` does; no bundled one is imported."""
    return [
        _described(kind, name)
        for kind in KINDS
        for name in registry.names(kind)
        if name not in registry.BUNDLED[kind]
    ]


def find(name: str) -> list[CatalogEntry]:
    """Return the parts of a name: a representation may have the same name as an optimizer.

    Raises:
        UnknownPlugin: there is no such part.
    """
    found = [entry(kind, name) for kind in KINDS if name in registry.names(kind)]
    if found:
        return found
    shown = clean(name)
    if name in {path.stem for path in experiment.examples_folder().glob("*.toml")}:
        raise UnknownPlugin(
            f"{shown} is not a part but an example; zswarm-ot check {shown} explains it"
        )
    hint = nearest(name, {known for kind in KINDS for known in registry.names(kind)})
    raise UnknownPlugin(
        f"no part is named {shown!r}{hint}; zswarm-ot list shows all parts"
    )


def entry(kind: registry.Kind, name: str) -> CatalogEntry:
    """Import a part and describe it, or the error that it raises."""
    try:
        loaded = registry.load(kind, name)
        about, *reference = _paragraphs(inspect.getdoc(loaded) or "")
        reference += _paragraphs(inspect.getdoc(sys.modules[loaded.__module__]) or "")
        settings = tuple(
            _cleaned(key) for key in settings_docs.keys(loaded.settings_type)
        )
        facts = tuple(_facts(kind, loaded))
        return CatalogEntry(
            kind, clean(name), about, tuple(filter(None, reference)), settings, facts
        )
    # A plug-in's code may raise anything; the others are shown all the same.
    except (Exception, SystemExit) as error:
        text = " ".join(f"{error}".split()) or type(error).__name__
        return CatalogEntry(kind, clean(name), error=clean(text))


def _described(kind: registry.Kind, name: str) -> CatalogEntry:
    manifest = registry.foreign(kind).get(name)
    return _from_manifest(kind, name, manifest) if manifest else entry(kind, name)


def _from_manifest(kind: registry.Kind, name: str, path: Path) -> CatalogEntry:
    try:
        about = clean(manifests.read(path).description)
        return CatalogEntry(kind, clean(name), about, unstarted=True)
    except ConfigError as error:
        return CatalogEntry(kind, clean(name), error=clean(str(error)))


def as_object(part: CatalogEntry) -> dict[str, Any]:
    """Return everything that is known of a part, for JSON."""
    settings = [
        {
            "name": key.name,
            "type": key.type_text,
            "default": None if key.required else key.default,
            "required": key.required,
            "meaning": key.meaning,
        }
        for key in part.settings
    ]
    return {
        "kind": part.kind,
        "name": part.name,
        "about": part.about,
        "error": part.error,
        "sheet": list(part.reference),
        "settings": settings,
        **dict(part.facts),
    }


def settings_line(keys: tuple[Key, ...]) -> str:
    """Return all settings with their defaults, such as ``steps=50 task="aggregation"``."""
    return " ".join(f"{key.name}={default(key)}" for key in keys)


def default(key: Key) -> str:
    """Return a default as it is written in an experiment file, or "required"."""
    return (
        "required" if key.required else clean(msgspec.json.encode(key.default).decode())
    )


def _paragraphs(text: str) -> list[str]:
    """Return the paragraphs of a docstring, without line breaks and markup."""
    first, *lines = settings_docs.plain(text).splitlines() or [""]
    paragraphs = [clean(first)]
    begins = False
    for line in lines:
        words = clean(line.strip())
        if words and (begins or (not line.startswith(" ") and TITLED.match(line))):
            paragraphs.append(words)
        elif words:
            paragraphs[-1] += " " + words
        begins = not words
    return paragraphs


def _cleaned(key: Key) -> Key:
    meaning = clean(settings_docs.plain(key.meaning))
    return Key(clean(key.name), clean(key.type_text), key.default, meaning)


def _facts(kind: registry.Kind, loaded: Any) -> Iterator[tuple[str, Any]]:
    match kind:
        case "simulator":
            built = loaded
            # What it senses may depend on its settings: show the defaults, where it can be built,
            # but do not load the libraries of an adapter, which takes seconds.
            if not hasattr(sys.modules[loaded.__module__], "LIBRARIES"):
                with contextlib.suppress(Exception):
                    built = loaded(loaded.settings_type())
            for name in ("metrics", "sensors", "actuators"):
                yield name, [clean(str(each)) for each in getattr(built, name)]
            for name in ("participants", "inputs", "outputs"):
                if isinstance(number := getattr(built, name, None), int):
                    yield name, number
            yield "repeatable", bool(built.repeatable)
        case "optimizer":
            yield "portable", bool(loaded.portable)
            yield "competes", bool(loaded.competes)
        case "ranking":
            yield "relative", bool(loaded.relative)
