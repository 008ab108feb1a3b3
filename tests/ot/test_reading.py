"""Runs are listed, whatever is in the folder."""

from pathlib import Path

from zswarm import experiment
from zswarm.ot.reading import listed
from zswarm.ot.record import Record


def test_runs_are_listed_with_the_damaged_ones_named(tmp_path: Path) -> None:
    complete = experiment.complete(experiment.load(experiment.find("emergency-exit")), "test")
    Record.create(tmp_path, complete, "hash").close()
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "run.sqlite").write_bytes(b"no database at all, but long enough to be looked at" * 20)
    found = {Path(row["run"]).name: row for row in listed(tmp_path)}
    assert "damaged" in found["damaged"]["error"]
    assert found["emergency-exit"]["generations"] == 0


def test_a_run_that_goes_on_is_listed_with_what_it_has_committed(tmp_path: Path) -> None:
    complete = experiment.complete(experiment.load(experiment.find("emergency-exit")), "test")
    with Record.create(tmp_path, complete, "hash") as record:
        record.set_meta("history_hash", "0" * 32)
        assert [row["history_hash"] for row in listed(tmp_path)] == ["0" * 32]
