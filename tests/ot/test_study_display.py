"""How a study shows itself: in 80 columns, without colour where it is not wanted, and as strict JSON."""

import io
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console
from small import small

from zswarm.experiment import load
from zswarm.ot.logger import Generation, Result
from zswarm.ot.playing import Ended, Follower
from zswarm.ot.study import Study
from zswarm.ot.study_display import JsonFollower, LiveFollower, PlainFollower, follower

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
    with Study.create(load(small(tmp_path, STUDY), ["generations=10"]), "small.toml", Path("runs")) as study:
        yield study


def result(study: Study, number: int, best: float) -> Ended:
    one = study.planned[number]
    return Ended(one, Result(str(study.folder / one.name), 10, best, 400, 0, "5e" * 16, 1.25, 0, 2))


def played(study: Study, follower: Follower) -> None:
    """Four runs end, one fails; the others are left."""
    follower.on_start(study, None)
    follower.on_begin(study.planned[0], 0)
    follower.on_generation(study.planned[0], Generation(0, 1.0, NAN, 50, 1, 2, {"best": 1.0}))
    follower.on_say("a-server is gone", study.planned[1])
    for number, best in enumerate([1.0, 2.0, 3.0, -float("inf")]):
        study.ended.append(result(study, number, best))
        follower.on_run(study.ended[-1])
    study.ended.append(Ended(study.planned[4], None, "a trial ended in a fault 3 times"))
    follower.on_run(study.ended[-1])
    follower.on_end(study._outcome(2.5))


def test_plain_lines_name_the_runs_and_the_table_fits(study: Study, capsys: pytest.CaptureFixture[str]) -> None:
    played(study, PlainFollower())
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
    assert ["severity", "0.25", "2", "2", "800"] in lines, "a failed run is below every number"
    assert "failed  severity-0-5-seed-9: a trial ended in a fault 3 times" in captured.out
    assert "\n4 of 10 runs finished, 2.5 s\nstudy   runs/small\nagain   zswarm-ot resume runs/small\n" in captured.out
    assert max(map(len, captured.out.splitlines())) <= 80
    assert "\x1b" not in captured.out + captured.err


def test_json_is_strict_and_has_all_of_it(study: Study, capsys: pytest.CaptureFixture[str]) -> None:
    def refuse(text: str) -> None:
        raise AssertionError(f"{text} is no JSON")

    played(study, JsonFollower())
    lines = [json.loads(line, parse_constant=refuse) for line in capsys.readouterr().out.splitlines()]
    assert [line["event"] for line in lines] == ["generation", "run", "run", "run", "run", "failed", "done"]
    assert lines[0] == {
        "event": "generation", "run": "runs/small/severity-0-5-seed-7", "generation": 0, "best": 1.0, "mean": None,
        "evaluations": 50, "servers": 1, "slots": 2,
    }  # fmt: skip
    assert (lines[1]["seed"], lines[1]["settings"], lines[1]["best"]) == (7, {"optimizer.severity": 0.5}, 1.0)
    assert lines[4]["best"] is None
    done = lines[-1]
    assert (done["runs"], done["finished"], done["failed"], done["median"], done["best"]) == (10, 4, 1, 1.5, 3.0)
    assert done["settings"][0] == {
        "settings": {"optimizer.severity": 0.5}, "runs": 2, "median": 2.0, "q25": 1.5, "q75": 2.5, "best": 3.0,
        "evaluations": 800,
    }  # fmt: skip
    assert done["settings"][1]["q25"] is None


def test_the_live_table_fits_however_many_runs_go_on(study: Study) -> None:
    follower = LiveFollower()
    follower.on_start(study, None)
    try:
        for one in study.planned:
            follower.on_begin(one, 3)
            follower.on_generation(one, Generation(3, -123456.789, NAN, 500, 1, 2, {}))
        shown = io.StringIO()
        Console(file=shown, width=80).print(follower._table())
    finally:
        follower.on_end(None)
    lines = shown.getvalue().splitlines()
    assert lines[0].startswith("0/10 runs")
    assert lines[1].split() == ["severity-0-5-seed-7", "4/10", "best", "-1.2346e+05"]
    assert "and 2 more" in lines[-1]
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(("terminal", "moving"), [("xterm", True), ("dumb", False), ("", False)])
def test_only_where_lines_can_be_written_over_does_a_table_move(
    terminal: str, moving: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a single run does."""
    monkeypatch.setenv("TERM", terminal)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert type(follower(as_json=False)) is (LiveFollower if moving else PlainFollower)


def test_of_scores_it_says_that_they_do_not_compare(study: Study, capsys: pytest.CaptureFixture[str]) -> None:
    """The command that would refuse to compare them is not suggested."""
    ended = result(study, 0, 12.0)
    assert ended.result is not None
    study.ended = [ended._replace(result=ended.result._replace(relative=True))]
    PlainFollower().on_end(study._outcome(1.0))
    told = capsys.readouterr().out
    assert "Candidates of these runs played each other" in told
    assert "zswarm-ot compare" not in told
