"""Recorded runs are read whatever their folders hold, and reading changes nothing."""

import fcntl
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from tests.ot.record.recorded import (
    BATCH,
    complete,
    content,
    edit,
    everything,
    refusal,
)
from zswarm.errors import ConfigError
from zswarm.ot.record.reader import Run
from zswarm.ot.record.runs import runs_below
from zswarm.ot.record.summary import list_runs
from zswarm.ot.record.writer import Record

# ---- what a run recorded


def test_a_run_is_read_as_it_was_recorded(folder: Path) -> None:
    run = Run(folder)
    assert (run.name, run.finished, run.going_on, run.generations(), run.best()) == (
        "lab",
        True,
        False,
        2,
        2.625,
    )
    assert run.experiment == complete("lab", "problem.trials=2")
    first, second = run.history()
    assert (first["generation"], first["best"], first["mean"], first["evaluations"]) == (
        0,
        0.625,
        0.375,
        2,
    )
    assert (second["best"], second["evaluations"], second["seconds"]) == (
        2.625,
        4,
        second["finished_at"] - first["finished_at"],
    )
    assert first["statistics"] == {"best": 0.625, "mean": 0.375, "diversity": None}
    assert [candidate["fitness"] for candidate in run.candidates(1)] == [2.125, 2.625]
    assert run.candidates(1)[1]["genome"] == b"\x01\x01" * 4
    assert [event["event"] for event in run.events()] == ["server_joined"] * 2
    assert [(server["server"], server["trials"]) for server in run.servers()] == [
        ("lab-01", 4),
        ("lab-02", 4),
    ]
    champion = run.champion()
    assert champion is not None
    assert champion.genome == b"\0" * 240


def test_trials_are_in_order_with_their_metrics_by_name(folder: Path) -> None:
    trials = Run(folder).trials(1)
    assert [(trial["candidate"], trial["trial"]) for trial in trials] == [
        (0, 0),
        (0, 1),
        (1, 0),
        (1, 1),
    ]
    assert trials[3] == {
        "candidate": 1,
        "trial": 1,
        "fitness": [1.375],
        "metrics": {"escaped": 3.0, "rounds": -3.0},
        "server": "lab-02",
    }


def test_trials_that_failed_have_no_number(folder: Path) -> None:
    edit(folder, BATCH.format("fitness = ?"), np.array([np.nan, 2.0]).tobytes())
    assert [trial["fitness"] for trial in Run(folder).trials(0)[:2]] == [[2.0], [None]]


def test_reading_changes_nothing_in_the_folder(folder: Path) -> None:
    before = content(folder)
    everything(folder)
    list_runs(folder.parent)
    assert content(folder) == before


def test_an_active_run_is_read_up_to_its_last_commit(record: Record) -> None:
    run = Run(record.folder)
    assert (run.going_on, run.finished, len(run.history()), len(run.trials(1))) == (
        True,
        False,
        2,
        4,
    )
    record.finish(2, [b"x"], np.array([9.0]), {"best": 9.0, "mean": 9.0}, {})
    record.sync()
    assert (run.best(), len(run.history())) == (9.0, 3)
    record.close()
    assert not run.going_on


def test_a_reader_does_not_prevent_a_resume(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader holds the lock for an instant, to learn whether a program has it."""
    looking = os.open(folder / "lock", os.O_RDONLY)
    fcntl.flock(looking, fcntl.LOCK_SH)
    waited: list[float] = []

    def look_away(seconds: float) -> None:
        waited.append(seconds)
        fcntl.flock(looking, fcntl.LOCK_UN)

    monkeypatch.setattr(time, "sleep", look_away)
    with Record.open(folder)[0]:
        assert Run(folder).going_on
    assert len(waited) == 1, "it was tried again after the reader had released the lock"
    os.close(looking)


def test_a_log_in_a_folder_that_cannot_be_written_is_read(
    record: Record, tmp_path: Path
) -> None:
    """The run was killed; SQLite would have to write next to its log."""
    copied = tmp_path / "killed"
    shutil.copytree(record.folder, copied)
    (copied / "run.sqlite-shm").unlink()
    assert (copied / "run.sqlite-wal").stat().st_size
    (copied / "run.sqlite-shm").mkdir()  # also root cannot write it
    assert [generation["best"] for generation in Run(copied).history()] == [0.625, 2.625]


# ---- experiment.toml


def test_an_experiment_that_was_changed_is_read_as_it_began(folder: Path) -> None:
    path = folder / "experiment.toml"
    path.write_text(
        path.read_text()
        .replace("seed = 1\n", "seed = 7\n", 1)
        .replace("generations = 200", "generations = 300")
    )
    run = Run(folder)
    assert (run.changed, run.experiment.seed, run.experiment.generations) == (
        ["seed"],
        1,
        300,
    )


def test_a_folder_without_an_experiment_is_not_a_run(folder: Path) -> None:
    (folder / "experiment.toml").unlink()
    assert "no run; expected a folder with experiment.toml and run.sqlite" in refusal(
        folder
    )


def test_a_folder_of_runs_is_not_a_run(folder: Path) -> None:
    assert f"no run, but a folder of runs, such as {folder}; expected" in refusal(
        folder.parent
    )


@pytest.mark.parametrize("body", [b"", b"\xff\xfe", b"name = 1", b"x = [" * 3000])
def test_a_damaged_experiment_is_refused(folder: Path, body: bytes) -> None:
    (folder / "experiment.toml").write_bytes(body)
    assert "experiment.toml:" in refusal(folder)


def test_a_run_of_a_simulator_that_is_not_installed_is_read(folder: Path) -> None:
    """Metrics have numbers where their names are missing."""
    edit(
        folder,
        """UPDATE meta SET value = replace(value, '"emergency-exit"', '"gone"')
        WHERE key = 'experiment'""",
    )
    run = Run(folder)
    assert run.experiment.problem.simulator == "gone"
    assert list(run.trials(0)[0]["metrics"]) == ["escaped", "rounds"]
    edit(folder, "DELETE FROM meta WHERE key = 'metrics'")
    assert list(Run(folder).trials(0)[0]["metrics"]) == ["metric 1", "metric 2"]


# ---- paths


def test_links_to_a_run_are_followed(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(folder)
    assert everything(tmp_path / "link")[1:] != []
    elsewhere = tmp_path / "elsewhere.sqlite"
    (folder / "run.sqlite").rename(elsewhere)
    (folder / "run.sqlite").symlink_to(elsewhere)
    assert Run(folder).generations() == 2


def test_broken_links_and_special_files_are_not_runs(folder: Path) -> None:
    path = folder / "run.sqlite"
    path.unlink()
    for made in (
        lambda: path.symlink_to("nowhere"),
        lambda: path.symlink_to(path.name),
        lambda: path.symlink_to("/dev/zero"),
        lambda: os.mkfifo(path),
        path.mkdir,
    ):
        made()
        assert "no run" in refusal(folder)
        path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()


@pytest.mark.parametrize("name", ["missing", "file", "file/below", "x" * 300, "nul\0"])
def test_a_path_that_is_not_a_folder_is_not_a_run(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("")
    assert "no run" in refusal(tmp_path / name)
    with pytest.raises(ConfigError, match="no run") as caught:
        runs_below([tmp_path / name])
    assert str(caught.value).isprintable()
