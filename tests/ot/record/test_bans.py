"""Bans of machines are read from a record, which shows what was damaged of its events."""

import contextlib
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from zswarm.errors import ConfigError
from zswarm.ot.cluster.machines import Known
from zswarm.ot.evolution import _trust
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.record.reader import Run
from zswarm.ot.record.rollback import go_back
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload

JOINED = Note(RunEvent.SERVER_JOINED, "lab-02-00000001", "", 4, "10.0.0.7")
BAN = Note(
    RunEvent.SERVER_WRONG, "lab-02-00000001", "its outcome is wrong", 0, "10.0.0.7"
)
FOREIGN = Note(RunEvent.SERVER_BANNED, "lab-03-00000009", "as before", 0, "lab-03")


@pytest.fixture
def banned(record: Record) -> Path:
    """Return the folder of a stopped run in whose third generation a machine was banned."""
    record.begin(2, Workload([b"g"], np.zeros((1, 1), int), np.zeros(1, np.uint64), 2))
    for note in (JOINED, BAN, FOREIGN):
        record.note(note)
    record.close()
    return record.folder


def spoil(folder: Path, sql: str) -> None:
    """Edit a record as a broken disk does: the digests stay as they are."""
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as database, database:
        assert database.execute(sql).rowcount


def known(folder: Path) -> Known:
    with Record.open(folder)[0] as record:
        return record.known()


def test_a_resume_knows_machines_and_bans(banned: Path) -> None:
    found = known(banned)
    assert found.machines == {"lab-02-00000001": "10.0.0.7"}
    assert found.banned == {"10.0.0.7": "lab-02-00000001", "lab-03": "lab-03-00000009"}
    assert known(banned) == found, "another resume, too"


def test_a_machine_that_the_user_trusts_is_banned_no_more(banned: Path) -> None:
    with Record.open(banned)[0] as record:
        with pytest.raises(ConfigError, match=r"banned machines: 10\.0\.0\.7, lab-03"):
            _trust(record, ["lab-02"])
        _trust(record, ["10.0.0.7"])
        assert list(record.known().banned) == ["lab-03"]
        record.note(BAN)
        assert list(record.known().banned) == ["lab-03", "10.0.0.7"], "again"
    assert Run(banned).events()[-2]["text"] == "10.0.0.7 is used again, as requested"


@pytest.mark.parametrize(
    "sql",
    [
        "UPDATE events SET machine = '10.0.0.8' WHERE event = 'server_wrong'",
        "UPDATE events SET event = 'requeued' WHERE event = 'server_wrong'",
        "UPDATE events SET digest = 0 WHERE event = 'server_wrong'",
        "DELETE FROM events WHERE event = 'server_wrong'",
    ],
)
def test_a_damaged_event_is_named_and_the_run_can_go_back(banned: Path, sql: str) -> None:
    (number,) = {
        number
        for number, event in enumerate(Run(banned).events(), 1)
        if event["event"] == "server_wrong"
    }
    spoil(banned, sql)
    how = "missing" if sql.startswith("DELETE") else "not what was written"
    line = (
        f"generation 3: event {number} is {how}; zswarm-ot resume .* --from 3 evaluates"
    )
    with pytest.raises(ConfigError, match=line):
        Record.open(banned)
    with pytest.raises(ConfigError, match=f"damaged: {line}"):
        Run(banned).events()
    assert go_back(banned, 2).damaged == 1
    assert list(known(banned).banned) == ["lab-03"]


def test_a_run_that_goes_back_does_not_forget_who_computed_wrong(banned: Path) -> None:
    before = known(banned).banned
    assert go_back(banned, 1).damaged == 0
    assert known(banned).banned == before
    events = Run(banned).events()
    assert {event["generation"] for event in events} <= {None, 0, 1}
    assert "server_joined" in {event["event"] for event in events}
