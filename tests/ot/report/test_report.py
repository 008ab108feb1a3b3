"""The HTML page about a run: all in one file, whatever the record holds."""

import contextlib
import re
import sqlite3
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

import zswarm
from tests.ot.invented_record import EXPERIMENT, written
from tests.ot.record.sealing import reseal
from zswarm import experiment
from zswarm.champion.controller import CHAMPION, load_controller
from zswarm.ot import cli
from zswarm.ot.notes import Note
from zswarm.ot.record.reader import Run
from zswarm.ot.record.runs import runs_below
from zswarm.ot.replay import held_out
from zswarm.ot.report import champion as champions
from zswarm.ot.report import report
from zswarm.sims.emergency_exit import EmergencyExit

EVIL = (
    "</td></table><script src='https://evil.example/x.js'>alert(1)</script>\"' onload=x "
    "\x1b[31m \u202e{{ 7 * 7 }}"
)
SHOWN = (
    "</td></table><script src='https://evil.example/x.js'>alert(1)</script>\"' onload=x "
    "\\x1b[31m \\x202e{{ 7 * 7 }}"
)
TAGS = {
    *(
        "html",
        "head",
        "meta",
        "title",
        "style",
        "body",
        "h1",
        "h2",
        "p",
        "div",
        "table",
        "thead",
        "tbody",
        "tr",
        "th",
        "td",
    ),
    *("mark", "span", "strong", "code", "pre", "details", "summary", "ul", "li"),
    *(
        "svg",
        "g",
        "path",
        "use",
        "defs",
        "rect",
        "clippath",
        "circle",
        "polyline",
        "text",
        "animate",
    ),
}


class Page(HTMLParser):
    """Collect what a browser would see: tags, attributes and texts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: list[tuple[str, str | None]] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes += attrs

    def handle_data(self, data: str) -> None:
        self.text += data


def assert_harmless(text: str) -> Page:
    """Check that no tag or attribute runs or loads anything, and that loading is forbidden."""
    page = Page(text)
    assert page.tags <= TAGS
    for name, value in page.attributes:
        assert not name.startswith("on")
        assert name not in ("src", "href", "action", "srcset")
        assert name != "xlink:href" or str(value).startswith("#")
        assert not re.search(r"https?:|//|url\((?!#)", value or "")
    assert "@import" not in text
    assert "default-src 'none'" in text
    return page


def test_a_page_shows_the_run(tmp_path: Path) -> None:
    notes = [
        Note("server_joined", "lab-1"),
        Note("fault", "lab-1", "timed out"),
        Note("fault", "lab-2", "crashed"),
    ]
    folder = written(tmp_path, [1, 2, 3.5], notes=notes)
    page = assert_harmless(report.of_run(Run(folder), trials=3))
    run = Run(folder)
    assert (
        "nnga evolved a fully-meshed controller of fitness 3.5 in 3 generations, with 9 "
        "evaluations on 1 server" in page.text
    )
    assert str(run.history_hash) in page.text
    assert "svg" in page.tags
    assert "Every one of 3 trials was the same, with fitness" in page.text, (
        "in the stadium nothing depends on the seed"
    )
    assert "escaped" in page.text  # a metric of the simulator
    assert "The champion at work" in page.text
    assert "animate" in page.tags
    assert "lab-1-0123abcd" in page.text
    assert page.text.index("fault") < page.text.index("server joined")


SAME = "anyone who runs this experiment with the same code gets the same one"


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        (
            "INSERT INTO meta VALUES ('imported_from', 'best.zre: generation 4')",
            "not evolved here: best.zre: generation 4",
        ),
        (
            "UPDATE outcomes SET faulted = 1 WHERE id = 1",
            "1 trial failed by what a machine did",
        ),
        (
            "UPDATE outcomes SET doubtful = 1 WHERE id < 3",
            "6 trials came from a server that was later proved to compute wrong",
        ),
    ],
)
def test_the_report_claims_repeatability_only_if_others_can_repeat_the_run(
    tmp_path: Path, sql: str, words: str
) -> None:
    folder = written(tmp_path, [1, 2])
    page = Page(report.of_run(Run(folder), trials=0)).text
    assert SAME in page
    assert "the same history hash" in page
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as database, database:
        database.execute(sql)
    reseal(folder)
    page = Page(report.of_run(Run(folder), trials=0)).text
    assert words in page
    assert SAME not in page
    assert "the same history hash" not in page
    assert "bit by bit" not in page


def test_a_page_shows_what_was_run_also_if_the_file_was_changed(tmp_path: Path) -> None:
    folder = written(tmp_path, [1, 2], seed=3)
    file = folder / "experiment.toml"
    file.write_text(file.read_text().replace("seed = 3", "seed = 4", 1))
    page = Page(report.of_run(Run(folder), trials=0)).text
    assert "experiment.toml was changed after the run began (seed)" in page
    assert SAME not in page


def test_the_weights_are_those_of_the_champion(tmp_path: Path) -> None:
    champion = load_controller(written(tmp_path, [1], hidden=1))
    weights = champions.sections(champion, 0)["weights"]
    assert weights is not None
    assert weights.rows == ["hidden 1", "vx", "vy"]
    assert weights.columns == [
        *(f"input {n}" for n in range(1, 11)),
        "hidden 1",
        "vx",
        "vy",
        "bias",
    ]
    assert [row[0][0] for row in weights.cells] == pytest.approx(
        [-1.0, -1 + 2 * 14 / 41, -1 + 2 * 28 / 41]
    )
    damaged = msgspec.structs.replace(champion, genome=b"1234")
    assert champions.sections(damaged, 0)["weights"] is None


def test_hostile_texts_stay_texts(tmp_path: Path) -> None:
    """Names, events, meta and the champion contain such texts; the page shows them cleaned."""
    folder = written(tmp_path, [1, 2], notes=[Note("fault", EVIL, EVIL)])
    database = sqlite3.connect(folder / "run.sqlite")
    with database:
        database.execute("UPDATE outcomes SET server = ?", (EVIL,))
        database.execute("UPDATE events SET event = ?, at = 1e300", (EVIL,))
        database.executemany(
            "UPDATE meta SET value = ? WHERE key = ?",
            [(EVIL, key) for key in ("machine", "zswarm")],
        )
    database.close()
    reseal(folder)
    champion = load_controller(folder)
    hostile = msgspec.structs.replace(
        champion, simulator=EVIL, sensors=[EVIL], actuators=[EVIL, EVIL]
    )
    (folder / CHAMPION).write_bytes(msgspec.msgpack.encode(hostile))
    renamed = folder.rename(tmp_path / "<img src=x onerror=alert(1)> $(reboot)")
    text = report.of_run(Run(renamed), trials=1)
    page = assert_harmless(text)
    assert page.text.count(SHOWN) >= 8
    assert "<img src=x onerror=alert(1)> $(reboot)" in page.text
    assert "zswarm-ot resume" not in page.text
    # Copying it reboots nothing.
    assert re.search(r"zswarm-ot plot '[^']*<img[^']*\$\(reboot\)'", page.text)
    assert "\x1b" not in text
    assert "\u202e" not in text


def test_a_simulator_that_is_not_installed_is_named(tmp_path: Path) -> None:
    folder = written(tmp_path, [1, 2], simulator="not-here")
    page = assert_harmless(report.of_run(Run(folder), trials=10))
    assert (
        "It was not played on held-out seeds: unknown simulator 'not-here'" in page.text
    )
    assert "The champion at work" not in page.text


def test_a_simulator_that_cannot_draw_is_reported_and_the_rest_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its author must see what it raised."""

    def frame(_self: EmergencyExit) -> None:
        raise IndexError("no such <cell>\x1b[0m")

    monkeypatch.setattr(EmergencyExit, "frame", frame)
    page = assert_harmless(report.of_run(Run(written(tmp_path, [1, 2])), trials=1))
    assert (
        "The first of the held-out trials could not be drawn: IndexError: no such <cell>\\x1b[0m"
        in page.text
    )
    assert "Weights of the champion" in page.text


def test_a_run_without_a_generation_has_a_page(tmp_path: Path) -> None:
    page = assert_harmless(
        report.of_run(Run(written(tmp_path, [], finished=False)), trials=10)
    )
    assert "no generation is finished yet" in page.text
    assert "zswarm-ot resume" in page.text


def test_many_events_are_folded_and_some_omitted(tmp_path: Path) -> None:
    folder = written(
        tmp_path,
        [1],
        notes=[Note("requeued", "lab-1", "gone", 3)] * (report.MAX_EVENTS + 5),
    )
    text = report.of_run(Run(folder), trials=0)
    assert "5 more are in the record" in text
    assert "<details>" in text


def test_a_study_has_a_page_with_its_comparison(tmp_path: Path) -> None:
    for hidden in (1, 2):
        for seed in range(4):
            written(
                tmp_path / "study", [hidden, hidden + seed / 8], hidden=hidden, seed=seed
            )
    output = tmp_path / "study.html"
    result = CliRunner().invoke(
        cli.command,
        ["report", str(tmp_path / "study"), "-o", str(output)],
        catch_exceptions=False,
    )
    assert result.output == f"{output}\n"
    page = assert_harmless(output.read_text())
    assert "8 runs in 2 groups; 8 finished." in page.text
    assert "hidden 2 has a higher best fitness in search than hidden 1" in page.text
    assert (
        "zswarm-ot run study/stadium/experiment.toml # one of the runs again"
        in " ".join(page.text.split())
    )
    study = '[study]\nrepeat = 4\n[study.grid]\n"representation.hidden" = [1, 2]\n'
    (tmp_path / "study" / "experiment.toml").write_text(
        experiment.to_toml(EXPERIMENT) + study
    )
    page = Page(report.of_study(tmp_path / "study", runs_below([tmp_path / "study"])))
    text = " ".join(page.text.split())
    assert "zswarm-ot run study/experiment.toml # again" in text
    assert "representation.hidden1 default 22 What they have in common" in text
    assert "seed0 to 3 generations2 study.repeat4 default 1 problem.simulator" in text
    assert str(tmp_path) not in page.text


def test_the_same_run_has_the_same_page(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1, 2]))
    assert report.of_run(run, trials=2) == report.of_run(run, trials=2)


def test_settings_that_differ_by_trial_are_shown(tmp_path: Path) -> None:
    """Words describe the range; the title of the film names the settings of its trial."""
    settings = {
        "field": {"choice": ["random", "stadium"]},
        "steps": {"from": 5, "to": 15},
    }
    page = assert_harmless(
        report.of_run(Run(written(tmp_path, [1], settings=settings)), trials=3)
    )
    assert "5 to 15, by trial" in page.text
    assert "random or stadium, by trial" in page.text
    drawn = zswarm.drawn(settings, held_out.trial_seed(champions.SEED, 0))
    assert (
        f"the first of the held-out trials, field {drawn['field']}, steps {drawn['steps']}"
        in page.text
    )
