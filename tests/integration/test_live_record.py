"""The record of a real run, read while it is written."""

import contextlib
import subprocess
from pathlib import Path

import pytest

from tests.integration import evacuation
from tests.integration.programs import Optimizer, wait_until
from tests.promise.promise import check_run
from zswarm.ot.record.reader import Run
from zswarm.ot.record.summary import list_runs

pytestmark = pytest.mark.programs


def read(folder: Path) -> Run | None:
    """Return the run; None while its folder is being made."""
    return Run(folder) if (folder / "run.sqlite").exists() else None


def test_reading_a_running_record_does_not_disturb_the_run(tmp_path: Path) -> None:
    """Later reads continue from earlier ones; in the end everything was read."""
    local = ["--servers", "local", "--set", "cluster.local_slots=1", "--json"]
    experiment = evacuation.write(tmp_path, "watched", 1500)
    watched = Optimizer(tmp_path, "watched", ["run", experiment, *local])
    folder = tmp_path / "runs" / "watched"
    seen: list[list[dict[str, object]]] = []
    try:
        run = wait_until(lambda: read(folder), "the run's folder is there")
        assert run.going_on
        while watched.process.poll() is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                # Reading all the time would take the time of the run.
                watched.process.wait(0.03)
            now = Run(folder)
            seen.append(now.history())
            assert len(now.trials(len(seen[-1]))) <= 50 * 20
            assert [row["run"] for row in list_runs(tmp_path / "runs")] == [str(folder)]
        done = watched.done()
    finally:
        watched.close()
    last = Run(folder)
    assert all(history == last.history()[: len(history)] for history in seen)
    assert len({len(history) for history in seen}) > 1, "it was read at several times"
    assert (last.going_on, last.finished, last.history_hash) == (
        False,
        True,
        done["history_hash"],
    )
    assert len(last.history()) == 4
    check_run(folder)
