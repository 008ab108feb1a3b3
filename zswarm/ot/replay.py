"""A trace for people and other programs: a page with the player, and a table (docs/replay.md)."""

import base64
import html
import math
import os
import sys
import tempfile
import webbrowser
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

from zswarm.ot.trace import Trace
from zswarm.protocol.codec import clean

HERE = files("zswarm.ot") / "pages"
NAME = "replay.html"


def page(trace: Trace, title: str) -> str:
    """One file with all that it shows; it asks no network, and its rules forbid that it does."""
    parts = {
        "STYLE": (HERE / "player.css").read_text(encoding="utf-8"),
        "PLAYER": (HERE / "player.js").read_text(encoding="utf-8"),
        "TRACE": base64.b64encode(trace.encode()).decode(),
        "TITLE": html.escape(clean(title)),  # the last: nothing is looked for in what others wrote
    }
    text = (HERE / NAME).read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"@{name}@", part)
    return text


def table(trace: Trace) -> tuple[list[str], Iterator[list[object]]]:
    """Names of columns, and a row per frame and body; where nothing is drawn, per frame and agent.

    What an agent observes and sets is in the row of the state in which it does.
    """
    header = ["round", "agent", "body", "kind", "x", "y", "heading"]
    header += [f"{what}: {name}" for what, names in _parts(trace) for name in names]
    return header, _rows(trace)


def _parts(trace: Trace) -> list[tuple[str, list[str]]]:
    return [("observes", [*trace.sensors]), ("sets", [*trace.actuators]), ("hidden", [*trace.neurons])]


def _rows(trace: Trace) -> Iterator[list[object]]:
    agents, none = len(trace.owners), [None] * sum(len(names) for _, names in _parts(trace))
    states = max(len(trace.frames), len(trace.inputs))
    for number in range(states):
        numbers = [part[number] for part in (trace.inputs, trace.outputs, trace.hidden)] if number < len(trace.inputs) else []
        for body in range(len(trace.frames[number].bodies) if trace.frames else agents):
            where: list[object] = [None] * 4
            if trace.frames:
                one = trace.frames[number].bodies[body]
                where = [one.kind, float(one.x), float(one.y), None if one.heading is None else float(one.heading)]
            is_agent = body < agents
            told = [float(value) for part in numbers for value in part[body].tolist()] if is_agent and numbers else none
            yield [trace.at(number), body if is_agent else None, body, *where, *(None if math.isnan(v or 0) else v for v in told)]


def show(text: str) -> tuple[Path, bool]:
    """A page in a private temporary file, opened in the browser; whether there is one."""
    path = Path(tempfile.mkdtemp(prefix="zswarm-replay-")) / NAME
    path.write_text(text, encoding="utf-8")
    return path, _has_screen() and webbrowser.open(path.as_uri())


def _has_screen() -> bool:
    """Whether a browser can show itself; one for the terminal would show nothing."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
