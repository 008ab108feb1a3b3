"""The player in a real browser: it shows a trace, by mouse, keyboard and touch, narrow and dark."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from tests.evaluated_record import played
from zswarm import evaluate
from zswarm.kernels.random import Stream
from zswarm.ot.replay import page as replay
from zswarm.ot.replay.trace import Trace, record

pytestmark = pytest.mark.browser
HOSTILE = '<img src=x onerror="document.title=1">'


def of(simulator: str, **settings: object) -> Trace:
    built, network = evaluate.build(simulator, settings, "fully-meshed", {})
    found = record(built, network, network.random(built.participants, Stream(1)), 5)
    return Trace(
        **{
            **found.__dict__,
            "about": {"run": "a-run", "generation": 3, "candidate": 1, "trial": 0},
        }
    )


def opened(page: Page, trace: Trace, folder: Path) -> Page:
    (folder / "replay.html").write_text(
        replay.page([replay.Side([replay.played(trace)])], "a run")
    )
    page.goto((folder / "replay.html").as_uri())
    expect(page.get_by_role("slider", name="round")).to_be_visible()
    return page


def paused(page: Page, trace: Trace, folder: Path) -> Page:
    page.emulate_media(reduced_motion="reduce")
    return opened(page, trace, folder)


def said(page: Page) -> str:
    return page.locator(".zp-clock").inner_text()


def test_the_player_plays_to_the_end(page: Page, tmp_path: Path) -> None:
    opened(page, of("minisim", steps=20, width=5), tmp_path)
    page.get_by_role("combobox", name="speed").select_option("16")
    expect(page.locator(".zp-clock")).to_have_text("20 / 20")
    expect(page.get_by_role("button", name="play", exact=True)).to_be_visible()
    assert page.evaluate("player.frames") > 2


def test_the_keyboard_controls_the_player(page: Page, tmp_path: Path) -> None:
    paused(page, of("minisim", steps=100), tmp_path)
    assert said(page) == "0 / 100"
    for key, shown in (
        ("ArrowRight", "1 / 100"),
        ("Shift+ArrowRight", "11 / 100"),
        ("ArrowLeft", "10 / 100"),
        ("End", "100 / 100"),
        ("Home", "0 / 100"),
        ("ArrowLeft", "0 / 100"),
    ):
        page.keyboard.press(key)
        assert said(page) == shown, key
    page.keyboard.press("+")
    assert page.get_by_role("combobox", name="speed").input_value() == "2"
    page.keyboard.press("]")
    expect(page.get_by_role("heading", name="agent 1")).to_be_visible()
    page.keyboard.press("t")
    expect(page.get_by_role("checkbox", name="trails")).to_be_checked()
    page.keyboard.press(" ")
    expect(page.get_by_role("button", name="pause")).to_be_visible()
    page.keyboard.press(" ")
    expect(page.get_by_role("button", name="play", exact=True)).to_be_visible()


def test_every_control_has_a_label_and_can_be_reached_with_the_tab_key(
    page: Page, tmp_path: Path
) -> None:
    paused(page, of("maze", steps=50), tmp_path)
    names = []
    for _ in range(14):
        page.keyboard.press("Tab")
        focused = page.evaluate(
            "(() => { const e = document.activeElement; const words = e.closest('label, "
            "summary')?.textContent;"
            " return [e.tagName, e.getAttribute('aria-label') ?? words ?? '', "
            "getComputedStyle(e).outlineStyle]; })()"
        )
        names.append(focused[1])
        if focused[0] != "BODY":
            assert focused[1], focused
            assert focused[2] != "none", focused
    assert {"round", "play", "a round ahead", "speed", "sensors", "agent"} <= set(names)


def test_the_player_shows_the_chosen_agents_numbers_and_describes_the_picture(
    page: Page, tmp_path: Path
) -> None:
    """Numbers of the chosen agent at a round, and the picture in words."""
    trace = of("turtlebot-exit", steps=30, robots=3)
    paused(page, trace, tmp_path)
    page.get_by_role("combobox", name="agent").select_option("2")
    page.evaluate("document.querySelector('.zp-slider').focus()")
    for _ in range(7):
        page.keyboard.press("ArrowRight")
    assert said(page) == "7 / 30"
    shown = [float(text) for text in page.locator(".zp-value").all_inner_texts()]
    numbers = [*trace.inputs[7, 2], *trace.hidden[7, 2], *trace.outputs[7, 2]]
    spread = max(
        float(part.max() - part.min())
        for part in (trace.inputs, trace.hidden, trace.outputs)
    )
    assert shown == pytest.approx(numbers, abs=spread / 254 + 0.006)
    expect(page.get_by_role("img", name="picture of the trial: robot: 3")).to_be_visible()
    assert page.locator(".zp-name").all_inner_texts()[:2] == ["scan_0", "scan_1"]


def with_inputs(trace: Trace, numbers: list[float]) -> Trace:
    """Return a trace whose agents observe a number, round after round, and act in every one."""
    rows = np.array(numbers, np.float32)[:, None, None]
    inputs = np.repeat(rows, len(trace.owners), axis=1)
    empty = np.zeros((*inputs.shape[:2], 0), np.float32)
    return Trace(
        **{
            **trace.__dict__,
            "inputs": inputs,
            "hidden": empty,
            "outputs": empty,
            "sensors": ["charge"],
            "neurons": [],
            "actuators": [],
            "frames": [],
            "rounds": len(numbers),
        }
    )


@pytest.mark.parametrize(
    ("numbers", "zero", "ends"),
    [
        ([-1.0, 3.0, 0.0, 1.0], 0.25, ["-1", "3"]),
        ([2.0, 4.0, 2.0, 4.0], 0.0, ["0", "4"]),
        ([-2.0, -1.0, -2.0, -1.0], 1.0, ["-2", "0"]),
    ],
)
def test_bars_have_a_tick_at_zero_and_their_range(
    page: Page, tmp_path: Path, numbers: list[float], zero: float, ends: list[str]
) -> None:
    paused(page, with_inputs(of("minisim", steps=5, width=4), numbers), tmp_path)
    assert page.locator(".zp-end").all_inner_texts() == ends
    place = page.evaluate(
        "(() => { const box = (name) => document.querySelector(name).getBoundingClientRect();"
        " const rail = box('.zp-rail'), tick = box('.zp-zero');"
        " return (tick.left + tick.width / 2 - rail.left - 1) / (rail.width - 2); })()"
    )
    assert place == pytest.approx(zero, abs=0.02)


def test_the_heat_map_has_names_an_axis_and_a_scale(page: Page, tmp_path: Path) -> None:
    """Pointing at it shows the number there; a click goes to its round."""
    trace = with_inputs(of("minisim", steps=5, width=4), [-127.0, 0.0, 64.0, 127.0])
    paused(page, trace, tmp_path)
    assert page.locator(".zp-heat-names span").all_inner_texts() == ["charge", "127"]
    ticks = ["0", "1", "2", "3", "4", "round"]
    assert page.locator(".zp-axis span").all_inner_texts() == ticks
    scale = page.locator(".zp-scale").inner_text().split()
    assert scale == ["-max", "+max", "0"]
    heat = page.get_by_role("img", name="heat map")
    box = heat.bounding_box()
    assert box is not None
    expect(page.locator(".zp-pointed")).to_have_text("")
    heat.hover(position={"x": box["width"] * 0.6, "y": 6})
    expect(page.locator(".zp-pointed")).to_have_text("round 2, charge: 64.0")
    heat.click(position={"x": box["width"] * 0.9, "y": 6})
    assert said(page) == "3 / 4"
    row = page.evaluate(
        "(() => { const c = document.querySelector('.zp-heat');"
        " return [...c.getContext('2d').getImageData(0, 5, c.width, 1).data]; })()"
    )
    pixels = [row[at : at + 3] for at in range(0, len(row), 4)]
    blue, none, pale, orange = (
        pixels[int(share * len(pixels))] for share in (0.12, 0.37, 0.6, 0.87)
    )
    assert blue[2] > blue[0]
    assert orange[0] > orange[2]
    assert sum(none) > sum(pale) > sum(orange), "zero has the colour of the page"


def test_a_touch_selects_an_agent(browser: Browser, tmp_path: Path) -> None:
    trace = of("turtlebot-exit", steps=5, robots=4)
    context = browser.new_context(
        viewport={"width": 400, "height": 800}, has_touch=True, reduced_motion="reduce"
    )
    page = opened(context.new_page(), trace, tmp_path)
    frame, box = trace.frames[0], page.locator(".zp-canvas").bounding_box()
    assert box is not None
    body = frame.bodies[2]
    page.touchscreen.tap(
        box["x"] + body.x / frame.width * box["width"],
        box["y"] + body.y / frame.height * box["height"],
    )
    expect(page.get_by_role("heading", name="agent 2")).to_be_visible()
    page.touchscreen.tap(box["x"] + 3, box["y"] + 3)
    expect(page.get_by_role("heading", name="no agent chosen")).to_be_visible()
    context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("simulator", ["xor", "inverted-pendulum", "arena"])
def test_nothing_is_wider_than_a_phone(
    page: Page, tmp_path: Path, simulator: str, scheme: str
) -> None:
    """Every swatch of the legend has a colour that differs from the field's."""
    page.set_viewport_size({"width": 400, "height": 800})
    page.emulate_media(color_scheme=scheme, reduced_motion="reduce")  # type: ignore[arg-type]  # one of the two
    paused(page, of(simulator, **({"steps": 20} if simulator != "xor" else {})), tmp_path)
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    light = sum(int(part) for part in background[4:-1].split(",")[:3]) > 380
    assert light == (scheme == "light")


def test_a_button_switches_the_colour_theme(page: Page, tmp_path: Path) -> None:
    paused(page, of("minisim", steps=5, width=4), tmp_path)
    picture = "document.querySelector('.zp-canvas').toDataURL()"
    before = page.evaluate(picture)
    page.get_by_role("button", name="light or dark").click()
    page.evaluate(
        "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )
    assert page.evaluate(picture) != before


def test_reduced_motion_is_respected(page: Page, tmp_path: Path) -> None:
    paused(page, of("minisim", steps=20), tmp_path)
    page.evaluate(
        "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )
    assert said(page) == "0 / 20"


def test_names_are_shown_as_text(page: Page, tmp_path: Path) -> None:
    trace = of("minisim", steps=5, width=4)
    frames = [
        frame._replace(bodies=[body._replace(kind=HOSTILE) for body in frame.bodies])
        for frame in trace.frames
    ]
    hostile = Trace(
        **{
            **trace.__dict__,
            "frames": frames,
            "note": HOSTILE,
            "error": HOSTILE,
            "sensors": [HOSTILE] * 9,
            "metrics": {HOSTILE: 1.0},
            "about": {"run": HOSTILE, HOSTILE: HOSTILE},
        }
    )
    paused(page, hostile, tmp_path)
    expect(page.get_by_role("alert").first).to_have_text(HOSTILE)
    expect(page.locator(".zp-legend")).to_contain_text(HOSTILE)
    assert page.locator("img").count() == 0
    assert page.title() == "a run"


def test_a_trial_without_pictures_shows_its_numbers(page: Page, tmp_path: Path) -> None:
    trace = of("minisim", steps=8, width=4)
    paused(page, Trace(**{**trace.__dict__, "frames": []}), tmp_path)
    expect(page.get_by_text("This simulator draws no picture")).to_be_visible()
    page.keyboard.press("End")
    assert said(page) == "8 / 8"
    assert page.locator(".zp-value").count() == 9 + 2 + 2


def stepped(
    *numbers: tuple[int, int, float], start: int = 0, **settings: Any
) -> replay.Side:
    """Return a side with a trial of each generation, trial and fitness; of longer ones later."""
    trials = []
    for generation, trial, fitness in numbers:
        found = of("minisim", steps=20 + 10 * trial, width=5, **settings)
        about = {"run": "a-run", "generation": generation, "candidate": 1, "trial": trial}
        one = Trace(**{**found.__dict__, "about": about, "fitness": [fitness]})
        trials.append(replay.played(one))
    return replay.Side(trials, start)


def shown(page: Page, folder: Path, *sides: replay.Side) -> Page:
    page.emulate_media(reduced_motion="reduce")
    (folder / "replay.html").write_text(replay.page(sides, "steps"))
    page.goto((folder / "replay.html").as_uri())
    expect(page.get_by_role("slider", name="round")).to_be_visible()
    return page


def test_generations_and_trials_are_stepped_through(page: Page, tmp_path: Path) -> None:
    """The title and the fitness follow; the time stays."""
    side = stepped(
        (0, 0, 0.5),
        (0, 1, 0.1),
        (0, 2, 0.9),
        (4, 0, 1.5),
        (4, 1, 1.1),
        (4, 2, 1.9),
        start=3,
    )
    shown(page, tmp_path, side)
    title, result = page.locator(".zp-title"), page.locator(".zp-result")
    expect(title).to_have_text("a-run · generation 5 · candidate 1 · trial 0")
    expect(page.get_by_text("generation 5 (2 of 2)")).to_be_visible()
    trials = page.get_by_role("combobox", name="trial")
    assert trials.locator("option").all_inner_texts() == [
        "trial 0: fitness 1.5 (median)",
        "trial 1: fitness 1.1 (worst)",
        "trial 2: fitness 1.9 (best)",
    ]
    page.keyboard.press("Shift+ArrowRight")
    assert said(page) == "10 / 20"
    trials.select_option("trial 2: fitness 1.9 (best)")
    expect(title).to_have_text("a-run · generation 5 · candidate 1 · trial 2")
    expect(result).to_contain_text("fitness 1.9")
    assert said(page) == "10 / 40"
    page.get_by_role("slider", name="generation").fill("0")
    expect(title).to_have_text("a-run · generation 1 · candidate 1 · trial 2")
    expect(result).to_contain_text("fitness 0.9")
    page.get_by_role("button", name="previous trial").click()
    expect(title).to_have_text("a-run · generation 1 · candidate 1 · trial 1")
    page.locator("h2").click()
    page.keyboard.press("PageDown")
    expect(title).to_have_text("a-run · generation 5 · candidate 1 · trial 1")
    page.keyboard.press(",")
    expect(title).to_have_text("a-run · generation 5 · candidate 1 · trial 0")
    page.keyboard.press(",")
    expect(trials).to_have_value("3")
    page.keyboard.press("End")
    assert said(page) == "20 / 20"


def test_one_trial_has_no_menus(page: Page, tmp_path: Path) -> None:
    shown(page, tmp_path, stepped((0, 0, 0.5)))
    assert page.get_by_role("slider", name="generation").count() == 0
    assert page.get_by_role("combobox", name="trial").count() == 0


def test_two_runs_play_on_one_clock(page: Page, tmp_path: Path) -> None:
    """The shorter one stays on its last state; each has its own title, menus and numbers."""
    shown(page, tmp_path, stepped((0, 0, 0.5)), stepped((3, 2, 1.5), (3, 1, 1.0)))
    assert page.locator(".zp-title").all_inner_texts() == [
        "a-run · generation 1 · candidate 1 · trial 0",
        "a-run · generation 4 · candidate 1 · trial 2",
    ]
    assert page.get_by_role("slider", name="round").count() == 1
    left, right = page.locator(".zp-canvas").all()
    ended = page.locator(".zp-ended")
    page.keyboard.press("Shift+ArrowRight")
    assert said(page) == "10 / 40"
    assert ended.all_inner_texts() == ["round 10 of 20", "round 10 of 40"]
    boxes = left.bounding_box(), right.bounding_box()
    assert boxes[0] is not None
    assert boxes[1] is not None
    assert boxes[0]["x"] + boxes[0]["width"] <= boxes[1]["x"]
    assert boxes[0]["y"] == boxes[1]["y"]
    for _ in range(2):
        page.keyboard.press("Shift+ArrowRight")
    assert ended.all_inner_texts() == ["ended at round 20", "round 30 of 40"]
    picture = "Array.from(document.querySelectorAll('.zp-canvas'), (c) => c.toDataURL())"
    before = page.evaluate(picture)
    page.keyboard.press("Shift+ArrowRight")
    after = page.evaluate(picture)
    assert (before[0] == after[0], before[1] == after[1]) == (True, False)
    page.get_by_role("combobox", name="agent").nth(1).select_option("3")
    assert page.locator(".zp-agent").all_inner_texts() == ["agent 0", "agent 3"]
    page.get_by_role("combobox", name="trial").select_option(label="trial 1: fitness 1")
    expect(page.locator(".zp-title").nth(1)).to_contain_text("trial 1")
    assert said(page) == "30 / 30"


@pytest.mark.parametrize("width", [400, 1280])
def test_two_simulators_side_by_side_fit_the_window(
    page: Page, tmp_path: Path, width: int
) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    pole = replay.Side([replay.played(of("inverted-pendulum", steps=30))])
    shown(page, tmp_path, stepped((0, 0, 0.5), (0, 1, 0.7), (1, 0, 2.0)), pole)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    expect(page.get_by_role("img", name="picture of the trial")).to_have_count(2)


def test_an_invalid_trace_is_reported(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay, "encode", lambda *_: b"zswtrace" + bytes(8))
    (tmp_path / "x.html").write_text(
        replay.page([replay.Side([replay.played(of("minisim", steps=5, width=4))])], "x")
    )
    page.goto((tmp_path / "x.html").as_uri())
    expect(
        page.get_by_text("This trace cannot be shown: a trace of version 0, expected 1")
    ).to_be_visible()


def test_a_hundred_agents_are_drawn_fluently(page: Page, tmp_path: Path) -> None:
    """The aim is 28 pictures a second; the number depends on the machine and is printed."""
    opened(page, of("arena", robots=100, steps=1000, side=8.0), tmp_path)
    hundred = (
        "new Promise((done) => { const look = () => player.frames < 100 ? "
        "requestAnimationFrame(look) : done(); look(); })"
    )
    begin = time.monotonic()
    page.evaluate(hundred)
    sys.stdout.write(
        f"\nplayer: {100 / (time.monotonic() - begin):.1f} pictures/s of 100 agents\n"
    )
    assert page.evaluate("player.frames") >= 100


def test_a_trial_is_played_on_the_page_of_its_candidate(
    page: Page, dashboard: Callable[..., Any], tmp_path: Path
) -> None:
    """The dashboard serves the same player; its policy forbids scripts and styles in a page."""
    played(tmp_path)
    shown = dashboard(tmp_path)
    page.goto(f"{shown.url}/#token={shown.token}")
    page.goto(f"{shown.url}/candidate?run=minisim")
    page.get_by_role("button", name="Play trial 0").click()
    expect(page.get_by_role("slider", name="round")).to_be_visible()
    page.get_by_role("combobox", name="speed").select_option("16")
    expect(page.get_by_role("button", name="play", exact=True)).to_be_visible()
    rounds, of_all = said(page).split(" / ")
    assert rounds == of_all != "0"
