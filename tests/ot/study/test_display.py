"""A study is shown in 80 columns, without colour where it is not wanted, and as strict JSON."""

import io
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console

from tests.smallest_experiment import small
from zswarm.experiment import load
from zswarm.ot.logger import Generation, Result, Started
from zswarm.ot.study.display import (
    JsonStudyDisplay,
    LiveStudyDisplay,
    PlainStudyDisplay,
    display,
)
from zswarm.ot.study.outcome import RunEnded, StudyLogger, summarize
from zswarm.ot.study.study import Study

STUDY = """
[study]
repeat = 5
[study.grid]
"optimizer.severity" = [0.5, 0.25]
"""
NAN = float("nan")


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Study]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    with Study.create(
        load(small(tmp_path, STUDY), ["generations=10"]), "small.toml", Path("runs")
    ) as study:
        yield study


def result(study: Study, number: int, best: float) -> RunEnded:
    one = study.planned[number]
    return RunEnded(
        one, Result(str(study.folder / one.name), 10, best, 400, 0, "5e" * 16, 1.25, 0, 2)
    )


def played(study: Study, shown: StudyLogger) -> None:
    """Let four runs end and one fail; the others remain."""
    for line in study._lines(None):
        shown.on_say(line)
    first = shown.run_logger(study.planned[0])
    first.on_start(Started(study.folder / "x", study.planned[0].experiment, 0))
    first.on_generation(Generation(0, 1.0, NAN, 50, 1, 2, {"best": 1.0}))
    shown.run_logger(study.planned[1]).on_say("a-server is gone")
    for number, best in enumerate([1.0, 2.0, 3.0, -float("inf")]):
        study.ended.append(result(study, number, best))
        shown.on_run(study.ended[-1])
    study.ended.append(
        RunEnded(study.planned[4], None, "a trial ended in a fault 3 times")
    )
    shown.on_run(study.ended[-1])
    shown.on_outcome(summarize(str(study.folder), study.planned, study.ended, 2.5))


def test_plain_lines_name_the_runs_and_the_table_fits(
    study: Study, capsys: pytest.CaptureFixture[str]
) -> None:
    played(study, PlainStudyDisplay(study))
    captured = capsys.readouterr()
    assert captured.err.splitlines() == [
        "small, 10 runs of 2 settings",
        "severity-0-25-seed-7: a-server is gone",
        "severity-0-5-seed-7  best 1  400 evaluations, 1.2 s  doubtful: 2 trials  (1 of 10)",
        "severity-0-25-seed-7  best 2  400 evaluations, 1.2 s  doubtful: 2 trials  (2 of 10)",
        "severity-0-5-seed-8  best 3  400 evaluations, 1.2 s  doubtful: 2 trials  (3 of 10)",
        "severity-0-25-seed-8  best -inf  400 evaluations, 1.2 s  doubtful: 2 trials  (4 of 10)",
        "severity-0-5-seed-9  failed: a trial ended in a fault 3 times  (5 of 10)",
    ]
    lines = [line.split() for line in captured.out.splitlines()]
    assert ["severity", "0.5", "2", "1.5", "2", "2.5", "3", "800"] in lines
    assert ["severity", "0.25", "2", "2", "800"] in lines, (
        "a failed run is below every number"
    )
    assert "failed  severity-0-5-seed-9: a trial ended in a fault 3 times" in captured.out
    assert (
        "\n4 of 10 runs finished, 2.5 s\nstudy   runs/small\nagain   zswarm-ot resume runs/small\n"
        in captured.out
    )
    assert max(map(len, captured.out.splitlines())) <= 80
    assert "\x1b" not in captured.out + captured.err


def test_json_is_strict_and_complete(
    study: Study, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(text: str) -> None:
        raise AssertionError(f"{text} is not JSON")

    played(study, JsonStudyDisplay(study))
    lines = [
        json.loads(line, parse_constant=refuse)
        for line in capsys.readouterr().out.splitlines()
    ]
    assert [line["event"] for line in lines] == [
        "generation",
        "run",
        "run",
        "run",
        "run",
        "failed",
        "done",
    ]
    assert lines[0] == {
        "event": "generation",
        "run": "runs/small/severity-0-5-seed-7",
        "generation": 0,
        "best": 1.0,
        "mean": None,
        "evaluations": 50,
        "servers": 1,
        "slots": 2,
        "trials": 1,
    }
    assert (lines[1]["seed"], lines[1]["settings"], lines[1]["best"]) == (
        7,
        {"optimizer.severity": 0.5},
        1.0,
    )
    assert lines[4]["best"] is None
    done = lines[-1]
    assert (
        done["runs"],
        done["finished"],
        done["failed"],
        done["median"],
        done["best"],
    ) == (
        10,
        4,
        1,
        1.5,
        3.0,
    )
    assert done["settings"][0] == {
        "settings": {"optimizer.severity": 0.5},
        "runs": 2,
        "median": 2.0,
        "q25": 1.5,
        "q75": 2.5,
        "best": 3.0,
        "held_out": None,
        "evaluations": 800,
        "trials": 1,
    }
    assert done["settings"][1]["q25"] is None


def test_the_live_table_fits_with_any_number_of_runs(study: Study) -> None:
    shown = LiveStudyDisplay(study)
    try:
        for one in study.planned:
            logger = shown.run_logger(one)
            logger.on_start(Started(study.folder / one.name, one.experiment, 3))
            logger.on_generation(Generation(3, -123456.789, NAN, 500, 1, 2, {}))
        text = io.StringIO()
        Console(file=text, width=80).print(shown.progress.get_renderable())
    finally:
        shown.on_outcome(None)
    lines = text.getvalue().splitlines()
    assert lines[0].startswith("0/10 runs")
    assert lines[0].split()[2] == "10/70", (
        "each of 10 runs resumed after 3 of 10 generations"
    )
    assert lines[1].split()[:4] == ["severity-0-5-seed-7", "4/10", "best", "-1.2346e+05"]
    assert len(lines) == 11
    assert max(map(len, lines)) <= 80


def test_a_failed_run_leaves_the_live_table_and_its_total(study: Study) -> None:
    shown = LiveStudyDisplay(study)
    try:
        one = study.planned[0]
        shown.run_logger(one).on_start(
            Started(study.folder / one.name, one.experiment, 0)
        )
        shown.on_run(RunEnded(one, None, "a fault"))
        (whole,) = shown.progress.tasks
    finally:
        shown.on_outcome(None)
    assert (whole.description, whole.completed, whole.total) == ("1/10 runs", 0, 90)


@pytest.mark.parametrize(
    ("terminal", "moving"), [("xterm", True), ("dumb", False), ("", False)]
)
def test_only_a_terminal_that_can_overwrite_lines_gets_a_live_table(
    terminal: str, moving: bool, study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A single run does the same."""
    monkeypatch.setenv("TERM", terminal)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    expected = LiveStudyDisplay if moving else PlainStudyDisplay
    shown = display(study, as_json=False)
    shown.on_outcome(None)
    assert type(shown) is expected


def test_the_summary_of_relative_runs_suggests_no_comparison(
    study: Study, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command that would refuse to compare them is not suggested."""
    ended = result(study, 0, 12.0)
    assert ended.result is not None
    study.ended = [ended._replace(result=ended.result._replace(relative=True))]
    outcome = summarize(str(study.folder), study.planned, study.ended, 1.0)
    PlainStudyDisplay(study).on_outcome(outcome)
    told = capsys.readouterr().out
    assert "Candidates of these runs played each other" in told
    assert "zswarm-ot compare" not in told
