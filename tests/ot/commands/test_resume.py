"""A finished run that is resumed is told again: nothing starts, and its record stays as it is."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import zswarm
from tests.ot.invented_record import written
from zswarm.errors import ConfigError
from zswarm.ot.cli import command
from zswarm.ot.cluster import connection
from zswarm.ot.logger import Logger, Result, Started
from zswarm.ot.record.reader import Run


def test_a_finished_run_is_reported_again_and_nothing_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = written(tmp_path, [1, 2.5])
    recorded = (folder / "run.sqlite").read_bytes()
    monkeypatch.setattr(connection.Connection, "open", None)
    done = CliRunner().invoke(command, ["resume", str(folder)], catch_exceptions=False)
    assert "best fitness 2.5 after 2 generations, 6 evaluations" in done.stdout
    assert f"history {Run(folder).history_hash}" in done.stdout
    assert f"{folder} is finished; to evolve further" in done.stderr
    told = (
        CliRunner()
        .invoke(command, ["resume", str(folder), "--json"], catch_exceptions=False)
        .stdout
    )
    assert (json.loads(told)["event"], json.loads(told)["best"]) == ("done", 2.5)
    assert (folder / "run.sqlite").read_bytes() == recorded, "nor is it resumed once more"


def test_resuming_a_finished_run_returns_its_result(tmp_path: Path) -> None:
    """Nothing is evaluated, and its record stays as it is."""
    folder = written(tmp_path, [1, 2.5])
    recorded = (folder / "run.sqlite").read_bytes()
    heard: list[Any] = []

    class Hearing(Logger):
        def on_start(self, run: Started) -> None:
            heard.append(run.generation)

        def on_end(self, result: Result | None) -> None:
            heard.append(result)

    with zswarm.resume(folder, loggers=Hearing()) as evolution:
        assert list(evolution) == []
    assert evolution.result is not None
    assert (evolution.result.best, evolution.result.history_hash) == (
        2.5,
        Run(folder).history_hash,
    )
    assert heard == [2, evolution.result]
    assert (folder / "run.sqlite").read_bytes() == recorded


def test_a_finished_run_whose_experiment_was_changed_is_refused(tmp_path: Path) -> None:
    folder = written(tmp_path, [1, 2.5])
    file = folder / "experiment.toml"
    file.write_text(re.sub("(?m)^seed = 1$", "seed = 2", file.read_text()))
    with pytest.raises(ConfigError):
        CliRunner().invoke(
            command, ["resume", str(folder), "--servers", "local"], catch_exceptions=False
        )


def test_going_back_further_than_there_are_generations_is_refused(tmp_path: Path) -> None:
    folder = written(tmp_path, [1, 2.5])
    recorded = (folder / "run.sqlite").read_bytes()
    with pytest.raises(ConfigError, match="2 generations are finished: expected 1 to 3"):
        CliRunner().invoke(
            command, ["resume", str(folder), "--from", "4"], catch_exceptions=False
        )
    assert (folder / "run.sqlite").read_bytes() == recorded
    assert sorted(path.suffix for path in folder.iterdir() if "before" in path.name) == []


def test_a_machine_that_is_not_banned_cannot_be_trusted_again(tmp_path: Path) -> None:
    folder = written(tmp_path, [1, 2.5])
    file = folder / "experiment.toml"
    file.write_text(re.sub("(?m)^generations = 2$", "generations = 3", file.read_text()))
    arguments = ["resume", str(folder), "--trust", "lab-02", "--servers", "1"]
    with pytest.raises(
        ConfigError, match="'lab-02' is not banned; banned machines: none"
    ):
        CliRunner().invoke(command, arguments, catch_exceptions=False)


def test_no_machine_is_trusted_again_by_a_whole_study(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "experiment.toml").write_text("[study]\nrepeat = 2\n")
    with pytest.raises(ConfigError, match="--trust takes the folder of a run"):
        CliRunner().invoke(
            command, ["resume", str(folder), "--trust", "x"], catch_exceptions=False
        )
