"""Recorded runs are read whatever is in their folders, and nothing of it is changed."""

import fcntl
import json
import os
import shutil
import sqlite3
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from older import as_schema

from zswarm import experiment
from zswarm.controller import Controller
from zswarm.errors import ConfigError
from zswarm.ot.dispatch import Counted, Note
from zswarm.ot.grouping import groups
from zswarm.ot.reading import Run, listed, runs_below
from zswarm.ot.record import DATABASE, Record, load_experiment
from zswarm.ot.workload import Workload

EVIL = "\x1b[31m[bold]<b onload=x>&amp;\u202e\r\n\x00=cmd()"
ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n"
BATCH = "UPDATE outcomes SET {} WHERE id = 1"


def complete(name: str = "minisim", *overrides: str) -> experiment.Experiment:
    return experiment.complete(experiment.load(experiment.find("emergency-exit"), [f"name={name}", *overrides]), "test")


def controller(**changes: Any) -> Controller:
    return msgspec.structs.replace(
        Controller(
            simulator="emergency-exit", simulator_settings={}, representation="fully-meshed", representation_settings={},
            inputs=10, outputs=2, sensors=["n"], actuators=["vx"], genome=b"\0" * 240, fitness=1.0, run="x-0123abcd",
        ),
        **changes,
    )  # fmt: skip


def evolve(record: Record, generations: int = 2, trials: int = 2) -> None:
    """Generations as a run records them: two candidates, their trials in two batches, by two servers."""
    for generation in range(generations):
        genomes = [bytes([generation, candidate]) * 4 for candidate in range(2)]
        work = Workload(genomes, np.repeat(np.arange(2), trials).reshape(-1, 1), np.zeros(2 * trials, np.uint64), 2)
        record.begin(generation, work)
        for server, half in (("lab-01", slice(None, trials)), ("lab-02", slice(trials, None))):
            indices = np.arange(2 * trials)[half][::-1]
            work.fitness[indices, 0] = generation + indices / 8
            work.metrics[indices] = np.stack([indices, -indices], axis=1)
            record.add(Counted(indices, server, 0.5), work)
        record.note(Note("server_joined", server="lab-01", text="with one slot", count=1))
        fitness = work.fitness[:, 0].reshape(2, trials).sum(axis=1)
        statistics = {"best": float(fitness.max()), "mean": float(fitness.mean()), "diversity": float("nan")}
        record.finish(generation, genomes, fitness, statistics, {"at": generation})
    record.champion(controller())


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Record]:
    """Of a run that goes on."""
    made = Record.create(tmp_path, complete("lab", "problem.trials=2"), "hash", ["escaped", "rounds"])
    evolve(made)
    made.flush()
    yield made
    made.close()  # some tests did so themselves


@pytest.fixture
def folder(record: Record) -> Path:
    """Of a run that ended."""
    record.set_meta("history_hash", record.history().hex())
    record.close()
    return record.folder


def edit(folder: Path, sql: str, *parameters: Any) -> None:
    """What somebody did to a record with another program."""
    database = sqlite3.connect(folder / "run.sqlite")
    database.executescript(sql) if not parameters else database.execute(sql, parameters)
    database.commit()
    database.close()


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def everything(folder: Path) -> list[Any]:
    """All that can be read of a run."""
    run = Run(folder)
    champion = run.champion()
    return [
        run.name, repr(run), run.meta, msgspec.to_builtins(run.experiment), run.changed, run.history(), run.generations(),
        run.best(), run.events(), run.servers(), run.candidates(0), run.trials(0), run.going_on, run.finished, run.history_hash,
        *run.marked(),
        msgspec.to_builtins(champion, builtin_types=(bytes,)) if champion else None,
    ]  # fmt: skip


def texts(value: Any) -> Iterator[str]:
    """The texts in a value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from texts([*value.keys(), *value.values()])
    elif isinstance(value, list):
        for item in value:
            yield from texts(item)


def refusal(folder: Path) -> str:
    """Why a run cannot be read, in one line that is safe to show."""
    with pytest.raises(ConfigError) as caught:
        everything(folder)
    assert str(caught.value).isprintable()
    return str(caught.value)


# ---- what a run recorded


def test_a_run_is_read_as_it_was_recorded(folder: Path) -> None:
    run = Run(folder)
    assert (run.name, run.finished, run.going_on, run.generations(), run.best()) == ("lab", True, False, 2, 2.625)
    assert run.experiment == complete("lab", "problem.trials=2")
    first, second = run.history()
    assert (first["generation"], first["best"], first["mean"], first["evaluations"]) == (0, 0.625, 0.375, 2)
    assert (second["best"], second["evaluations"], second["seconds"]) == (2.625, 4, second["finished_at"] - first["finished_at"])
    assert first["statistics"] == {"best": 0.625, "mean": 0.375, "diversity": None}
    assert [candidate["fitness"] for candidate in run.candidates(1)] == [2.125, 2.625]
    assert run.candidates(1)[1]["genome"] == b"\x01\x01" * 4
    assert [event["event"] for event in run.events()] == ["server_joined"] * 2
    assert [(server["server"], server["trials"]) for server in run.servers()] == [("lab-01", 4), ("lab-02", 4)]
    champion = run.champion()
    assert champion is not None
    assert champion.genome == b"\0" * 240


def test_trials_are_in_order_with_their_metrics_by_name(folder: Path) -> None:
    trials = Run(folder).trials(1)
    assert [(trial["candidate"], trial["trial"]) for trial in trials] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert trials[3] == {
        "candidate": 1, "trial": 1, "fitness": [1.375], "metrics": {"escaped": 3.0, "rounds": -3.0}, "server": "lab-02",
    }  # fmt: skip


def test_trials_that_failed_have_no_number(folder: Path) -> None:
    edit(folder, BATCH.format("fitness = ?"), np.array([np.nan, 2.0]).tobytes())
    assert [trial["fitness"] for trial in Run(folder).trials(0)[:2]] == [[2.0], [None]]


def test_reading_changes_nothing_in_the_folder(folder: Path) -> None:
    before = content(folder)
    everything(folder)
    listed(folder.parent)
    assert content(folder) == before


def test_a_run_that_goes_on_is_read_up_to_its_last_commit(record: Record) -> None:
    run = Run(record.folder)
    assert (run.going_on, run.finished, len(run.history()), len(run.trials(1))) == (True, False, 2, 4)
    record.finish(2, [b"x"], np.array([9.0]), {"best": 9.0, "mean": 9.0}, {})
    assert (run.best(), len(run.history())) == (9.0, 3)
    record.close()
    assert not run.going_on


def test_a_resume_is_not_kept_out_by_somebody_who_looks(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether a run goes on is asked by its lock, which is held for an instant."""
    looking = os.open(folder / "lock", os.O_RDONLY)
    fcntl.flock(looking, fcntl.LOCK_SH)
    waited: list[float] = []

    def look_away(seconds: float) -> None:
        waited.append(seconds)
        fcntl.flock(looking, fcntl.LOCK_UN)

    monkeypatch.setattr(time, "sleep", look_away)
    with Record.open(folder)[0]:
        assert Run(folder).going_on
    assert len(waited) == 1, "it was tried again when nobody looked any more"
    os.close(looking)


def test_a_log_in_a_folder_that_cannot_be_written_is_read(record: Record, tmp_path: Path) -> None:
    """Of a run that was killed: SQLite would have to write beside it."""
    copied = tmp_path / "killed"
    shutil.copytree(record.folder, copied)
    (copied / "run.sqlite-shm").unlink()
    assert (copied / "run.sqlite-wal").stat().st_size
    (copied / "run.sqlite-shm").mkdir()  # also root cannot write it
    assert [generation["best"] for generation in Run(copied).history()] == [0.625, 2.625]


# ---- records of other versions


@pytest.mark.parametrize("version", [1, 2])
def test_an_older_record_is_read_as_it_is(folder: Path, version: int) -> None:
    new = everything(folder)
    as_schema(version, folder)
    before = content(folder)
    old = everything(folder)
    assert old[2].pop("schema_version") == version
    del new[2]["schema_version"], new[2]["metrics"]
    assert old == new, "metrics have the names that the simulator gives them"
    assert content(folder) == before


@pytest.mark.parametrize("version", [1, 2])
def test_resume_brings_an_older_record_to_this_schema(folder: Path, version: int) -> None:
    before = Run(folder).history()
    as_schema(version, folder)
    Record.open(folder)[0].close()
    migrated = Run(folder)
    assert migrated.meta["schema_version"] == 4
    assert migrated.history() == before
    new = Record.create(folder.parent, complete(), "hash")
    new.close()
    assert views(folder) == views(new.folder)


def views(folder: Path) -> dict[str, list[str]]:
    database = sqlite3.connect(folder / "run.sqlite")
    names = [row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'view' ORDER BY name")]
    found = {name: [row[1] for row in database.execute(f"PRAGMA table_info({name})")] for name in names}
    database.close()
    return found


def test_a_view_of_ones_own_is_replaced_by_that_of_the_schema(folder: Path) -> None:
    as_schema(2, folder)
    edit(folder, "CREATE VIEW history AS SELECT 1 AS mine")
    Record.open(folder)[0].close()
    assert "evaluations" in views(folder)["history"]


@pytest.mark.parametrize("found", [5, 99, "x", 0, None, 1.5])
def test_a_record_of_an_unknown_schema_is_refused(folder: Path, found: object) -> None:
    edit(folder, "UPDATE meta SET value = ? WHERE key = 'schema_version'", found)
    edit(folder, "UPDATE meta SET value = ? WHERE key = 'zswarm'", EVIL)
    words = f"has schema {found}, of zswarm" if isinstance(found, int) and found > 4 else "damaged: it names no schema"
    assert words in refusal(folder)


# ---- views, as other programs see them


def sqlite3_program(folder: Path, sql: str) -> list[tuple[Any, ...]]:
    """Rows by the sqlite3 program, or by Python's module where that is not installed."""
    if not shutil.which("sqlite3"):
        database = sqlite3.connect(f"file:{folder / 'run.sqlite'}?mode=ro", uri=True)
        rows = database.execute(sql).fetchall()
        database.close()
        return rows
    command = ["sqlite3", "-readonly", "-json", str(folder / "run.sqlite"), sql]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [tuple(row.values()) for row in json.loads(done.stdout or "[]")]


def test_the_views_say_the_same_as_the_tables(folder: Path) -> None:
    run = Run(folder)
    curve = sqlite3_program(folder, "SELECT generation, seconds, best, mean, evaluations FROM history")
    columns = ("generation", "seconds", "best", "mean", "evaluations")
    assert [row[1] for row in curve] == pytest.approx([row["seconds"] for row in run.history()])
    assert [(row[0], *row[2:]) for row in curve] == [
        tuple(row[column] for column in columns if column != "seconds") for row in run.history()
    ]
    assert sqlite3_program(folder, "SELECT generation, best, candidate FROM champions") == [(0, 0.625, 1), (1, 2.625, 1)]
    assert sqlite3_program(folder, "SELECT server, trials FROM servers") == [("lab-01", 4), ("lab-02", 4)]
    assert sqlite3_program(folder, "SELECT generation, server, trials FROM batches")[1] == (0, "lab-02", 2)
    assert sqlite3_program(folder, "SELECT name, value FROM statistics WHERE generation = 0") == [
        ("best", 0.625), ("mean", 0.375), ("diversity", None),
    ]  # fmt: skip
    assert ("optimizer.population", "50") in sqlite3_program(folder, "SELECT key, value FROM settings")
    assert ("problem.settings.agents", "10") in sqlite3_program(folder, "SELECT key, value FROM settings")
    assert sqlite3_program(folder, "SELECT event, server, text FROM timeline")[0] == ("server_joined", "lab-01", "with one slot")


def test_times_of_the_views_are_utc(folder: Path) -> None:
    edit(folder, "UPDATE generations SET finished_at = 1772615523.125")
    edit(folder, "UPDATE meta SET value = 1772615523.0 WHERE key = 'created_at'")
    rows = sqlite3_program(folder, "SELECT utc, seconds FROM history")
    assert rows == [("2026-03-04 09:12:03.125", 0.125), ("2026-03-04 09:12:03.125", 0.0)]


def test_a_generation_without_a_better_one_has_no_champion(folder: Path) -> None:
    edit(folder, "UPDATE generations SET best = 0.625")
    assert sqlite3_program(folder, "SELECT generation FROM champions") == [(0,)]
    edit(folder, "UPDATE generations SET best = NULL WHERE generation = 0")
    assert sqlite3_program(folder, "SELECT generation FROM champions") == [(1,)]


# ---- hostile and damaged records


def test_texts_of_a_record_are_safe_to_show(folder: Path) -> None:
    edit(folder, "UPDATE events SET event = ?, server = ?, text = ?", EVIL, EVIL, EVIL)
    edit(folder, "UPDATE outcomes SET server = ?", EVIL)
    edit(folder, "UPDATE generations SET statistics = ?", json.dumps({EVIL: 1.0, "x": EVIL, "y": [{EVIL: EVIL}]}))
    for key in ("zswarm", "machine", "run_id", "version_hash", "history_hash", EVIL):
        edit(folder, "INSERT OR REPLACE INTO meta VALUES (?, ?)", key, EVIL)
    edit(folder, "INSERT OR REPLACE INTO meta VALUES ('metrics', ?)", json.dumps([EVIL, "rounds"]))
    began = json.loads(Run(folder).meta["experiment"])
    began["problem"]["settings"] = {EVIL: [EVIL]}
    began["problem"]["simulator"] = began["optimizer"]["kind"] = EVIL
    edit(folder, "INSERT OR REPLACE INTO meta VALUES ('experiment', ?)", json.dumps(began, ensure_ascii=False))
    evil = controller(simulator=EVIL, run=EVIL, sensors=[EVIL], representation_settings={EVIL: EVIL})
    (folder / "champion.zsc").write_bytes(msgspec.msgpack.encode(evil))
    hostile = folder.with_name("evil \x1b[2J\u202e\n")
    folder.rename(hostile)
    found = everything(hostile)
    assert [text for text in texts(found) if not text.isprintable()] == []
    assert "<b onload=x>" in found[8][0]["text"], "markup is text: who makes a page of it escapes it"
    assert all(text.isprintable() for text in texts(listed(hostile.parent)))


def test_measures_are_read_as_told(folder: Path) -> None:
    """In the order of the optimizer's setting; none where it wants none, or the schema knows none."""
    assert Run(folder).candidates(1)[1]["measures"] == []
    edit(folder, "UPDATE candidates SET measures = ? WHERE candidate = 1", struct.pack("<2d", 0.25, float("nan")))
    assert Run(folder).candidates(1)[1]["measures"] == [0.25, None]
    as_schema(3, folder)
    assert Run(folder).candidates(1)[1]["measures"] == []


def test_measures_that_are_no_numbers_are_damaged(folder: Path) -> None:
    edit(folder, "UPDATE candidates SET measures = x'0102'")
    assert refusal(folder).endswith("damaged: measures of generation 0 are no numbers")


def test_text_that_is_no_utf_8_is_read(folder: Path) -> None:
    edit(folder, "UPDATE events SET text = CAST(x'ff41' AS TEXT)")
    assert Run(folder).events()[0]["text"] == "\ufffdA"


@pytest.mark.parametrize("size", [0, 1, 50, 100, 1000, 4096, 5000, 8192, 0.5, -4096, -1])
def test_a_truncated_record_is_refused(folder: Path, size: float) -> None:
    path = folder / "run.sqlite"
    whole = path.stat().st_size
    os.truncate(path, int(whole * size) if isinstance(size, float) else (size if size >= 0 else whole + size))
    assert "run.sqlite: damaged: " in refusal(folder)
    (row,) = listed(folder.parent)
    assert row["error"].startswith("damaged: ")


@pytest.mark.parametrize(
    "sql",
    [
        "UPDATE generations SET best = 'much'",
        "UPDATE generations SET finished_at = x'00'",
        "UPDATE generations SET statistics = '{'",
        "UPDATE generations SET statistics = '[1]'",
        "UPDATE candidates SET genome = 7",
        "UPDATE events SET text = x'00'",
        "UPDATE outcomes SET count = 10000000",
        "UPDATE outcomes SET count = -1",
        "UPDATE outcomes SET count = 0",
        "UPDATE outcomes SET fitness = x'00'",
        "UPDATE meta SET value = '{}' WHERE key = 'experiment'",
        "UPDATE meta SET value = x'00' WHERE key = 'experiment'",
        "UPDATE meta SET value = '[]' WHERE key = 'experiment'",
        "UPDATE meta SET value = 'x' WHERE key = 'metrics'",
        "DELETE FROM meta",
        "DROP TABLE events",
        f"DROP TABLE events; CREATE VIEW events AS {ENDLESS}",
    ],
)
def test_a_record_that_holds_what_does_not_belong_there_is_refused(folder: Path, sql: str) -> None:
    edit(folder, sql)
    assert "run.sqlite: " in refusal(folder)


@pytest.mark.parametrize("levels", [100, 400, 900, 5000])
def test_what_is_nested_deeper_than_anything_of_ours_is_refused(folder: Path, levels: int) -> None:
    """Also where the parser still takes it."""
    nested = "[" * levels + "]" * levels
    edit(folder, "UPDATE generations SET statistics = ?", f'{{"a": {nested}}}')
    assert "statistics of a generation are no JSON object" in refusal(folder)
    edit(folder, "UPDATE generations SET statistics = '{}'")
    edit(folder, "UPDATE meta SET value = replace(value, '{', '{\"x\": ' || ? || ', ') WHERE key = 'experiment'", nested)
    assert "it names no experiment" in refusal(folder)


@pytest.mark.parametrize("levels", [100, 400, 5000])
def test_a_champion_that_is_nested_deep_is_refused(folder: Path, levels: int) -> None:
    file = folder / "champion.zsc"
    whole = {**msgspec.msgpack.decode(file.read_bytes()), "simulator_settings": {"x": "here"}}
    file.write_bytes(msgspec.msgpack.encode(whole).replace(b"\xa4here", b"\x91" * levels + b"\x01"))
    assert "champion.zsc: damaged" in refusal(folder)


def test_an_experiment_in_the_record_that_is_none_is_refused(folder: Path) -> None:
    began = json.loads(Run(folder).meta["experiment"])
    for key, value in (("name", EVIL), ("seed", -1), ("problem", {"simulator": 3}), ("extra", 1)):
        edit(folder, "UPDATE meta SET value = ? WHERE key = 'experiment'", json.dumps({**began, key: value}))
        why = refusal(folder)
        assert why.startswith(f"{folder / 'run.sqlite'}: "), why
        assert key in why.removeprefix(f"{folder}")


@settings(derandomize=True, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0, 1, exclude_max=True), put=st.binary(min_size=1, max_size=40))
def test_a_damaged_record_is_read_or_refused(folder: Path, place: float, put: bytes) -> None:
    path = folder / "run.sqlite"
    body = path.read_bytes()
    at = int(len(body) * place)
    try:
        path.write_bytes(body[:at] + put + body[at + len(put) :])
        try:
            found = everything(folder)
        except ConfigError as error:
            found = [str(error)]
        assert all(text.isprintable() for text in texts([*found, *listed(folder.parent)]))
    finally:
        path.write_bytes(body)


@settings(derandomize=True, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0, 1, exclude_max=True), put=st.binary(min_size=1, max_size=40))
def test_a_damaged_record_is_resumed_or_refused(folder: Path, place: float, put: bytes) -> None:
    path = folder / "run.sqlite"
    body = path.read_bytes()
    at = int(len(body) * place)
    try:
        path.write_bytes(body[:at] + put + body[at + len(put) :])
        said = ""
        try:
            Record.open(folder)[0].close()
        except ConfigError as error:
            said = str(error)
        assert said.isprintable()
    finally:
        for side in ("-wal", "-shm"):
            (folder / f"run.sqlite{side}").unlink(missing_ok=True)
        path.write_bytes(body)


@pytest.mark.parametrize(
    "sql",
    [
        "DELETE FROM meta WHERE key = 'experiment'",
        "UPDATE meta SET value = '[' WHERE key = 'experiment'",
        "UPDATE meta SET value = '1' WHERE key = 'experiment'",
        "UPDATE meta SET value = 'x' WHERE key = 'epoch'",
        "UPDATE meta SET value = char(27) WHERE key = 'schema_version'",
        "UPDATE optimizer SET state = x'c1'",
        "UPDATE optimizer SET state = 1",
    ],
)
def test_a_resume_of_a_damaged_record_is_refused(folder: Path, sql: str) -> None:
    edit(folder, sql)
    with pytest.raises(ConfigError) as caught, Record.open(folder)[0] as record:
        record.resumed()
    assert str(caught.value).isprintable()


def test_hostile_names_are_listed_without_their_escapes(folder: Path) -> None:
    folder.rename(folder.with_name("evil \x1b[2J[bold]\u202e\n"))
    for option in ([], ["--json"]):
        command = [sys.executable, "-m", "zswarm.ot", "list", str(folder.parent), *option]
        said = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ | {"COLUMNS": "500"}).stdout
        assert "[bold]" in said
        assert all(line.isprintable() for line in said.splitlines())


# ---- experiment.toml


def test_an_experiment_that_was_changed_is_read_as_it_began(folder: Path) -> None:
    path = folder / "experiment.toml"
    path.write_text(path.read_text().replace("seed = 1\n", "seed = 7\n", 1).replace("generations = 200", "generations = 300"))
    run = Run(folder)
    assert (run.changed, run.experiment.seed, run.experiment.generations) == (["seed"], 1, 300)


def test_a_run_without_its_experiment_is_none(folder: Path) -> None:
    (folder / "experiment.toml").unlink()
    assert "no run; expected a folder with experiment.toml and run.sqlite" in refusal(folder)


@pytest.mark.parametrize("body", [b"", b"\xff\xfe", b"name = 1", b"x = [" * 3000])
def test_a_damaged_experiment_is_refused(folder: Path, body: bytes) -> None:
    (folder / "experiment.toml").write_bytes(body)
    assert "experiment.toml:" in refusal(folder)


def test_a_run_of_a_simulator_that_is_not_installed_is_read(folder: Path) -> None:
    """But for the names of metrics, which a record of before schema 3 does not have."""
    edit(folder, """UPDATE meta SET value = replace(value, '"emergency-exit"', '"gone"') WHERE key = 'experiment'""")
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


def test_links_that_lead_nowhere_and_what_is_no_file_are_no_run(folder: Path) -> None:
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
def test_a_path_that_is_no_folder_is_no_run(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("")
    assert "no run" in refusal(tmp_path / name)
    with pytest.raises(ConfigError, match="no run") as caught:
        runs_below([tmp_path / name])
    assert str(caught.value).isprintable()


# ---- several runs


def test_runs_are_listed_with_the_damaged_ones_named(folder: Path) -> None:
    (folder.parent / "damaged").mkdir()
    (folder.parent / "damaged" / "run.sqlite").write_bytes(b"no database at all, but long enough to be looked at" * 20)
    found = {Path(row["run"]).name: row for row in listed(folder.parent)}
    assert "no experiment.toml" in found["damaged"]["error"]
    assert (found["lab"]["generations"], found["lab"]["best"], found["lab"]["candidates"]) == (2, 2.625, 4)


def test_a_run_that_goes_on_is_listed_with_what_it_has_committed(record: Record) -> None:
    record.set_meta("history_hash", "0" * 32)
    assert [row["history_hash"] for row in listed(record.folder.parent)] == ["0" * 32]


def make(parent: Path, name: str, *overrides: str) -> Path:
    with Record.create(parent, complete(name, *overrides), "hash") as record:
        return record.folder


def test_runs_below_a_folder_are_found_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for name in ("seed-10", "seed-9", "seed-2"):
        make(tmp_path / "study", name)
    make(tmp_path, "alone")
    assert [run.name for run in runs_below([tmp_path])] == ["alone", "seed-2", "seed-9", "seed-10"]
    assert [run.name for run in runs_below([tmp_path / "study" / "seed-9", tmp_path / "study"])] == [
        "seed-9",
        "seed-2",
        "seed-10",
    ]
    assert [Path(row["run"]).name for row in listed(tmp_path)] == ["alone", "seed-2", "seed-9", "seed-10"]


def test_repeats_are_one_group_named_as_their_experiment(tmp_path: Path) -> None:
    for seed in (1, 2, 3):
        make(tmp_path, "lab", f"seed={seed}", f"generations={seed}", f"cluster.local_slots={seed}")
    together = groups(runs_below([tmp_path]))
    assert {label: len(runs) for label, runs in together.items()} == {"lab": 3}


@pytest.mark.parametrize(
    ("settings", "labels"),
    [
        ([["optimizer.population=50"], ["optimizer.population=100"]], ["population 50", "population 100"]),
        (
            [["optimizer.population=50", "representation.hidden=2"], ["optimizer.population=50", "representation.hidden=4"],
             ["optimizer.population=60", "representation.hidden=4"]],
            ["hidden 2, population 50", "hidden 4, population 50", "hidden 4, population 60"],
        ),
        ([["problem.trials=1"], ["problem.trials=2"]], ["trials 1", "trials 2"]),
        ([["optimizer.severity=0.3"], ["optimizer.severity=0.25"]], ["severity 0.3", "severity 0.25"]),
        ([["representation.activation=clamp"], ["representation.activation=relu"]], ["activation clamp", "activation relu"]),
        (
            [[], ["representation.hidden=3", "problem.trials=2", "optimizer.population=7", "optimizer.severity=0.2"]],
            ["lab", "lab (lab-2)"],
        ),
    ],
)  # fmt: skip
def test_groups_are_named_by_what_differs(tmp_path: Path, settings: list[list[str]], labels: list[str]) -> None:
    for setting in settings:
        make(tmp_path, "lab", *setting)
    together = groups(runs_below([tmp_path]))
    assert sorted(together) == sorted(labels)
    assert all(len(runs) == 1 for runs in together.values())


def test_other_problems_are_told_apart_by_their_simulators(tmp_path: Path) -> None:
    make(tmp_path, "lab")
    minisim = experiment.complete(experiment.load(experiment.find("minisim")), "test")
    Record.create(tmp_path, minisim, "hash").close()
    together = groups(runs_below([tmp_path]))
    assert [label.split(",")[0] for label in together] == ["emergency-exit", "minisim"]


def test_a_run_that_cannot_be_read_is_left_out_of_its_folder_with_a_line(tmp_path: Path) -> None:
    """Given itself, or alone, it is an error; so are all where nobody takes the lines."""
    whole, broken = (Record.create(tmp_path, complete(), "hash", name=name).folder for name in ("whole", "broken"))
    (broken / DATABASE).write_bytes(b"no database")
    left_out: list[str] = []
    assert [run.folder for run in runs_below([tmp_path], left_out)] == [whole]
    assert len(left_out) == 1
    assert left_out[0].startswith(f"left out: {broken}/{DATABASE}: damaged")
    shutil.rmtree(whole)
    for paths in ([broken], [tmp_path]):
        with pytest.raises(ConfigError, match="damaged"):
            runs_below(paths, [])


def test_a_run_that_is_named_without_its_parent_is_suggested(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To whoever resumes, plots or reads it."""
    make(tmp_path / "runs", "lab")
    monkeypatch.chdir(tmp_path)
    for call in (load_experiment, Run, lambda path: runs_below([path])):
        with pytest.raises(ConfigError, match=r"lab: no run \(did you mean runs/lab\?\); expected"):
            call(Path("lab"))
        with pytest.raises(ConfigError, match="nothing: no run; expected"):
            call(Path("nothing"))
