"""Tags and notes from the command line."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.ot.invented_record import written
from zswarm.errors import ConfigError
from zswarm.ot.cli import command


def call(*arguments: object) -> str:
    runner = CliRunner(env={"COLUMNS": "300"})
    done = runner.invoke(command, [*map(str, arguments)], catch_exceptions=False)
    return done.stdout


def test_all_runs_of_a_study_are_tagged_and_list_shows_those_of_a_tag(
    tmp_path: Path,
) -> None:
    first, second = (written(tmp_path / "study", [1.0], seed=seed) for seed in (1, 2))
    call("note", tmp_path / "study", "--tag", "paper", "--tag", "draft")
    call("note", second, "--untag", "draft", "--text", "better\nthan the first")
    call("note", first, "--text", "")
    found = json.loads(call("note", tmp_path, "--json"))["runs"]
    assert [row["tags"] for row in found] == [["draft", "paper"], ["paper"]]
    assert [row["note"] for row in found] == ["", "better\nthan the first"]
    rows = json.loads(call("list", tmp_path, "--tag", "draft", "--json"))["runs"]
    assert [row["run"] for row in rows] == [str(first)]
    shown = call("list", tmp_path, "--tag", "paper")
    assert "tags and note" in shown
    assert "paper: better" in shown
    assert "none in" in call("list", tmp_path, "--tag", "other")


def test_a_tag_that_no_run_has_is_not_removed(tmp_path: Path) -> None:
    run = written(tmp_path, [1.0])
    with pytest.raises(ConfigError, match="--untag other: no run here has this tag"):
        command.main(["note", str(run), "--untag", "other"], standalone_mode=False)
