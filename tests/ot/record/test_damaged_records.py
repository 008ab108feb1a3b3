"""Hostile and damaged records are read, or refused in one line."""

import json
import os
import struct
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.ot.record.recorded import (
    ENDLESS,
    EVIL,
    controller,
    edit,
    everything,
    refusal,
    texts,
)
from zswarm.errors import ConfigError
from zswarm.ot.dashboard.run_index import RunIndex
from zswarm.ot.record.reader import Run
from zswarm.ot.record.summary import list_runs
from zswarm.ot.record.writer import Record


def test_texts_of_a_record_are_safe_to_show(folder: Path) -> None:
    edit(folder, "UPDATE events SET event = ?, server = ?, text = ?", EVIL, EVIL, EVIL)
    edit(folder, "UPDATE outcomes SET server = ?", EVIL)
    edit(
        folder,
        "UPDATE generations SET statistics = ?",
        json.dumps({EVIL: 1.0, "x": EVIL, "y": [{EVIL: EVIL}]}),
    )
    for key in ("zswarm", "machine", "run_id", "version_hash", EVIL):
        edit(folder, "INSERT OR REPLACE INTO meta VALUES (?, ?)", key, EVIL)
    edit(
        folder,
        "INSERT OR REPLACE INTO meta VALUES ('metrics', ?)",
        json.dumps([EVIL, "rounds"]),
    )
    began = json.loads(Run(folder).meta["experiment"])
    began["problem"]["settings"] = {EVIL: [EVIL]}
    began["problem"]["simulator"] = began["optimizer"]["kind"] = EVIL
    edit(
        folder,
        "INSERT OR REPLACE INTO meta VALUES ('experiment', ?)",
        json.dumps(began, ensure_ascii=False),
    )
    evil = controller(
        simulator=EVIL, run=EVIL, sensors=[EVIL], representation_settings={EVIL: EVIL}
    )
    (folder / "champion.zsc").write_bytes(msgspec.msgpack.encode(evil))
    hostile = folder.with_name("evil \x1b[2J\u202e\n")
    folder.rename(hostile)
    found = everything(hostile)
    assert [text for text in texts(found) if not text.isprintable()] == []
    assert "<b onload=x>" in found[8][0]["text"], "markup is text: pages escape it"
    assert all(text.isprintable() for text in texts(list_runs(hostile.parent)))


def test_measures_are_read_as_the_optimizer_received_them(folder: Path) -> None:
    """Their order is that of the optimizer's setting; without the setting they are empty."""
    assert Run(folder).candidates(1)[1]["measures"] == []
    edit(
        folder,
        "UPDATE candidates SET measures = ?",
        struct.pack("<2d", 0.25, float("nan")),
    )
    assert Run(folder).candidates(1)[1]["measures"] == [0.25, None]


def test_measures_that_are_no_numbers_are_damaged(folder: Path) -> None:
    edit(folder, "UPDATE candidates SET measures = x'0102'")
    assert "damaged: generation " in refusal(folder)


def test_text_with_invalid_utf_8_is_read(folder: Path) -> None:
    edit(folder, "UPDATE events SET text = CAST(x'ff41' AS TEXT)")
    assert Run(folder).events()[0]["text"] == "\ufffdA"


@pytest.mark.parametrize("size", [0, 1, 50, 100, 1000, 4096, 5000, 8192, 0.5, -4096, -1])
def test_a_truncated_record_is_refused(folder: Path, size: float) -> None:
    path = folder / "run.sqlite"
    whole = path.stat().st_size
    os.truncate(
        path,
        int(whole * size)
        if isinstance(size, float)
        else (size if size >= 0 else whole + size),
    )
    assert "run.sqlite: damaged: " in refusal(folder)
    (row,) = list_runs(folder.parent)
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
def test_a_record_with_invalid_contents_is_refused(folder: Path, sql: str) -> None:
    edit(folder, sql)
    assert "run.sqlite: " in refusal(folder)


@pytest.mark.parametrize("levels", [100, 400, 900, 5000])
def test_deeply_nested_values_are_refused(folder: Path, levels: int) -> None:
    """They are refused even if the parser still accepts them."""
    nested = "[" * levels + "]" * levels
    edit(folder, "UPDATE generations SET statistics = ?", f'{{"a": {nested}}}')
    assert "statistics of a generation are not a JSON object" in refusal(folder)
    edit(folder, "UPDATE generations SET statistics = '{}'")
    edit(
        folder,
        "UPDATE meta SET value = replace(value, '{', '{\"x\": ' || ? || ', ') WHERE key = "
        "'experiment'",
        nested,
    )
    assert "its experiment is not valid" in refusal(folder)


@pytest.mark.parametrize("levels", [100, 400, 5000])
def test_a_champion_that_is_nested_deep_is_refused(folder: Path, levels: int) -> None:
    file = folder / "champion.zsc"
    whole = {
        **msgspec.msgpack.decode(file.read_bytes()),
        "simulator_settings": {"x": "here"},
    }
    file.write_bytes(
        msgspec.msgpack.encode(whole).replace(b"\xa4here", b"\x91" * levels + b"\x01")
    )
    assert "champion.zsc: damaged" in refusal(folder)


def test_an_invalid_experiment_in_the_record_is_refused(folder: Path) -> None:
    began = json.loads(Run(folder).meta["experiment"])
    for key, value in (
        ("name", EVIL),
        ("seed", -1),
        ("problem", {"simulator": 3}),
        ("extra", 1),
    ):
        edit(
            folder,
            "UPDATE meta SET value = ? WHERE key = 'experiment'",
            json.dumps({**began, key: value}),
        )
        why = refusal(folder)
        assert why.startswith(f"{folder / 'run.sqlite'}: "), why
        assert key in why.removeprefix(f"{folder}")


@settings(
    derandomize=True,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(place=st.floats(0, 1, exclude_max=True), put=st.binary(min_size=1, max_size=40))
def test_a_damaged_record_is_read_or_refused(
    folder: Path, place: float, put: bytes
) -> None:
    path = folder / "run.sqlite"
    body = path.read_bytes()
    at = int(len(body) * place)
    try:
        path.write_bytes(body[:at] + put + body[at + len(put) :])
        try:
            found = everything(folder)
        except ConfigError as error:
            found = [str(error)]
        assert all(
            text.isprintable() for text in texts([*found, *list_runs(folder.parent)])
        )
    finally:
        path.write_bytes(body)


@settings(
    derandomize=True,
    max_examples=25,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(place=st.floats(0, 1, exclude_max=True), put=st.binary(min_size=1, max_size=40))
def test_a_damaged_record_is_resumed_or_refused(
    folder: Path, place: float, put: bytes
) -> None:
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


def put_hostile_history_hash(folder: Path) -> None:
    """Replace the history hash; it is calculated from generations if there are any."""
    edit(folder, "DELETE FROM generations")
    edit(folder, "UPDATE meta SET value = ? WHERE key = 'history_hash'", EVIL)


def test_a_hostile_history_hash_is_listed_without_its_escapes(folder: Path) -> None:
    """What reads more of the run refuses it."""
    put_hostile_history_hash(folder)
    (listed,), (shown,) = list_runs(folder.parent), RunIndex([folder.parent]).rows()
    for row in (listed, shown):
        assert "[bold]" in row["history_hash"]
        assert all(text.isprintable() for text in texts(row))
    assert "run.sqlite: damaged: " in refusal(folder)


def test_hostile_names_are_listed_without_their_escapes(folder: Path) -> None:
    """Names of folders, and history hashes."""
    put_hostile_history_hash(folder)
    folder.rename(folder.with_name("evil \x1b[2J[bold]\u202e\n"))
    for option in ([], ["--json"]):
        command = [sys.executable, "-m", "zswarm.ot", "list", str(folder.parent), *option]
        said = subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=True,
            env=os.environ | {"COLUMNS": "500"},
        ).stdout
        assert "[bold]" in said
        assert all(line.isprintable() for line in said.splitlines())
