"""What the parts of experiments are: their data sheets and settings, read from the classes that are installed."""

import contextlib
import inspect
import re
import sys
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from zswarm import experiment, manifests, plugins, settings_sheet
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.nearest import nearest
from zswarm.protocol.codec import clean
from zswarm.settings_sheet import Key

KINDS = tuple(plugins.BUNDLED)
TITLED = re.compile(r"[A-Z][^.:]{0,40}:( |$)|- |\d\. ")  # a line of a data sheet that begins something new


class Part(NamedTuple):
    """A part that is installed; texts are cleaned."""

    kind: plugins.Kind
    name: str
    about: str = ""  # the first line of its data sheet
    sheet: tuple[str, ...] = ()  # the rest, then the text of its module, in paragraphs
    settings: tuple[Key, ...] = ()
    facts: tuple[tuple[str, Any], ...] = ()  # what its class states, such as ("portable", True)
    unasked: bool = False  # it is a program, which was not started: its manifest is all that is known
    error: str = ""  # why it cannot be used; then nothing else is known


def installed() -> list[Part]:
    """All parts, kind after kind, by name; of programs what their manifests say."""
    programs = {kind: plugins.foreign(kind) for kind in KINDS}
    return [
        _by_manifest(kind, name, programs[kind][name]) if name in programs[kind] else part(kind, name)
        for kind in KINDS
        for name in plugins.names(kind)
    ]


def find(name: str) -> list[Part]:
    """The parts of a name: a representation may be called as an optimizer is.

    Raises:
        UnknownPlugin: there is none.
    """
    found = [part(kind, name) for kind in KINDS if name in plugins.names(kind)]
    if not found:
        if name in {path.stem for path in experiment.examples_folder().glob("*.toml")}:
            raise UnknownPlugin(f"{clean(name)} is no part, but an example; it is explained by: zswarm-ot check {clean(name)}")
        known = {known for kind in KINDS for known in plugins.names(kind)}
        raise UnknownPlugin(f"no part has the name {clean(name)!r}{nearest(name, known)}; all are shown by: zswarm-ot list")
    return found


def part(kind: plugins.Kind, name: str) -> Part:
    """One part; it is imported, and what goes wrong in that is told."""
    try:
        loaded = plugins.load(kind, name)
        about, *sheet = _paragraphs(inspect.getdoc(loaded) or "")
        source = _paragraphs(inspect.getdoc(sys.modules[loaded.__module__]) or "")
        keys = tuple(_cleaned(key) for key in settings_sheet.keys(loaded.settings_type))
        return Part(kind, clean(name), about, (*sheet, *filter(None, source)), keys, tuple(_facts(kind, loaded)))
    except (Exception, SystemExit) as error:  # a plug-in's code and texts may do anything; the others are shown all the same
        return Part(kind, clean(name), error=clean(" ".join(f"{error}".split()) or type(error).__name__))


def _by_manifest(kind: plugins.Kind, name: str, path: Path) -> Part:
    try:
        return Part(kind, clean(name), clean(manifests.read(path).description), unasked=True)
    except ConfigError as error:
        return Part(kind, clean(name), error=clean(str(error)))


def as_object(part: Part) -> dict[str, Any]:
    """All that is known of it, for JSON."""
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
    known = {"kind": part.kind, "name": part.name, "about": part.about, "error": part.error, "sheet": list(part.sheet)}
    return {**known, "settings": settings, **dict(part.facts)}


def settings_line(keys: tuple[Key, ...]) -> str:
    """All settings with their defaults, such as ``steps=50 task="aggregation"``."""
    return " ".join(f"{key.name}={default(key)}" for key in keys)


def default(key: Key) -> str:
    """As it stands in an experiment file, or "required"."""
    return "required" if key.required else clean(msgspec.json.encode(key.default).decode())


def _paragraphs(text: str) -> list[str]:
    """A text without the line breaks and marks of its source: its first line, then the rest in paragraphs."""
    first, *lines = settings_sheet.plain(text).splitlines() or [""]
    paragraphs = [clean(first)]
    begins = True
    for line in lines:
        words = clean(line.strip())
        if words and (begins or (not line.startswith(" ") and TITLED.match(line))):
            paragraphs.append(words)
        elif words:
            paragraphs[-1] += " " + words
        begins = not words
    return paragraphs


def _cleaned(key: Key) -> Key:
    return Key(clean(key.name), clean(key.type_text), key.default, clean(settings_sheet.plain(key.meaning)))


def _facts(kind: plugins.Kind, loaded: Any) -> list[tuple[str, Any]]:
    match kind:
        case "simulator":
            built = loaded
            if not hasattr(sys.modules[loaded.__module__], "LIBRARIES"):  # which take seconds to load
                with contextlib.suppress(Exception):  # what it senses may depend on its settings: where it can be, the defaults
                    built = loaded(loaded.settings_type())
            names = {"metrics": built.metrics, "sensors": built.sensors, "actuators": built.actuators}
            numbers = {what: getattr(built, what, None) for what in ("participants", "inputs", "outputs")}
            return [
                *((what, [clean(str(each)) for each in listed]) for what, listed in names.items()),
                *((what, number) for what, number in numbers.items() if isinstance(number, int)),
            ]
        case "optimizer":
            return [("portable", bool(loaded.portable)), ("competes", bool(loaded.competes))]
        case "ranking":
            return [("relative", bool(loaded.relative))]
    return []
