"""The trials that a page steps through, of one run or of two."""

import base64
import json
import re
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from tests.evaluated_record import SHORT, played
from zswarm.errors import ConfigError
from zswarm.ot import cli
from zswarm.ot.record.reader import Run
from zswarm.ot.replay import steps
from zswarm.ot.replay.encoding import encode
from zswarm.ot.replay.trace import trace

TRIALS = 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    overrides = (*SHORT, f"problem.trials={TRIALS}")
    out = tmp_path_factory.mktemp("runs")
    return played(out, overrides=overrides, generations=4)


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("others")
    return played(out, "inverted-pendulum", ("problem.settings.steps=20",))


def typed(*arguments: str) -> Result:
    return CliRunner().invoke(cli.command, ["replay", *arguments], catch_exceptions=False)


def written(text: str) -> tuple[list[dict[str, Any]], list[bytes]]:
    """Return the menus of a page, and its traces."""
    (index,) = re.findall(r'id="index">([^<]*)</script>', text)
    packed = re.findall(r'class="trace">([^<]*)</script>', text)
    return json.loads(index), [base64.b64decode(one) for one in packed]


def header_of(encoded: bytes) -> dict[str, Any]:
    end = 16 + int.from_bytes(encoded[12:16], "little")
    header: dict[str, Any] = json.loads(encoded[16:end])
    return header


def test_all_generations_and_trials_are_in_a_page(folder: Path, tmp_path: Path) -> None:
    """Each trace is that of the trial when it is played alone; the best is shown first."""
    run, output = Run(folder), tmp_path / "x.html"
    said = typed(str(folder), "--generations", "all", "--trials", "-o", str(output))
    assert "; 12 trials" in said.output
    (menus,), traces = written(output.read_text())
    every = [(one["generation"], one["trial"]) for one in menus["trials"]]
    assert every == [(a, b) for a in range(4) for b in range(TRIALS)]
    best = next(row["generation"] for row in run.history() if row["best"] == run.best())
    assert every[menus["start"]] == (best, 0)
    alone = trace(run, 2, None, 1)
    at = every.index((2, 1))
    assert traces[at] == encode(alone)
    assert menus["trials"][at]["fitness"] == alone.fitness
    assert alone.note == ""


def test_numbers_name_generations_from_one_in_their_order(folder: Path) -> None:
    chosen = steps.choose(Run(folder), None, None, 0, "4,1,4")
    assert chosen.trials == [(0, 0), (3, 0)]
    chosen = steps.choose(Run(folder), 0, None, 2, "4,1", trials=True)
    assert chosen.trials[chosen.start] == (0, 2)
    assert len(chosen.trials) == 2 * TRIALS


def test_rising_generations_are_those_in_which_the_best_rose(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, best = Run(folder), [None, 1.0, 1.0, 2.0]
    rows = [{"generation": number, "best": value} for number, value in enumerate(best)]
    monkeypatch.setattr(run, "history", lambda: rows)
    assert steps.choose(run, 3, None, 0, "rising").trials == [(1, 0), (3, 0)]
    monkeypatch.setattr(run, "history", lambda: rows[:1])
    assert steps.choose(run, 0, None, 0, "rising").trials == [(0, 0)]


def test_trials_of_a_tournament_are_those_of_all_games(tmp_path: Path) -> None:
    import numpy as np

    games = np.array([[0, 1], [1, 2], [2, 3], [3, 1]], np.uint32)
    path = played(
        tmp_path,
        "minisim-duel",
        ("problem.settings.steps=20", "problem.settings.width=10", "problem.trials=2"),
        games=games,
    )
    chosen = steps.choose(Run(path), 0, 1, 0, trials=True)
    assert chosen.trials == [(0, trial) for trial in range(6)]
    assert [found.about["trial"] for found in chosen.play()] == list(range(6))


def test_two_runs_are_in_one_page(folder: Path, light: Path, tmp_path: Path) -> None:
    output = tmp_path / "x.html"
    said = typed(str(folder), str(light), "--to", "html", "-o", str(output), "--json")
    told = json.loads(said.stdout)
    assert [one["simulator"] for one in told["trials"]] == [
        "minisim",
        "inverted-pendulum",
    ]
    menus, traces = written(output.read_text())
    assert [len(side["trials"]) for side in menus] == [1, 1]
    assert len(traces) == 2


def test_kinds_have_one_colour_in_all_trials_of_a_simulator(
    folder: Path, light: Path, tmp_path: Path
) -> None:
    """Another simulator begins the palette again."""
    output = tmp_path / "x.html"
    typed(str(light), str(folder), "--trials", "-o", str(output))
    _, traces = written(output.read_text())
    first, *others = (
        dict(zip(header["kinds"], header["colours"], strict=True))
        for header in map(header_of, traces)
    )
    assert "c1" in first.values()
    assert [colours["robot"] for colours in others] == ["c1"] * TRIALS
    for one in others:
        assert {kind: others[-1].get(kind, name) for kind, name in one.items()} == one


def test_each_of_two_runs_may_have_its_generation(folder: Path, tmp_path: Path) -> None:
    for given, expected in (((1, 3), [0, 2]), ((2,), [1, 1])):
        options = [word for one in given for word in ("--generation", str(one))]
        output = str(tmp_path / "x.html")
        said = typed(str(folder), str(folder), *options, "-o", output, "--json")
        told = json.loads(said.stdout)["trials"]
        assert [one["generation"] for one in told] == expected


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--generations", "1,9"], "no generation 9; it has generations 1 to 4"),
        (["--generations", "0"], "no generation 0; it has generations 1 to 4"),
        (["--generations", "1,x"], "expected all, rising, or generations such as"),
        (["--generations", ""], "expected all, rising, or generations such as"),
        (["--generation", "5"], "no generation 5; it has generations 1 to 4"),
        (["--generation", "2", "--generations", "1,3"], "--generation 2 is not one of"),
        (["--generation", "1", "--generation", "2"], "is given 2 times for 1 run"),
        (["--candidate", "1", "--generations", "all"], "--candidate is one of a gen"),
        (["--trials", "--trial", "3"], "no trial 3; it has trials 0 to 2"),
        (["--trials", "--trial", "-1"], "no trial -1; it has trials 0 to 2"),
        (["--trials", "--to", "gif"], "--to gif shows one trial; expected html"),
        (["--generations", "all", "-o", "x.csv"], "--to csv shows one trial"),
    ],
)
def test_what_is_impossible_is_refused_in_one_line(
    folder: Path, options: list[str], reason: str
) -> None:
    with pytest.raises(ConfigError) as raised:
        typed(str(folder), *options)
    assert reason in str(raised.value)
    assert "\n" not in str(raised.value)


def test_too_many_trials_are_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(steps, "MOST_TRIALS", 5)
    with pytest.raises(ConfigError, match="more than 5 trials; name fewer generations"):
        steps.choose(Run(folder), None, None, 0, "all", trials=True)


def test_too_large_a_page_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("zswarm.ot.commands.replay.LARGEST", 1 << 10)
    with pytest.raises(ConfigError, match="the page would have more than 0 MB"):
        typed(str(folder), "--trials", "-o", str(tmp_path / "x.html"))
    assert not (tmp_path / "x.html").exists()


def test_a_run_without_genomes_is_refused_in_one_line(tmp_path: Path) -> None:
    path = played(tmp_path, overrides=SHORT)
    with sqlite3.connect(path / "run.sqlite") as database:
        database.execute("UPDATE candidates SET genome = NULL")
    database.close()
    with pytest.raises(ConfigError) as raised:
        typed(str(path), "--generations", "all")
    assert re.search(
        r"the genome of candidate \d in generation 1 was not kept", str(raised.value)
    )
    assert "\n" not in str(raised.value)
