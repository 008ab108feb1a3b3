"""A recorded trial as a page, a table and a moving picture."""

import base64
import csv
import io
import json
import os
import re
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from PIL import Image

from tests.evaluated_record import SHORT, played
from tests.parameters import some
from zswarm import evaluate
from zswarm.kernels.random import Stream
from zswarm.ot import cli
from zswarm.ot.record.reader import Run
from zswarm.ot.replay import gif
from zswarm.ot.replay import page as replay
from zswarm.ot.replay.encoding import encode
from zswarm.ot.replay.trace import Trace, record, trace

HOSTILE = "</title></script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return played(tmp_path_factory.mktemp("runs"), overrides=SHORT)


def of(simulator: str, **settings: object) -> Trace:
    built, network = evaluate.build(simulator, settings, "fully-meshed", {})
    return record(built, network, network.random(built.participants, Stream(1)), 5)


def typed(*arguments: str) -> Result:
    return CliRunner().invoke(cli.command, ["replay", *arguments], catch_exceptions=False)


def test_a_page_contains_the_trace_and_requests_nothing(folder: Path) -> None:
    found = trace(Run(folder))
    page = replay.page([replay.Side([replay.played(found)])], HOSTILE)
    assert page.count("<script") == 3
    assert "alert(1)</script>" not in page
    (packed,) = re.findall(r'class="trace">([^<]*)</script>', page)
    assert base64.b64decode(packed) == encode(found)
    assert not re.findall(
        r"(?:src|href)\s*=\s*[\"'](?!data:,)|https?://(?!www\.w3\.org/2000/svg)|@import|url\(",
        page,
    )
    assert "default-src 'none'" in page


def test_the_player_sets_texts_and_never_markup() -> None:
    """Nor styles or scripts in attributes: a page that serves it forbids them."""
    source = replay.player()
    assert not re.findall(
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(|new "
        r"Function|\"style\"|\.cssText",
        source,
    )


def test_a_table_has_a_row_for_each_body_in_each_state(
    folder: Path, tmp_path: Path
) -> None:
    output = tmp_path / "it.csv"
    assert typed(str(folder), "-o", str(output)).exit_code == 0
    rows = list(csv.DictReader(io.StringIO(output.read_text())))
    found = trace(Run(folder))
    bodies = len(found.frames[0].bodies)
    assert len(rows) == 31 * bodies
    assert [row["agent"] for row in rows[:bodies]] == [
        "0",
        "1",
        "2",
        *[""] * (bodies - 3),
    ]
    assert {row["kind"] for row in rows} >= {"robot", "defender"}
    robot = rows[5 * bodies + 1]
    body = found.frames[5].bodies[1]
    assert (robot["round"], float(robot["x"]), float(robot["y"]), robot["heading"]) == (
        "5",
        body.x,
        body.y,
        "",
    )
    numbers = [
        float(value)
        for name, value in robot.items()
        if name.startswith(("observes: ", "sets: ", "hidden: "))
    ]
    assert numbers == [
        *found.inputs[5, 1].tolist(),
        *found.outputs[5, 1].tolist(),
        *found.hidden[5, 1].tolist(),
    ]
    assert all(value == "" for name, value in rows[-1].items() if ": " in name), (
        "nobody decides after the last round"
    )


def test_a_trial_without_pictures_has_a_table_of_agents() -> None:
    found = of("minisim", steps=6, width=4)
    header, rows = replay.table(Trace(**{**found.__dict__, "frames": []}))
    told = list(rows)
    assert len(told) == 6 * 8
    assert told[0][:4] == [0, 0, 0, None]
    assert len({len(row) for row in told} | {len(header)}) == 1


@pytest.mark.parametrize(
    "simulator", some(["minisim", "inverted-pendulum", "xor"], "xor")
)
def test_a_moving_picture_shows_every_state_or_some_and_stays_at_the_end(
    simulator: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gif, "MOST_FRAMES", 12)
    settings = {
        "minisim": {"steps": 10, "width": 5},
        "inverted-pendulum": {"steps": 30},
        "xor": {},
    }
    found = of(simulator, **settings[simulator])
    picture = Image.open(io.BytesIO(gif.gif(found, "a very long title " * 20)))
    assert picture.format == "GIF"
    assert 2 <= picture.n_frames <= gif.MOST_FRAMES + 1
    assert picture.n_frames <= len(found.frames)
    durations = []
    for number in range(picture.n_frames):
        picture.seek(number)
        durations.append(picture.info["duration"])
    assert durations[-1] == 1500
    assert picture.info["loop"] == 0


def test_a_gif_of_a_trial_without_pictures_is_refused() -> None:
    found = of("minisim", steps=6, width=4)
    with pytest.raises(
        Exception, match="x: its simulator draws no picture; expected html or csv"
    ):
        gif.gif(Trace(**{**found.__dict__, "frames": []}), "x")


def test_the_command_writes_the_requested_format(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for kind in ("gif", "html", "csv"):
        said = typed(str(folder), "--to", kind, "--generation", "1", "--candidate", "2")
        assert said.output.startswith(
            f"minisim-replay.{kind}: minisim, generation 1, candidate 2, trial 0, fitness "
        )
    assert sorted(os.listdir()) == [
        f"minisim-replay.{kind}" for kind in ("csv", "gif", "html")
    ]
    said = typed(str(folder), "--to", "html", "-o", "x.html", "--json")
    told = json.loads(said.stdout)
    assert (told["file"], told["run"], told["note"], told["error"]) == (
        "x.html",
        "minisim",
        "",
        "",
    )


def test_the_command_opens_the_browser_with_a_file_of_the_run(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here the browser is a program that notes what it is to open."""
    noted = tmp_path / "noted"
    browser = tmp_path / "browser"
    browser.write_text(
        f"#!{sys.executable}\nimport sys\nopen({str(noted)!r}, 'w').write(sys.argv[1])\n"
    )
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    monkeypatch.setattr("webbrowser._tryorder", None)
    said = typed(str(folder))
    assert said.output.startswith(f"{folder / 'replay.html'}: ")
    assert noted.read_text() == (folder / "replay.html").as_uri()
    assert "no browser" not in said.output


def test_without_a_browser_the_file_is_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    said = typed(str(folder))
    assert said.output.endswith("(no browser was found: open this file in one)\n")
    assert Path(said.output.split(": ")[0]).read_text().startswith("<!doctype html>")


def test_an_unknown_file_extension_is_refused(folder: Path) -> None:
    with pytest.raises(
        Exception, match=r"film.mp4: expected a name that ends in .gif, .html or .csv"
    ):
        typed(str(folder), "-o", "film.mp4")
