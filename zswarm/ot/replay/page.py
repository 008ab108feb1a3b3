"""Present a trace as a page with the player, or as a table (docs/replay.md)."""

import base64
import html
import os
import re
import sys
import webbrowser
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.replay.encoding import encode
from zswarm.ot.replay.trace import Trace
from zswarm.system.files import write_whole
from zswarm.system.text import clean

HERE = files("zswarm.ot.replay") / "pages"
NAME = "replay.html"
# Each imports earlier ones.
MODULES = ("decode", "elements", "picture", "heatmap", "panel", "player")


def page(trace: Trace, title: str) -> str:
    """Return one file that contains all it shows; its policy forbids network requests."""
    parts = {
        "STYLE": (HERE / "player.css").read_text(encoding="utf-8"),
        "PLAYER": player(),
        "TRACE": base64.b64encode(encode(trace)).decode(),
        "TITLE": html.escape(clean(title)),
    }
    text = (HERE / NAME).read_text(encoding="utf-8")
    # One pass: no placeholder is searched in texts that come from somewhere else.
    return re.sub("@([A-Z]+)@", lambda found: parts[found[1]], text)


def player() -> str:
    """Return the modules of the player as one script."""
    text = "\n".join(
        (HERE / f"{name}.js").read_text(encoding="utf-8") for name in MODULES
    )
    return re.sub(r"^import .*\n|^export ", "", text, flags=re.MULTILINE)


def table(trace: Trace) -> tuple[list[str], Iterator[list[object]]]:
    """Return names of columns, and a row per frame and body; without frames per round and agent.

    What an agent observes and sets is in the row of the state in which it acts.
    """
    header = ["round", "agent", "body", "kind", "x", "y", "heading"]
    header += [f"observes: {name}" for name in trace.sensors]
    header += [f"sets: {name}" for name in trace.actuators]
    header += [f"hidden: {name}" for name in trace.neurons]
    return header, _rows(trace)


def _rows(trace: Trace) -> Iterator[list[object]]:
    agents = len(trace.owners)
    table = np.dstack((trace.inputs, trace.outputs, trace.hidden))
    blank = [None] * table.shape[2]
    for number in range(max(len(trace.frames), len(table))):
        bodies = trace.frames[number].bodies if trace.frames else [None] * agents
        for index, body in enumerate(bodies):
            agent = index if index < agents else None
            where = (
                [None] * 4 if body is None else [body.kind, body.x, body.y, body.heading]
            )
            acts = agent is not None and number < len(table)
            numbers = table[number, index].tolist() if acts else blank
            yield [trace.at(number), agent, index, *where, *numbers]


def show(text: str, folder: Path) -> tuple[Path, bool]:
    """Write a page to the folder of its run, and open it in the browser.

    Returns:
        its file, and whether a browser was opened.

    Raises:
        ConfigError: the folder cannot be written.
    """
    path = folder / NAME
    try:
        write_whole(path, text.encode())
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written: {error.strerror}; name another file with -o"
        ) from None
    return path, _has_screen() and webbrowser.open(path.resolve().as_uri())


def _has_screen() -> bool:
    """Return whether a graphical browser can run; one in the terminal would show nothing."""
    names = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    return sys.platform == "darwin" or any(os.environ.get(name) for name in names)
