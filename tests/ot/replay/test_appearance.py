"""The stated table of kinds and colours, and what the bundled simulators draw."""

import itertools
import re
from pathlib import Path
from typing import Any

import pytest

import zswarm
from zswarm import evaluate
from zswarm.kernels.random import Stream
from zswarm.ot.replay.appearance import COLOURS, WORDS, kinds
from zswarm.ot.replay.trace import record
from zswarm.sims.simulator import Body, Frame

ROOT = Path(zswarm.__file__).parent.parent
CSS = ROOT / "zswarm" / "ot" / "replay" / "pages" / "player.css"
DOCUMENT = (ROOT / "docs" / "own-simulator.md").read_text()
# Steps that a random controller takes are few: not all kinds occur, but all that occur are stated.
DRAWN: list[tuple[str, dict[str, Any]]] = [
    ("arena", {"task": "foraging", "steps": 20}),
    ("arena", {"task": "consensus", "steps": 5}),
    ("emergency-exit", {"steps": 10}),
    ("epuck", {"mission": "aggregation", "seconds": 1.0, "robots": 2}),
    ("epuck", {"mission": "foraging", "seconds": 1.0, "robots": 2}),
    ("food-or-poison", {}),
    ("inverted-pendulum", {"steps": 40}),
    ("light", {"steps": 5}),
    ("maze", {"steps": 5}),
    ("minisim", {"steps": 20, "width": 5}),
    ("minisim", {"steps": 20, "width": 5, "teams": 2, "defenders": 0}),
    ("simplified-emergency-exit", {"steps": 5}),
    ("turtlebot-exit", {"steps": 5, "robots": 3}),
    ("xor", {}),
]


def frame(*kinds: str) -> list[Frame]:
    return [Frame(1.0, 1.0, [], [Body(kind, 0.5, 0.5, 0.1) for kind in kinds])]


def stated(simulator: str) -> set[tuple[str, str]]:
    """Return kinds and shapes of a simulator, as the document's table has them."""
    rows = re.findall(r"^\| (`.*`) \| (`.*`) \| ([a-z, ]+) \|$", DOCUMENT, re.M)
    return {
        (kind, shape)
        for names, said, shapes in rows
        if f"`{simulator}`" in names
        for kind in re.findall(r"`([^`]+)`", said)
        for shape in shapes.split(", ")
    }


def test_the_documents_table_is_the_codes() -> None:
    rows = re.findall(
        r"^\| (\S.*) \| `([a-z\d-]+)` \| `(#\w+)` \| `(#\w+)` \|$", DOCUMENT, re.M
    )
    assert {name: (light, dark) for _, name, light, dark in rows} == COLOURS
    words = {
        word: name for said, name, *_ in rows for word in re.findall(r"`([^`]+)`", said)
    }
    assert words == WORDS


def test_the_player_has_the_colours_of_the_table() -> None:
    found = re.findall(r"--zp-([\w-]+): light-dark\((#\w+), (#\w+)\)", CSS.read_text())
    colours = {name: (light, dark) for name, light, dark in found if name in COLOURS}
    assert colours == COLOURS


@pytest.mark.parametrize(
    ("kind", "colour"),
    [
        ("exit", "exit"),
        ("two exits", "exit"),
        ("brightness", "c1"),  # "right" is a part of a word
        ("opponents' home", "home-2"),
        ("robot at the light", "c1"),
        ("robot, says too much", "c2"),
        ("white floor", "floor-white"),
        ("walled garden", "c1"),
    ],
)
def test_a_word_in_a_kind_states_its_colour(kind: str, colour: str) -> None:
    assert kinds(frame(kind)) == {kind: colour}


def test_a_kind_keeps_its_colour_in_the_next_picture() -> None:
    """Trials of one page show the same kind in the same colour, in whatever order they occur."""
    shown: dict[str, str] = {}
    assert kinds(frame("robot", "wall", "item"), shown=shown) == {
        "robot": "c1",
        "wall": "wall",
        "item": "c2",
    }
    assert kinds(frame("item", "pen", "robot"), shown=shown) == {
        "item": "c2",
        "pen": "c3",
        "robot": "c1",
    }


def test_the_palette_starts_again_where_there_are_more_kinds() -> None:
    many = kinds(frame(*(f"kind {letter}" for letter in "abcdefghij")))
    assert list(many.values()) == [f"c{1 + number % 8}" for number in range(10)]


@pytest.mark.parametrize(("simulator", "settings"), DRAWN)
def test_all_kinds_that_simulators_draw_are_stated(
    simulator: str, settings: dict[str, Any]
) -> None:
    built, network = evaluate.build(simulator, settings, "fully-meshed", {})
    genomes = network.random(built.participants, Stream(1))
    found = record(built, network, genomes, 5).frames
    first = found[0]
    seen = {(body.kind, body.shape) for shown in found for body in shown.bodies}
    seen |= {(place.kind, "place") for place in first.places}
    seen |= {(line.kind, "line") for line in itertools.chain(first.lines)}
    seen = {
        (kind.partition(",")[0] + ", ..." if kind.startswith("animal") else kind, shape)
        for kind, shape in seen
    }
    assert seen
    assert seen <= stated(simulator)
