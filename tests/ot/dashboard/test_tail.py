"""A tail finds what was added to a record since its last look."""

import sqlite3
from pathlib import Path

import pytest

from tests.ot.estimate.test_predict import with_times
from tests.ot.invented_record import written
from tests.ot.record.sealing import reseal
from zswarm.config.sections import StopConfig
from zswarm.ot.dashboard.run_index import RunIndex
from zswarm.ot.dashboard.tail import RecordTail
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.record import control_file as control
from zswarm.ot.record import stopping
from zswarm.ot.record.reader import Run
from zswarm.ot.record.schema import ASSESSMENT
from zswarm.ot.record.writer import Record


def test_each_poll_returns_only_new_rows(tmp_path: Path) -> None:
    """Nothing is reported twice."""
    folder = written(
        tmp_path,
        [1.0, 2.0],
        finished=False,
        notes=[Note("server_joined", "lab-1-0123abcd", count=4)],
    )
    tail = RecordTail(folder)
    first = tail.look()
    assert [row[0] for row in first["generations"]] == [0, 1]
    assert first["state"]["status"] == "stopped"
    assert (first["state"]["generation"], first["state"]["best"]) == (2, 2.0)
    assert [event["event"] for event in first["events"]] == ["server_joined"]
    assert first["servers"][0]["trials"] == 6
    assert tail.look() == {}
    record, _ = Record.open(folder)
    with record:
        record.note(Note("requeued", count=3))
        record.note(Note("server_lost", "lab-1-0123abcd"))
    later = tail.look()
    assert [event["level"] for event in later["events"]] == ["warning", "error"]
    assert later["state"]["requeued"] == 3
    assert (later["servers"][0]["state"], later["servers"][0]["losses"]) == ("lost", 1)


def test_running_and_stopped_runs_are_distinguished(tmp_path: Path) -> None:
    """A paused run is distinguished from both."""
    folder = written(tmp_path, [1.0], finished=False)
    tail = RecordTail(folder)
    assert tail.look()["state"]["status"] == "stopped"
    record, _ = Record.open(folder)
    with record:
        assert tail.look()["state"]["status"] == "running"
        control.ask(folder, "pause")
        assert tail.look()["state"]["status"] == "paused"
        control.forget(folder)
        assert tail.look()["state"]["status"] == "running"
    assert tail.look()["state"]["status"] == "stopped"


def test_an_unreadable_record_is_explained_and_may_become_readable(
    tmp_path: Path,
) -> None:
    folder = written(tmp_path, [1.0])
    file = folder / "run.sqlite"
    whole = file.read_bytes()
    file.write_bytes(whole[:5000])
    tail, index = RecordTail(folder), RunIndex([tmp_path])
    state = tail.look()["state"]
    assert state["status"] == "unreadable"
    assert "damaged" in state["error"]
    assert "damaged" in index.rows()[0]["error"]
    file.write_bytes(whole)
    assert tail.look()["state"]["status"] == "finished"
    assert index.rows()[0]["generation"] == 1


def test_the_time_left_includes_the_assessment(tmp_path: Path) -> None:
    """One generation of 2 s, and a tenth of all 21; then what remains of the assessment."""
    folder = written(tmp_path, range(20), trials=10, finished=False)
    with_times(folder, 2.0)
    record, _ = Record.open(folder)
    with record:
        state = RecordTail(folder).look()["state"]
        assert state["status"] == "running"
        assert state["eta_s"] == pytest.approx(2.0 + 0.1 * 21 * 2.0)
    with sqlite3.connect(folder / "run.sqlite") as database:
        database.execute("UPDATE outcomes SET generation = ? WHERE id = 1", (ASSESSMENT,))
    database.close()
    file = folder / "experiment.toml"
    file.write_text(file.read_text().replace("generations = 21", "generations = 20"))
    reseal(folder)
    record, _ = Record.open(folder)
    with record:
        state = RecordTail(folder).look()["state"]
        assert (state["counted"], state["trials"]) == (3, 60)
        assert state["eta_s"] == pytest.approx(0.1 * 20 * 2.0 * (1 - 3 / 60))


def test_a_run_without_outcomes_for_long_is_quiet(tmp_path: Path) -> None:
    """Nothing is said of the time that is left; a run that was just resumed is not quiet."""
    folder = written(tmp_path, range(20), finished=False)
    with_times(folder, 2.0)
    with sqlite3.connect(folder / "run.sqlite") as database:
        database.execute("UPDATE outcomes SET at = at - 300")
        database.execute("UPDATE generations SET finished_at = finished_at - 300")
    database.close()
    reseal(folder)
    record, _ = Record.open(folder)
    with record:
        state = RecordTail(folder).look()["state"]
        assert (state["eta_s"], state["quiet_s"]) == (None, 240.0)
        record.note(Note(RunEvent.BEGAN))
    record, _ = Record.open(folder)
    with record:
        state = RecordTail(folder).look()["state"]
        assert (state["eta_s"] is None, state["quiet_s"]) == (False, 0.0)


def test_generations_and_time_left_are_those_that_a_budget_has_room_for(
    tmp_path: Path,
) -> None:
    """Three candidates a generation: 21 of 30 evaluations leave room for three more."""
    budget = StopConfig(evaluations=30)
    folder = written(tmp_path, range(7), trials=10, finished=False, stop=budget)
    complete = Run(folder).experiment
    assert complete.generations == 8
    assert stopping.expected_generations(complete, 0, 0, 0) == 8
    file = folder / "experiment.toml"
    file.write_text(file.read_text().replace("generations = 8", "generations = 500"))
    with_times(folder, 2.0)
    record, _ = Record.open(folder)
    with record:
        state = RecordTail(folder).look()["state"]
    assert (state["generation"], state["generations"]) == (7, 10)
    assert state["eta_s"] == pytest.approx(3 * 2.0 + 0.1 * 10 * 2.0)
    row = RunIndex([tmp_path]).rows()[0]
    assert (row["generation"], row["generations"]) == (7, 10)
