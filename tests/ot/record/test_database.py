"""A database waits for its disk: what is written is there as a whole, once, in the end."""

import contextlib
import errno
import os
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.ot.record import database as database_module
from zswarm.ot.record.database import Database, connect, on_network
from zswarm.system.files import write_whole

ADD = "INSERT OR REPLACE INTO words VALUES (?, ?)"
LONG = "x" * 20_000  # more than a page


class Disk:
    """A database, what it tells, and how many pages it may have."""

    def __init__(self, path: Path) -> None:
        self.path, self.told, self.waits, self._room_after = (
            path,
            list[tuple[str, float | None]](),
            0,
            0,
        )
        self.connection = connect(path)
        self.connection.execute("CREATE TABLE words (id INTEGER PRIMARY KEY, word TEXT)")
        self.database = Database(
            path,
            self.connection,
            lambda line, waited_s: self.told.append((line, waited_s)),
        )

    def fill(self, waits: int = 0) -> None:
        """SQLite reports a full disk until the program has waited so often."""
        self._room_after = self.waits + waits
        self.connection.execute("PRAGMA max_page_count = 1")  # no more than there are

    def make_room(self) -> None:
        self.connection.execute("PRAGMA max_page_count = 1000000")

    def sleep(self, _seconds: float) -> None:
        self.waits += 1
        assert self.waits < 100, "waited for ever"
        if self.waits == self._room_after:
            self.make_room()

    def written(self) -> list[int]:
        """Return the rows as another program sees them."""
        connection = sqlite3.connect(f"{self.path.as_uri()}?mode=ro", uri=True)
        try:
            return [
                row[0] for row in connection.execute("SELECT id FROM words ORDER BY id")
            ]
        finally:
            connection.close()


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    disk = Disk(tmp_path / "words.sqlite")
    monkeypatch.setattr(database_module, "COMMIT_S", 0.0)
    monkeypatch.setattr(database_module, "RETRY_S", 0.0)
    monkeypatch.setattr(time, "sleep", disk.sleep)
    yield disk
    disk.database.close()


def test_writes_soon_after_a_commit_are_committed_with_the_next(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database_module, "COMMIT_S", 1000.0)
    disk.database.write((ADD, (1, "first")))
    disk.database.write((ADD, (2, "second")))
    disk.database.flush()
    assert disk.written() == [1]
    disk.database.write_now()
    assert disk.written() == [1, 2]


def test_a_full_disk_is_reported_once_and_its_end_with_the_seconds(disk: Disk) -> None:
    disk.fill()
    for number in range(3):
        disk.database.write((ADD, (number, LONG)))
    assert disk.waits == 0, "writing does not wait"
    assert disk.told == [
        (
            f"the disk of {disk.path.parent} is full: waiting for room; nothing is lost",
            None,
        )
    ]
    disk.make_room()
    disk.database.flush()
    line, waited_s = disk.told[1]
    assert line == f"the disk of {disk.path.parent} takes data again: the run continues"
    assert waited_s is not None
    assert waited_s >= 0
    assert disk.written() == [0, 1, 2]
    assert disk.database.unwritten == []


def test_statements_written_together_are_committed_together(disk: Disk) -> None:
    disk.fill()
    disk.database.write((ADD, (1, "short")), (ADD, (2, LONG)))
    assert disk.written() == []
    disk.make_room()
    disk.database.write_now()
    assert disk.written() == [1, 2]


def test_a_commit_that_must_succeed_waits_for_room(disk: Disk) -> None:
    disk.fill(waits=3)
    disk.database.write_now((ADD, (1, LONG)))
    assert disk.waits == 3
    assert disk.written() == [1]


def test_reading_waits_for_pending_writes(disk: Disk) -> None:
    disk.fill(waits=2)
    disk.database.write((ADD, (7, LONG)))
    assert disk.database.rows("SELECT id FROM words WHERE word = ?", LONG) == [(7,)]
    assert disk.waits == 2


def test_a_commit_with_an_unknown_result_is_applied_once(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error came after the data were on the disk."""
    transact, commits = database_module.transact, []

    def done_and_failed(
        connection: sqlite3.Connection, statements: list[database_module.Statement]
    ) -> None:
        transact(connection, statements)
        commits.append(list(statements))
        if len(commits) == 1:
            error = sqlite3.OperationalError("disk I/O error")
            error.sqlite_errorcode = sqlite3.SQLITE_IOERR_FSYNC
            raise error

    monkeypatch.setattr(database_module, "transact", done_and_failed)
    disk.database.write_now((ADD, (1, "one")), (ADD, (2, "two")))
    assert disk.written() == [1, 2]
    assert commits[0] == commits[1]
    assert [line.rpartition(":")[0].split()[-1] for line, _ in disk.told] == [
        "written",
        "again",
    ]


def test_an_sql_error_is_raised_without_waiting(disk: Disk) -> None:
    with pytest.raises(sqlite3.OperationalError, match="no such table"):
        disk.database.write_now(("INSERT INTO nowhere VALUES (1)", ()))
    assert disk.told == []


def test_a_deleted_database_is_not_written_any_more(disk: Disk) -> None:
    """SQLite would write to a place that no program finds."""
    disk.path.rename(disk.path.with_name("moved"))
    with pytest.raises(ConfigError, match="moved, removed or unmounted"):
        disk.database.write_now((ADD, (1, "one")))


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "is full"),
        (errno.EDQUOT, "is full"),
        (errno.EROFS, "is read-only"),
        (errno.EIO, "does not take"),
    ],
)
def test_writing_other_files_also_waits_and_keeps_the_old_contents(
    disk: Disk, monkeypatch: pytest.MonkeyPatch, number: int, words: str
) -> None:
    file = disk.path.with_name("file")
    write_whole(file, b"before")
    fsync, failures = os.fsync, iter(range(2))

    def failing(opened: int) -> None:
        if next(failures, None) is not None:
            assert file.read_bytes() == b"before"
            raise OSError(number, os.strerror(number))
        fsync(opened)

    monkeypatch.setattr(os, "fsync", failing)
    disk.database.retry(lambda: write_whole(file, b"after"))
    assert file.read_bytes() == b"after"
    assert disk.waits == 2
    assert words in disk.told[0][0]


def test_a_network_file_system_is_known_by_its_mount(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    mounts = "/dev/vda / ext4 rw 0 0\nserver:/home {} nfs4 rw 0 0\n"
    read = Path.read_text
    monkeypatch.setattr(
        Path,
        "read_text",
        lambda self: (
            mounts.format(tmp_path) if str(self) == "/proc/self/mounts" else read(self)
        ),
    )
    assert on_network(tmp_path / "run.sqlite")
    assert not on_network(Path("/somewhere/else"))


def test_a_record_with_a_trigger_is_not_written(tmp_path: Path) -> None:
    """Its SQL would run in the user's program."""
    path = tmp_path / "run.sqlite"
    with contextlib.closing(connect(path)) as made:
        made.execute("CREATE TABLE events (x)")
        made.execute(
            "CREATE TRIGGER t AFTER INSERT ON events BEGIN DELETE FROM events; END"
        )
    with pytest.raises(sqlite3.DatabaseError, match="has a trigger; zswarm makes none"):
        connect(path)
