"""A trial becomes a picture in which every body is where the simulator had it."""

import itertools
import re
from xml.etree import ElementTree

import pytest

from zswarm import evaluate
from zswarm.draws import Stream
from zswarm.ot.film import MOST_FRAMES, NAMESPACE, Panel, frames, svg
from zswarm.sims.minisim import Minisim
from zswarm.sims.simulator import Body, Frame, Place

SVG = f"{{{NAMESPACE}}}"
WALK = [Frame(10, 5, [Place("wall", 4, 0, 1, 2)], [Body("robot", x, 2.5, 0.4), Body("rock", 1, 1, 0.4)]) for x in range(11)]


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


@pytest.mark.parametrize(("simulator", "rounds"), [("emergency-exit", 50), ("minisim", 100)])
def test_a_trial_is_looked_at_once_a_round(simulator: str, rounds: int) -> None:
    """From the start to the end; in both, turns of one robot and turns of all."""
    built, network = evaluate.build(simulator, {}, "fully-meshed", {})
    seen = frames(built, network, network.random(1, Stream(3))[0], 5)
    assert len(seen) == rounds + 1
    start = built.reset(5)
    assert start is not None
    assert seen[0] == built.frame()
    for before, after in itertools.pairwise(seen):
        pairs = zip(before.bodies, after.bodies, strict=True)
        assert all(max(abs(a.x - b.x), abs(a.y - b.y)) <= 1 for a, b in pairs if b.x > 0.5), "a move is one cell"


def test_a_body_moves_along_its_way_and_what_stands_still_does_not() -> None:
    """A steady walk needs its two ends only; the last picture stays for a while."""
    picture = drawn(WALK)
    assert list(animations(picture)) == ["cx"]
    times, values = animations(picture)["cx"]
    assert values == ["0", *(f"{x * 42:g}" for x in range(1, 11)), "420"]
    assert times[0] == 0
    assert times[-1] == 1
    assert times == sorted(times)
    assert times[-2] < 1


def test_another_kind_is_another_colour() -> None:
    lost, rock = WALK[5].bodies[0]._replace(kind="lost"), WALK[5].bodies[1]
    fills = animations(drawn([*WALK[:5], WALK[5]._replace(bodies=[lost, rock])]))["fill"][1]
    assert len(set(fills)) == 2


def test_long_trials_are_thinned_with_their_end() -> None:
    long = [Frame(10, 5, [], [Body("robot", number % 7, 1, 0.4)]) for number in range(10_000)]
    values = animations(drawn([*long, Frame(10, 5, [], [Body("robot", 9, 1, 0.4)])]))["cx"][1]
    assert len(values) <= MOST_FRAMES + 2
    assert values[-1] == f"{9 * 42:g}"


def test_whoever_wants_no_motion_gets_the_paths() -> None:
    picture = drawn(WALK)
    still = [group for group in picture.iter(f"{SVG}g") if group.attrib.get("class") == "still"]
    assert len(list(still[0].iter(f"{SVG}polyline"))) == 2
    assert re.search(r"prefers-reduced-motion:reduce\){\.zs \.moving{display:none}", svg([Panel("", WALK)]))


class Drawn(Minisim):
    """A simulator whose pictures a test chooses."""

    pictures: list[Frame]

    def frame(self) -> Frame:
        return self.pictures.pop(0) if len(self.pictures) > 1 else self.pictures[0]


@pytest.mark.parametrize(
    "pictures",
    [
        [WALK[0], WALK[1]._replace(bodies=WALK[1].bodies[:1])],
        [WALK[0]._replace(bodies=[]), WALK[1]],
        [WALK[0], WALK[1]._replace(bodies=[Body("robot", float("nan"), 0, 0.4), WALK[1].bodies[1]])],
        [WALK[0]._replace(width=0)],
        [WALK[0]._replace(places=[Place("wall", float("inf"), 0, 1, 1)])],
    ],
    ids=["a body goes", "a body comes", "no place", "no field", "a place without an end"],
)
def test_what_cannot_be_drawn_makes_no_picture(pictures: list[Frame]) -> None:
    """A plug-in's frames may be anything: the report is there without them."""
    built, network = evaluate.build("minisim", {}, "fully-meshed", {})
    simulator = Drawn(built.settings)
    simulator.pictures = pictures
    assert frames(simulator, network, network.random(1, Stream(3))[0], 5) == []


def test_names_of_a_plug_in_are_text() -> None:
    hostile = '</svg><script>alert("&")</script>'
    seen = [Frame(1, 1, [Place(hostile, 0, 0, 1, 1)], [Body(hostile + "'", 0, 0, 1)])]
    picture = ElementTree.fromstring(svg([Panel(hostile, seen)]))  # noqa: S314  our own text
    assert not list(picture.iter(f"{SVG}script"))
    assert [text.text for text in picture.iter(f"{SVG}text")] == [hostile, hostile, hostile + "'"]
