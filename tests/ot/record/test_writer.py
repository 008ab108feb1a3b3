"""The record: finished generations are on the disk, whatever happens."""

import errno
import hashlib
import os
import sqlite3
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from zswarm import experiment
from zswarm.champion.controller import Controller, load_controller
from zswarm.errors import ConfigError
from zswarm.ot.cluster.events import Counted
from zswarm.ot.notes import Note
from zswarm.ot.record import commits as commits_module
from zswarm.ot.record import statements
from zswarm.ot.record.folder import load_experiment
from zswarm.ot.record.history_hash import History
from zswarm.ot.record.opening import SECRET
from zswarm.ot.record.statements import CANDIDATES_AT_ONCE
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload

STATISTICS = {"best": 1.0, "mean": float("-inf")}
CHAMPION = Controller(
    simulator="emergency-exit",
    simulator_settings={"steps": 5},
    representation="fully-meshed",
    representation_settings={},
    inputs=10,
    outputs=2,
    sensors=["n"],
    actuators=["vx"],
    genome=b"\0" * 240,
    fitness=-1.0,
    run="emergency-exit-0123abcd",
)


@pytest.fixture
def complete() -> experiment.Experiment:
    return experiment.complete(experiment.load(experiment.find("emergency-exit")), "test")


@pytest.fixture
def record(tmp_path: Path, complete: experiment.Experiment) -> Iterator[Record]:
    record = Record.create(tmp_path, complete, "hash")
    yield record
    record.close()  # some tests did so themselves


def test_a_record_shows_that_another_program_resumed_the_run(record: Record) -> None:
    """On a file system without locks: a server's word alone ends no run."""
    assert not record.taken_over()
    database = sqlite3.connect(record.folder / "run.sqlite")
    with database:
        database.execute("UPDATE meta SET value = 1 WHERE key = 'epoch'")
    database.close()
    assert record.taken_over()


def workload(candidates: int = 3) -> Workload:
    genomes = [bytes([i]) * 8 for i in range(candidates)]
    return Workload(
        genomes, np.arange(candidates).reshape(-1, 1), np.zeros(candidates, np.uint64), 2
    )


def count(work: Workload, trials: list[int], fitness: float) -> Counted:
    indices = np.array(trials)
    work.fitness[indices], work.metrics[indices], work.counted[indices] = (
        fitness,
        fitness + 1,
        True,
    )
    return Counted(indices, "lab-01", 0.5)


def query(folder: Path, sql: str) -> list[tuple[object, ...]]:
    """Return the rows as another program sees them."""
    database = sqlite3.connect(f"file:{folder / 'run.sqlite'}?mode=ro", uri=True)
    try:
        return database.execute(sql).fetchall()
    finally:
        database.close()


def test_a_second_run_of_the_same_name_gets_its_own_folder(
    tmp_path: Path, record: Record, complete: experiment.Experiment
) -> None:
    with Record.create(tmp_path, complete, "hash") as second:
        assert (record.folder.name, second.folder.name) == (
            "emergency-exit",
            "emergency-exit-2",
        )
        assert second.meta("run_id") != record.meta("run_id")


def test_a_run_in_use_is_refused(record: Record) -> None:
    with pytest.raises(
        ConfigError, match="this run is in use by another zswarm-ot process"
    ):
        Record.open(record.folder)


def test_the_folder_holds_the_complete_experiment(
    record: Record, complete: experiment.Experiment
) -> None:
    assert load_experiment(record.folder) == complete


def test_a_resume_has_the_secret_of_the_run_and_an_older_record_gets_one(
    record: Record,
) -> None:
    secret = record.meta("secret")
    record.close()
    with Record.open(record.folder)[0] as resumed:
        assert resumed.meta("secret") == secret
        assert len(secret) == SECRET
        for damaged in (None, "text", b"short"):
            resumed.set_meta("secret", damaged)
    with Record.open(record.folder)[0] as older:
        found = older.meta("secret")
        assert isinstance(found, bytes)
        assert len(found) == SECRET
        assert found != secret


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


def test_outcomes_of_other_candidates_can_be_forgotten(record: Record) -> None:
    """Only those of the current generation; some optimizers are not portable between machines."""
    for generation in (0, 1):
        work = workload()
        record.begin(generation, work)
        record.add(count(work, [0, 1], 1.0), work)
    other = workload()
    other.genomes[1] = b"changed!"
    assert record.forget_others() == 0
    record.begin(1, other)
    assert record.forget_others() == 2
    assert record.restore(other) == 0
    record.begin(0, work)
    assert record.restore(workload()) == 2


def test_a_finished_generation_is_read_back_to_the_same_history(record: Record) -> None:
    told = History()
    for generation in range(2):
        genomes, fitness = (
            [b"a%d" % generation, b"b"],
            np.array([0.1 + generation, np.nan]),
        )
        told.add(genomes, fitness)
        record.finish(generation, genomes, fitness, STATISTICS, {"at": generation})
    assert record.history().hex() == told.hex()
    assert record.resumed() == (2, {"at": 1})
    assert record.evaluations() == 4


def test_a_large_generation_is_recorded_whole_and_in_order(record: Record) -> None:
    count = 2 * CANDIDATES_AT_ONCE + 1
    genomes, fitness = (
        [b"%d" % candidate for candidate in range(count)],
        np.arange(count) / 7,
    )
    record.finish(0, genomes, fitness, STATISTICS, {})
    record.sync()
    rows = query(
        record.folder,
        "SELECT candidate, genome, fitness FROM candidates WHERE generation = 0 ORDER BY candidate",
    )
    assert rows == list(zip(range(count), genomes, fitness.tolist(), strict=True))


def chained(before: bytes, genomes: list[bytes], measures: int, *numbers: float) -> bytes:
    """Return the history hash after a generation, as docs/record.md defines it."""
    total = hashlib.blake2b(before, digest_size=16)
    total.update(struct.pack("<2Q", len(genomes), measures))
    for genome in genomes:
        total.update(hashlib.blake2b(genome, digest_size=16).digest())
    total.update(struct.pack(f"<{len(numbers)}d", *numbers))
    return total.digest()


def test_the_history_hash_is_a_chain_of_blake2b_over_the_generations() -> None:
    history = History()
    history.add([b"one", b"two"], np.array([1.5, -2.0]))
    history.add([b"three"], np.array([-0.0]))
    first = chained(b"zswarm history 2", [b"one", b"two"], 0, 1.5, -2.0)
    assert history.value == chained(first, [b"three"], 0, 0.0)


def test_measures_come_after_the_fitness_of_their_generation_in_the_history_hash() -> (
    None
):
    history = History()
    history.add(
        [b"one", b"two"], np.array([1.5, -2.0]), np.array([[3.0, 4.0], [5.0, np.nan]])
    )
    history.add([b"three"], np.array([0.25]), np.empty((1, 0)))
    told = (1.5, -2.0, 3.0, 4.0, 5.0, np.nan)
    first = chained(b"zswarm history 2", [b"one", b"two"], 2, *told)
    assert history.value == chained(first, [b"three"], 0, 0.25)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ([[(b"ab", 1.0), (b"c", 2.0)]], [[(b"a", 1.0), (b"bc", 2.0)]]),
        ([[(b"ab", 1.0)], [(b"c", 2.0)]], [[(b"ab", 1.0), (b"c", 2.0)]]),
        (
            [[(b"a", 1.0)], [(b"b", 2.0)]],
            [[(b"a" + struct.pack("<d", 1.0) + b"b", 2.0)]],
        ),
    ],
)
def test_no_two_histories_share_a_hash_by_where_their_parts_end(
    one: list[list[tuple[bytes, float]]], other: list[list[tuple[bytes, float]]]
) -> None:
    hashes = []
    for generations in (one, other):
        history = History()
        for told in generations:
            genomes, fitness = zip(*told, strict=True)
            history.add(genomes, np.array(fitness))
        hashes.append(history.hex())
    assert hashes[0] != hashes[1]


def test_measures_are_read_back_as_the_optimizer_received_them(record: Record) -> None:
    """A generation whose optimizer was told none has none, of the right shape."""
    told = History()
    fitness, measures = np.array([0.5, np.nan]), np.array([[1.0, np.nan], [-3.0, 1e300]])
    for generation, these in enumerate((measures, np.empty((2, 0)), None)):
        told.add([b"a", b"b"], fitness, these)
        record.finish(generation, [b"a", b"b"], fitness, STATISTICS, {}, these)
    first, *others = record.told()
    assert first.measures.tobytes() == measures.tobytes()
    assert [other.measures.shape for other in others] == [(2, 0), (2, 0)]
    assert record.history().hex() == told.hex()


def test_half_a_generation_is_never_committed(
    record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    rows = database.execute(
        "SELECT json_extract(statistics, '$.best'), json_extract(statistics, '$.mean') FROM "
        "generations"
    )
    assert rows.fetchall() == [(1.0, None)]
    database.close()


def test_events_do_not_count_as_faults(record: Record) -> None:
    work = workload()
    record.begin(0, work)
    record.add(count(work, [0, 1], 1.0), work)
    record.note(Note("requeued", count=7))
    assert record.counts() == {"requeued": 7, "faulted": 0, "doubtful": 0}


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        ("trials = 10\n", None),
        ("seed = 1\n", "seed"),
        ("severity = 0.3\n", "optimizer"),
        ("generations = 200\n", ""),
    ],
)
def test_an_edited_experiment_is_refused_if_it_changes_the_history(
    record: Record, edit: str, words: str | None
) -> None:
    record.close()
    file = record.folder / "experiment.toml"
    file.write_text(
        file.read_text().replace(
            edit, edit.replace("0", "1").replace("= 1\n", "= 4\n"), 1
        )
    )
    if words == "":
        with Record.open(record.folder)[0] as resumed:
            assert resumed.meta("epoch") == 1
        return
    with pytest.raises(
        ConfigError, match=f"{words or 'problem'} changed since the run began"
    ):
        Record.open(record.folder)


@pytest.mark.parametrize("schema", [3, 99])
def test_another_schema_is_refused_with_the_zswarm_that_is_needed(
    record: Record, schema: int
) -> None:
    record.set_meta("schema_version", schema)
    record.set_meta("zswarm", "7.0")
    record.close()
    words = rf"has schema {schema}, of zswarm 7\.0; .* reads schema 6: use the zswarm that made"
    with pytest.raises(ConfigError, match=words):
        Record.open(record.folder)


def test_wrong_outcomes_of_a_server_are_dropped_or_marked(record: Record) -> None:
    """Outcomes of the current generation are evaluated again; earlier ones become doubtful."""
    work = workload()
    record.begin(0, work)
    record.add(count(work, [0, 1], 1.0), work)
    record.add(Counted(np.array([2]), "lab-02", 0.5), work)
    record.finish(0, work.genomes, np.zeros(3), STATISTICS, {})
    record.begin(1, work)
    record.add(count(work, [0], 1.0), work)
    record.add(Counted(np.array([1]), "lab-02", 0.5), work)
    record.retract("lab-01")
    again = workload()
    assert record.restore(again) == 1
    assert again.counted.tolist() == [False, True, False]
    record.close()
    rows = query(
        record.folder, "SELECT generation, server, doubtful FROM outcomes ORDER BY id"
    )
    assert rows == [(0, "lab-01", 1), (0, "lab-02", 0), (1, "lab-02", 0)]
    with Record.open(record.folder)[0] as resumed:
        resumed.retract("lab-02")
        assert resumed.evaluations() == 3, "before any generation is begun again"
    rows = query(record.folder, "SELECT generation, doubtful FROM outcomes ORDER BY id")
    assert rows == [(0, 1), (0, 1)]


def test_restored_outcomes_are_known_by_their_server(record: Record) -> None:
    """A server found to be wrong after a resume also loses its outcomes from before it."""
    work = workload()
    record.begin(0, work)
    record.add(count(work, [2], 1.0), work)
    again = workload()
    record.restore(again)
    assert again.source.tolist() == ["", "", "lab-01"]


def test_more_generations_after_the_end_remove_the_hash_until_they_finish(
    record: Record,
) -> None:
    record.finish(0, [b"a"], np.array([1.0]), STATISTICS, {})
    history = record.history().hex()
    record.set_meta("history_hash", history)
    record.close()
    file = record.folder / "experiment.toml"
    file.write_text(file.read_text().replace("generations = 200", "generations = 1", 1))
    with Record.open(record.folder)[0] as told_again:
        assert told_again.meta("history_hash") == history
    file.write_text(file.read_text().replace("generations = 1", "generations = 2", 1))
    with Record.open(record.folder)[0] as longer:
        assert longer.meta("history_hash") is None


# ---- the disk


class Disk:
    """Limit the pages of a record's database, and collect what the record says of it."""

    def __init__(self, record: Record, monkeypatch: pytest.MonkeyPatch) -> None:
        self.lines: list[str] = []
        self._record, self._connection = record, record._database._connection
        self._until_told = False
        record.say = self._say
        monkeypatch.setattr(commits_module, "RETRY_S", 0.001)

    def _say(self, line: str) -> None:
        self.lines.append(line)
        if self._until_told:
            self.make_room()

    def fill(self, until_told: bool = False) -> None:
        """Have SQLite report a full disk from now on, or until the record says so."""
        self._until_told = until_told
        self._connection.execute("PRAGMA max_page_count = 1")  # no more than there are

    def make_room(self) -> None:
        self._connection.execute("PRAGMA max_page_count = 1000000")

    def until_said(self, lines: int) -> None:
        deadline = time.monotonic() + 60.0
        while len(self.lines) < lines:
            assert time.monotonic() < deadline, self.lines
            self._record.check()
            time.sleep(0.001)


@pytest.fixture
def disk(record: Record, monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(record, monkeypatch)


def add_many(record: Record, rows: int) -> None:
    """More than the pages that are there can take."""
    work = workload(250)
    record.begin(0, work)
    for _ in range(rows):
        record.add(count(work, list(range(250)), 1.0), work)


def test_outcomes_wait_for_room_on_a_full_disk(record: Record, disk: Disk) -> None:
    disk.fill()
    add_many(record, 5)  # the current generation continues
    disk.until_said(1)
    assert disk.lines == [
        f"the disk of {record.folder} is full: waiting for room; nothing is lost"
    ]
    assert query(record.folder, "SELECT count(*) FROM outcomes") == [(0,)], (
        "half of what belongs together was written"
    )
    disk.make_room()
    disk.until_said(2)
    assert disk.lines[1:] == [
        f"the disk of {record.folder} can be written again: the run continues"
    ]
    assert query(record.folder, "SELECT id, count FROM outcomes") == [
        (id_, 250) for id_ in range(1, 6)
    ]
    record.sync()
    disk.fill()
    add_many(record, 5)
    disk.until_said(3)  # the next time is told again
    disk.make_room()
    record.close()
    assert query(record.folder, "SELECT event FROM events") == [("disk_waited",)]
    assert len(disk.lines) == 3, "no line is printed when everything was written"


def test_a_generation_waits_for_the_disk_that_is_behind(
    record: Record, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also an outage: the run does not go on with what it cannot record."""
    monkeypatch.setattr(commits_module, "UNSYNCED_S", 0.0)
    disk.fill(until_told=True)
    record.finish(0, [b"genome" * 5000], np.array([1.0]), STATISTICS, {"at": 0})
    assert query(record.folder, "SELECT generation FROM generations") == [(0,)]
    disk.until_said(2)
    assert [line.rpartition(":")[0].split()[-1] for line in disk.lines] == [
        "full",
        "again",
    ]


def test_a_generation_does_not_wait_for_a_disk_that_is_not_behind(
    record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = workload()
    record.begin(0, work)
    record.finish(0, work.genomes, np.ones(3), STATISTICS, {})
    record.sync()
    monkeypatch.setattr(commits_module, "COMMIT_S", 3600.0)
    monkeypatch.setattr(commits_module, "UNSYNCED_S", 3600.0)
    for generation in (1, 2):
        record.begin(generation, work)
        record.finish(generation, work.genomes, np.ones(3), STATISTICS, {})
    finished = "SELECT generation FROM generations"
    assert query(record.folder, finished) == [(0,)]
    record.sync()
    assert query(record.folder, finished) == [(0,), (1,), (2,)]


def test_large_genomes_are_on_the_disk_when_their_generation_ends(
    record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are not held in memory twice."""
    monkeypatch.setattr(commits_module, "COMMIT_S", 3600.0)
    monkeypatch.setattr("zswarm.ot.record.writer.LARGE", 100)
    record.finish(0, [b"genome" * 50], np.array([1.0]), STATISTICS, {})
    assert query(record.folder, "SELECT generation FROM generations") == [(0,)]


def test_a_run_stopped_on_a_full_disk_says_what_is_evaluated_again(
    record: Record, disk: Disk
) -> None:
    disk.fill()
    add_many(record, 5)
    disk.until_said(1)
    record.close()
    assert disk.lines[1:] == [
        f"{record.folder} cannot be written (No space left on device): resume evaluates 1250 "
        f"trials again"
    ]
    with Record.open(record.folder)[0] as resumed:
        assert resumed.meta("epoch") == 1


def test_the_champion_waits_for_the_disk_too(
    record: Record, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    record.champion(CHAMPION)
    record.sync()
    fsync, failures = os.fsync, iter(range(2))

    def failing(file: int) -> None:
        if next(failures, None) is not None:
            assert load_controller(record.folder) == CHAMPION, "the one before is whole"
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(file)

    monkeypatch.setattr(os, "fsync", failing)
    better = msgspec.structs.replace(CHAMPION, fitness=2.0)
    record.champion(better)
    record.sync()
    assert load_controller(record.folder) == better
    assert "is full" in disk.lines[0]


def test_every_statement_of_a_record_can_be_repeated(
    record: Record, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A commit reports a failure after the data are on the disk."""
    transact = commits_module.transact

    def done_and_failed(*arguments: object) -> None:
        transact(*arguments)  # type: ignore[arg-type]
        monkeypatch.undo()
        error = sqlite3.OperationalError("disk I/O error")
        error.sqlite_errorcode = sqlite3.SQLITE_IOERR_FSYNC
        raise error

    monkeypatch.setattr(commits_module, "transact", done_and_failed)
    work = workload()
    record.begin(0, work)
    record.add(count(work, [0, 1, 2], 1.0), work)
    record.note(Note("requeued", count=7))
    record.finish(0, work.genomes, np.ones(3), STATISTICS, {})
    record.sync()
    assert query(record.folder, "SELECT id, count FROM outcomes") == [(1, 3)]
    assert record.counts()["requeued"] == 7
    assert record.evaluations() == 3
    disk.until_said(2)


def test_a_folder_that_is_moved_away_ends_the_run(record: Record, tmp_path: Path) -> None:
    """SQLite would continue to write to it; a resume at the old place would not find it."""
    record.folder.rename(tmp_path / "moved")
    record.set_meta("probe", b"x")
    with pytest.raises(
        ConfigError, match="moved, removed or unmounted while the run went on"
    ):
        record.sync()
    with pytest.raises(ConfigError, match="moved, removed"):
        record.close()
    Record.open(tmp_path / "moved")[0].close()


def test_a_folder_is_removed_if_its_record_cannot_be_created(
    tmp_path: Path, complete: experiment.Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(
        ConfigError,
        match="cannot be written: No space left on device; choose another place with --out",
    ):
        Record.create(tmp_path, complete, "hash")
    assert list(tmp_path.iterdir()) == []


def test_a_record_is_created_completely_or_not_at_all(
    tmp_path: Path, complete: experiment.Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program killed while it makes the folder leaves no half-made record."""
    replace, seen = Path.replace, []

    def replacing(self: Path, target: Path) -> Path:
        if target.name == "run.sqlite":
            assert not target.exists()
            seen.append(
                sqlite3.connect(self).execute("SELECT count(*) FROM meta").fetchone()[0]
            )
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", replacing)
    with Record.create(tmp_path, complete, "hash") as record:
        assert seen == [11]
        assert sorted(path.name for path in record.folder.glob("*.part")) == []


def test_a_champion_is_read_back_whole(record: Record) -> None:
    record.champion(CHAMPION)
    record.sync()
    assert load_controller(record.folder) == CHAMPION
    assert load_controller(record.folder / "champion.zsc") == CHAMPION


def test_genomes_of_a_generation_are_dropped_in_few_statements() -> None:
    """Each looks for the best of its generation."""
    places = [(generation, at) for generation in (3, 4) for at in range(2000)]
    found = list(statements.dropped_genomes(places))
    assert [len(values) - 2 for _, values in found] == [997, 997, 6] * 2
    assert [at for _, values in found for at in values[1:-1]] == [*range(2000)] * 2
    assert all(values[0] == values[-1] for _, values in found)
