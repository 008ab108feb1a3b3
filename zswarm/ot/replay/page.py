"""Present a trace as a page with the player, or as a table (docs/replay.md)."""

import base64
import html
import os
import re
import sys
import webbrowser
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.replay.encoding import encode
from zswarm.ot.replay.trace import Trace
from zswarm.system.files import write_whole
from zswarm.system.text import clean

HERE = files("zswarm.ot.replay") / "pages"
NAME = "replay.html"
# Each imports earlier ones.
MODULES = (
    "decode",
    "elements",
    "picture",
    "heatmap",
    "panel",
    "view",
    "side",
    "player",
)


class Played(NamedTuple):
    """A trial of a page: where it is from, its result, and its encoded trace."""

    about: dict[str, Any]
    fitness: list[float]  # of each participant; NaN if the trial failed
    note: str
    error: str
    encoded: bytes


class Side(NamedTuple):
    """What a page shows of a run: trials, generation after generation, and the first one shown."""

    trials: Sequence[Played]
    start: int = 0


def played(trace: Trace, colours: dict[str, str] | None = None) -> Played:
    """Encode a trace.

    Args:
        colours: of the kinds in other trials of the page; new ones are added.
    """
    encoded = encode(trace, colours)
    return Played(trace.about, [*trace.fitness], trace.note, trace.error, encoded)


def page(sides: Sequence[Side], title: str) -> str:
    """Return one file that contains all it shows; its policy forbids network requests.

    Args:
        sides: one run, or two that are shown side by side on one clock.
        title: of the page.
    """
    every = [one for side in sides for one in side.trials]
    parts = {
        "STYLE": (HERE / "player.css").read_text(encoding="utf-8"),
        "PLAYER": player(),
        "INDEX": _index(sides),
        "TRACES": "\n".join(map(_script, every)),
        "TITLE": html.escape(clean(title)),
    }
    text = (HERE / NAME).read_text(encoding="utf-8")
    # One pass: no placeholder is searched in texts that come from somewhere else.
    return re.sub("@([A-Z]+)@", lambda found: parts[found[1]], text)


def _index(sides: Sequence[Side]) -> str:
    """Return JSON of numbers only: what the menus list."""
    return msgspec.json.encode(
        [
            {
                "start": side.start,
                "trials": [
                    {
                        "generation": one.about.get("generation", 0),
                        "trial": one.about.get("trial", 0),
                        "fitness": one.fitness,
                    }
                    for one in side.trials
                ],
            }
            for side in sides
        ]
    ).decode()


def _script(one: Played) -> str:
    text = base64.b64encode(one.encoded).decode()
    return f'<script type="application/octet-stream" class="trace">{text}</script>'


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
