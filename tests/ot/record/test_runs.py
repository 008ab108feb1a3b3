"""Runs are found below folders."""

import shutil
from pathlib import Path

import pytest

from tests.ot.record.recorded import complete, make
from zswarm.errors import ConfigError
from zswarm.ot.record.folder import DATABASE, load_experiment
from zswarm.ot.record.reader import Run
from zswarm.ot.record.runs import runs_below
from zswarm.ot.record.summary import list_runs
from zswarm.ot.record.writer import Record


def test_runs_are_listed_with_the_damaged_ones_named(folder: Path) -> None:
    (folder.parent / "damaged").mkdir()
    (folder.parent / "damaged" / "run.sqlite").write_bytes(
        b"no database at all, but long enough to be looked at" * 20
    )
    found = {Path(row["run"]).name: row for row in list_runs(folder.parent)}
    assert "no experiment.toml" in found["damaged"]["error"]
    assert (
        found["lab"]["generations"],
        found["lab"]["best"],
        found["lab"]["candidates"],
    ) == (
        2,
        2.625,
        4,
    )


def test_an_active_run_is_listed_with_what_it_has_committed(record: Record) -> None:
    record.set_meta("history_hash", "0" * 32)
    record.sync()
    assert [row["history_hash"] for row in list_runs(record.folder.parent)] == ["0" * 32]


def test_runs_below_a_folder_are_found_in_the_order_of_their_numbers(
    tmp_path: Path,
) -> None:
    for name in ("seed-10", "seed-9", "seed-2"):
        make(tmp_path / "study", name)
    make(tmp_path, "alone")
    assert [run.name for run in runs_below([tmp_path])] == [
        "alone",
        "seed-2",
        "seed-9",
        "seed-10",
    ]
    assert [
        run.name
        for run in runs_below([tmp_path / "study" / "seed-9", tmp_path / "study"])
    ] == [
        "seed-9",
        "seed-2",
        "seed-10",
    ]
    assert [Path(row["run"]).name for row in list_runs(tmp_path)] == [
        "alone",
        "seed-2",
        "seed-9",
        "seed-10",
    ]


def test_an_unreadable_run_is_omitted_from_its_folder_with_one_line(
    tmp_path: Path,
) -> None:
    """Given itself, or alone, it is an error; so are all without a list for the lines."""
    whole, broken = (
        Record.create(tmp_path, complete(), "hash", name=name).folder
        for name in ("whole", "broken")
    )
    (broken / DATABASE).write_bytes(b"no database")
    left_out: list[str] = []
    assert [run.folder for run in runs_below([tmp_path], left_out)] == [whole]
    assert len(left_out) == 1
    assert left_out[0].startswith(f"left out: {broken}/{DATABASE}: damaged")
    shutil.rmtree(whole)
    for paths in ([broken], [tmp_path]):
        with pytest.raises(ConfigError, match="damaged"):
            runs_below(paths, [])


def test_a_run_that_is_named_without_its_parent_is_suggested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The suggestion is made to programs that resume, plot or read the run."""
    make(tmp_path / "runs", "lab")
    monkeypatch.chdir(tmp_path)
    for call in (load_experiment, Run, lambda path: runs_below([path])):
        with pytest.raises(
            ConfigError, match=r"lab: no run \(did you mean runs/lab\?\); expected"
        ):
            call(Path("lab"))
        with pytest.raises(ConfigError, match="nothing: no run; expected"):
            call(Path("nothing"))
