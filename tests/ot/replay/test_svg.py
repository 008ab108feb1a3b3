"""A trial becomes a picture in which every body is where the simulator had it."""

import itertools
import math
import re
from xml.etree import ElementTree

import pytest

from zswarm import evaluate
from zswarm.kernels.random import Stream
from zswarm.ot.replay.svg import MOST_FRAMES, NAMESPACE, Panel, svg
from zswarm.ot.replay.trace import record
from zswarm.sims.simulator import Body, Frame, Label, Line, Rectangle

SVG = f"{{{NAMESPACE}}}"
WALK = [
    Frame(
        10,
        5,
        [Rectangle("wall", 4, 0, 1, 2)],
        [Body("robot", x, 2.5, 0.4), Body("rock", 1, 1, 0.4)],
    )
    for x in range(11)
]


def drawn(seen: list[Frame]) -> ElementTree.Element:
    return ElementTree.fromstring(svg([Panel("a walk", seen)]))  # noqa: S314  our own text


def animations(picture: ElementTree.Element) -> dict[str, tuple[list[float], list[str]]]:
    """Key times and values by attribute."""
    found = {}
    for each in picture.iter(f"{SVG}animate"):
        found[each.attrib["attributeName"]] = (
            [float(t) for t in each.attrib["keyTimes"].split(";")],
            each.attrib["values"].split(";"),
        )
    return found


@pytest.mark.parametrize(
    ("simulator", "rounds"), [("emergency-exit", 50), ("minisim", 100)]
)
def test_a_trial_is_recorded_once_per_round(simulator: str, rounds: int) -> None:
    """The record reaches from the start to the end, for turns of one robot and turns of all."""
    built, network = evaluate.build(simulator, {}, "fully-meshed", {})
    seen = record(built, network, network.random(1, Stream(3)), 5).frames
    assert len(seen) == rounds + 1
    start = built.reset(5)
    assert start is not None
    assert seen[0] == built.frame()
    for before, after in itertools.pairwise(seen):
        pairs = zip(before.bodies, after.bodies, strict=True)
        assert all(
            max(abs(a.x - b.x), abs(a.y - b.y)) <= 1 for a, b in pairs if b.x > 0.5
        ), "a move is one cell"


def test_moving_bodies_are_animated_and_still_ones_are_not() -> None:
    """A steady walk needs its two ends only; the last picture stays for a while."""
    picture = drawn(WALK)
    assert list(animations(picture)) == ["cx"]
    times, values = animations(picture)["cx"]
    assert values == ["0", *(f"{x * 42:g}" for x in range(1, 11)), "420"]
    assert times[0] == 0
    assert times[-1] == 1
    assert times == sorted(times)
    assert times[-2] < 1


def test_each_kind_has_its_own_colour() -> None:
    lost, rock = WALK[5].bodies[0]._replace(kind="lost"), WALK[5].bodies[1]
    fills = animations(drawn([*WALK[:5], WALK[5]._replace(bodies=[lost, rock])]))["fill"][
        1
    ]
    assert len(set(fills)) == 2


def test_long_trials_are_thinned_with_their_end() -> None:
    long = [
        Frame(10, 5, [], [Body("robot", number % 7, 1, 0.4)]) for number in range(10_000)
    ]
    values = animations(drawn([*long, Frame(10, 5, [], [Body("robot", 9, 1, 0.4)])]))[
        "cx"
    ][1]
    assert len(values) <= MOST_FRAMES + 2
    assert values[-1] == f"{9 * 42:g}"


def test_reduced_motion_shows_paths() -> None:
    picture = drawn(WALK)
    still = [
        group for group in picture.iter(f"{SVG}g") if group.attrib.get("class") == "still"
    ]
    assert len(list(still[0].iter(f"{SVG}polyline"))) == 2
    assert re.search(
        r"prefers-reduced-motion:reduce\){\.zs \.moving{display:none}",
        svg([Panel("", WALK)]),
    )


def test_bodies_rotate_the_shorter_way() -> None:
    """Over the turn's end, too; a square turns as a whole."""
    angles = [2.8, 3.1, 3.4 - 2 * math.pi, 3.7 - 2 * math.pi]
    seen = [
        Frame(10, 5, [], [Body("box", x, 1, 0.4, angle, "square")])
        for x, angle in enumerate(angles)
    ]
    (turning,) = [
        each
        for each in drawn(seen).iter(f"{SVG}animateTransform")
        if each.attrib["type"] == "rotate"
    ]
    degrees = [float(value) for value in turning.attrib["values"].split(";")]
    assert degrees == sorted(degrees)
    assert degrees[-1] - degrees[0] == pytest.approx(math.degrees(0.9), abs=0.2)


def test_lines_move_with_their_ends_and_labels_appear_while_they_apply() -> None:
    seen = [
        Frame(
            10,
            5,
            [],
            [],
            [Line("rod", 1, 1, 2 + at, 1)],
            [Label(f"score {at // 2}", 5, 1, 0.5)],
        )
        for at in range(4)
    ]
    picture = drawn(seen)
    assert [
        each.attrib["attributeName"]
        for each in picture.iter(f"{SVG}animate")
        if "2" in each.attrib["attributeName"]
    ] == ["x2"]
    moving = next(
        group
        for group in picture.iter(f"{SVG}g")
        if group.attrib.get("class") == "moving"
    )
    assert {
        text.text: text.attrib["visibility"] for text in moving.iter(f"{SVG}text")
    } == {
        "score 0": "visible",
        "score 1": "hidden",
    }


def test_the_names_in_a_plugin_are_shown_as_text() -> None:
    hostile = '</svg><script>alert("&")</script>'
    seen = [Frame(1, 1, [Rectangle(hostile, 0, 0, 1, 1)], [Body(hostile + "'", 0, 0, 1)])]
    picture = ElementTree.fromstring(svg([Panel(hostile, seen)]))  # noqa: S314  our own text
    assert not list(picture.iter(f"{SVG}script"))
    assert [text.text for text in picture.iter(f"{SVG}text")] == [
        hostile,
        hostile,
        hostile + "'",
    ]


def test_agents_are_drawn_over_other_bodies() -> None:
    """They come first in a frame, and last in the file, as the one that covers the other."""
    bodies = [Body("robot", 0.5, 0.5, 0.1), Body("black floor", 0.5, 0.5, 0.4)]
    drawn = svg([Panel("a trial", [Frame(1.0, 1.0, [], bodies)] * 2)])
    moving, still = drawn.split('<g class="still">')
    for part in (moving, still):
        circles = re.findall(r"<circle [^>]*r=\"(\d+)\"", part)
        assert circles == ["168", "42"]
