"""The record: what is finished is there, whatever happens."""

import hashlib
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.dispatch import Counted, Note, Workload
from zswarm.ot.record import Controller, History, Record, load_controller, load_experiment, on_network, runs

STATISTICS = {"best": 1.0, "mean": float("-inf")}


@pytest.fixture
def complete() -> experiment.Experiment:
    return experiment.complete(experiment.load(experiment.find("emergency-exit")), "test")


@pytest.fixture
def record(tmp_path: Path, complete: experiment.Experiment) -> Iterator[Record]:
    record = Record.create(tmp_path, complete, "hash")
    yield record
    record.close()  # some tests did so themselves


def workload(candidates: int = 3) -> Workload:
    genomes = [bytes([i]) * 8 for i in range(candidates)]
    return Workload(genomes, np.arange(candidates).reshape(-1, 1), np.zeros(candidates, np.uint64), 2)


def count(work: Workload, trials: list[int], fitness: float) -> Counted:
    indices = np.array(trials)
    work.fitness[indices], work.metrics[indices], work.counted[indices] = fitness, fitness + 1, True
    return Counted(indices, "lab-01", 0.5)


def test_the_same_name_gets_a_folder_of_its_own(tmp_path: Path, record: Record, complete: experiment.Experiment) -> None:
    with Record.create(tmp_path, complete, "hash") as second:
        assert (record.folder.name, second.folder.name) == ("emergency-exit", "emergency-exit-2")
        assert second.meta("run_id") != record.meta("run_id")


def test_a_run_in_use_is_refused(record: Record) -> None:
    with pytest.raises(ConfigError, match="another zswarm-ot is at this run"):
        Record.open(record.folder)


def test_the_folder_holds_the_complete_experiment(record: Record, complete: experiment.Experiment) -> None:
    assert load_experiment(record.folder) == complete


def test_every_resume_raises_the_epoch(record: Record) -> None:
    record.close()
    for epoch in (1, 2):
        with Record.open(record.folder)[0] as resumed:
            assert resumed.meta("epoch") == epoch


def test_outcomes_of_an_unfinished_generation_come_back(record: Record) -> None:
    work = workload()
    record.begin(0, work)
    record.add(count(work, [2, 0], -1.5), work)
    again = workload()
    assert record.restore(again) == 2
    assert again.counted.tolist() == [True, False, True]
    assert again.fitness[:, 0].tolist()[::2] == [-1.5, -1.5]
    assert again.metrics[2].tolist() == [-0.5, -0.5]


def test_outcomes_of_other_candidates_are_refused(record: Record) -> None:
    work = workload()
    record.begin(0, work)
    record.add(count(work, [0], 1.0), work)
    other = workload()
    other.genomes[1] = b"changed!"
    record.begin(0, other)
    with pytest.raises(ConfigError, match="other candidates"):
        record.restore(other)


def test_a_finished_generation_is_read_back_to_the_same_history(record: Record) -> None:
    told = History()
    for generation in range(2):
        genomes, fitness = [b"a%d" % generation, b"b"], np.array([0.1 + generation, np.nan])
        told.add(genomes, fitness)
        record.finish(generation, genomes, fitness, STATISTICS, {"at": generation})
    assert record.history().hex() == told.hex()
    assert record.resumed() == (2, {"at": 1})
    assert record.evaluations() == 4


def test_the_history_hash_is_blake2b_of_genomes_and_numbers() -> None:
    history = History()
    history.add([b"one", b"two"], np.array([1.5, -2.0]))
    history.add([b"three"], np.array([0.25]))
    expected = hashlib.blake2b(b"onetwo" + struct.pack("<2d", 1.5, -2.0) + b"three" + struct.pack("<d", 0.25), digest_size=16)
    assert history.hex() == expected.hexdigest()


def test_half_a_generation_is_never_committed(record: Record, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(state: object) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr(msgspec.msgpack, "encode", interrupted)
    with pytest.raises(KeyboardInterrupt):
        record.finish(0, [b"a"], np.array([1.0]), STATISTICS, {})
    monkeypatch.undo()
    record.close()
    with Record.open(record.folder)[0] as resumed:
        assert resumed.resumed() == (0, None)
        resumed.finish(0, [b"a"], np.array([1.0]), STATISTICS, {})
        assert resumed.resumed() == (1, {})


def test_statistics_are_json_that_every_reader_takes(record: Record) -> None:
    record.finish(0, [b"a"], np.array([1.0]), STATISTICS, {})
    record.close()
    database = sqlite3.connect(record.folder / "run.sqlite")
    rows = database.execute("SELECT json_extract(statistics, '$.best'), json_extract(statistics, '$.mean') FROM generations")
    assert rows.fetchall() == [(1.0, None)]
    database.close()


def test_events_and_shares_are_told_apart(record: Record) -> None:
    work = workload()
    record.begin(0, work)
    record.add(count(work, [0, 1], 1.0), work)
    record.note(Note("requeued", count=7))
    assert record.requeued() == 7
    assert record.faulted() == 0


@pytest.mark.parametrize(
    ("edit", "words"),
    [("trials = 10\n", None), ("seed = 1\n", "seed"), ("severity = 0.3\n", "optimizer"), ("generations = 200\n", "")],
)
def test_an_edited_experiment_is_refused_unless_it_changes_nothing_told(record: Record, edit: str, words: str | None) -> None:
    record.close()
    file = record.folder / "experiment.toml"
    file.write_text(file.read_text().replace(edit, edit.replace("0", "1").replace("= 1\n", "= 4\n"), 1))
    if words == "":
        with Record.open(record.folder)[0] as resumed:
            assert resumed.meta("epoch") == 1
        return
    with pytest.raises(ConfigError, match=f"{words or 'problem'} changed since the run began"):
        Record.open(record.folder)


def test_another_schema_is_refused(record: Record) -> None:
    record.set_meta("schema_version", 99)
    record.close()
    with pytest.raises(ConfigError, match="has schema 99; this program reads schema 1"):
        Record.open(record.folder)


def test_a_champion_is_read_back_whole(record: Record) -> None:
    champion = Controller(
        simulator="emergency-exit", simulator_settings={"steps": 5}, representation="fully-meshed",
        representation_settings={}, inputs=10, outputs=2, sensors=["n"], actuators=["vx"], genome=b"\0" * 240,
        fitness=-1.0, run=record.meta("run_id"),
    )  # fmt: skip
    record.champion(champion)
    assert load_controller(record.folder) == champion
    assert load_controller(record.folder / "champion.zsc") == champion


def test_runs_are_listed_with_the_damaged_ones_named(tmp_path: Path, record: Record) -> None:
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "run.sqlite").write_bytes(b"no database at all, but long enough to be looked at" * 20)
    listed = {Path(row["run"]).name: row for row in runs(tmp_path)}
    assert "damaged" in listed["damaged"]["error"]
    assert listed["emergency-exit"]["generations"] == 0


def test_a_network_file_system_is_known_by_its_mount(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    mounts = "/dev/vda / ext4 rw 0 0\nserver:/home {} nfs4 rw 0 0\n"
    read = Path.read_text
    monkeypatch.setattr(
        Path, "read_text", lambda self: mounts.format(tmp_path) if str(self) == "/proc/self/mounts" else read(self)
    )
    assert on_network(tmp_path / "run.sqlite")
    assert not on_network(Path("/somewhere/else"))
