"""A thread commits: what is written is there as a whole, once, in order, in the end."""

import errno
import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.ot.record import commits as commits_module
from zswarm.ot.record.commits import Commits
from zswarm.ot.record.database import Statement, connect
from zswarm.system.files import write_whole

ADD = "INSERT OR REPLACE INTO words VALUES (?, ?)"
LONG = "x" * 20_000  # more than a page
DEADLINE_S = 60.0


class Disk:
    """A database, what it reports, and how many pages it may have."""

    def __init__(self, path: Path) -> None:
        self.path, self.told = path, list[tuple[str, float | None]]()
        self.connection = connect(path)
        self.connection.execute("CREATE TABLE words (id INTEGER PRIMARY KEY, word TEXT)")
        self.commits = Commits(path, self.connection, self._report)
        self._until_told = False

    def _report(self, line: str, waited_s: float | None) -> None:
        self.told.append((line, waited_s))
        if self._until_told:
            self.make_room()

    def fill(self, until_told: bool = False) -> None:
        """Have SQLite report a full disk from now on, or until it is told."""
        self._until_told = until_told
        self.connection.execute("PRAGMA max_page_count = 1")  # no more than there are

    def make_room(self) -> None:
        self.connection.execute("PRAGMA max_page_count = 1000000")

    def written(self) -> list[int]:
        """Return the rows as another program sees them."""
        connection = sqlite3.connect(f"{self.path.as_uri()}?mode=ro", uri=True)
        try:
            return [
                row[0] for row in connection.execute("SELECT id FROM words ORDER BY id")
            ]
        finally:
            connection.close()

    def until_told(self, lines: int) -> None:
        def told() -> bool:
            self.commits.check()
            return len(self.told) >= lines

        wait_until(told)


def wait_until(true: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.001)


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    monkeypatch.setattr(commits_module, "RETRY_S", 0.001)
    disk = Disk(tmp_path / "words.sqlite")
    yield disk
    disk.commits.close()


class Held:
    """Commits that wait until they are let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun, self.go, self.commits = (
            threading.Event(),
            threading.Event(),
            list[list[Statement]](),
        )
        transact = commits_module.transact

        def held(connection: sqlite3.Connection, statements: list[Statement]) -> None:
            self.begun.set()
            assert self.go.wait(DEADLINE_S)
            self.commits.append(statements)
            transact(connection, statements)

        monkeypatch.setattr(commits_module, "transact", held)


def test_writing_waits_for_no_commit(disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    held = Held(monkeypatch)
    disk.commits.write((ADD, (1, "first")))
    assert held.begun.wait(DEADLINE_S)
    disk.commits.write((ADD, (2, "second")))
    disk.commits.write((ADD, (3, "third")))
    assert disk.written() == []
    held.go.set()
    disk.commits.sync()
    assert disk.written() == [1, 2, 3]
    assert [len(statements) for statements in held.commits] == [1, 2], (
        "what was written meanwhile is committed together"
    )


def test_what_is_written_is_committed_without_being_asked(disk: Disk) -> None:
    disk.commits.write((ADD, (1, "first")))
    wait_until(lambda: disk.written() == [1])


def test_a_pace_waits_for_what_is_old_and_for_nothing_else(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commits_module, "UNSYNCED_S", 3600.0)
    held = Held(monkeypatch)
    disk.commits.write((ADD, (1, "first")))
    disk.commits.pace()
    assert disk.written() == []
    monkeypatch.setattr(commits_module, "UNSYNCED_S", 0.0)
    assert held.begun.wait(DEADLINE_S)
    threading.Timer(0.02, held.go.set).start()
    disk.commits.pace()
    assert disk.written() == [1]


def test_other_programs_always_see_a_beginning_of_what_was_written(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows that are written together appear together."""
    monkeypatch.setattr(commits_module, "COMMIT_S", 0.0)
    seen: list[list[int]] = []
    for number in range(0, 400, 2):
        disk.commits.write((ADD, (number, "x")), (ADD, (number + 1, "x")))
        if number % 20 == 0:
            seen.append(disk.written())
    disk.commits.sync()
    seen.append(disk.written())
    assert all(rows == list(range(len(rows))) and len(rows) % 2 == 0 for rows in seen)
    assert len(seen[-1]) == 400


def test_a_full_disk_is_reported_once_and_its_end_with_the_seconds(disk: Disk) -> None:
    disk.fill()
    for number in range(3):
        disk.commits.write((ADD, (number, LONG)))
    disk.until_told(1)
    assert disk.told == [
        (
            f"the disk of {disk.path.parent} is full: waiting for room; nothing is lost",
            None,
        )
    ]
    disk.make_room()
    disk.commits.sync()
    disk.until_told(2)
    line, waited_s = disk.told[1]
    assert (
        line == f"the disk of {disk.path.parent} can be written again: the run continues"
    )
    assert waited_s is not None
    assert waited_s >= 0
    assert disk.written() == [0, 1, 2]


def test_statements_written_together_are_committed_together(disk: Disk) -> None:
    disk.fill()
    disk.commits.write((ADD, (1, "short")), (ADD, (2, LONG)))
    disk.until_told(1)
    assert disk.written() == []
    disk.make_room()
    disk.commits.sync()
    assert disk.written() == [1, 2]


@pytest.mark.parametrize("how", ["sync", "pace", "rows"])
def test_what_waits_for_a_full_disk_reports_it_and_continues(
    disk: Disk, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    monkeypatch.setattr(commits_module, "UNSYNCED_S", 0.0)
    disk.fill(until_told=True)
    disk.commits.write((ADD, (7, LONG)))
    if how == "rows":
        found = disk.commits.rows("SELECT id FROM words WHERE word = ?", LONG)
        assert found == [(7,)]
    else:
        getattr(disk.commits, how)()
    assert disk.written() == [7]
    disk.until_told(2)


def test_an_interrupted_query_does_not_answer_the_next_one(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = Held(monkeypatch)
    disk.commits.write((ADD, (1, "first")))

    def interrupted(_over: Callable[[], bool]) -> None:
        assert held.begun.wait(DEADLINE_S)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(disk.commits, "_wait", interrupted)
        with pytest.raises(KeyboardInterrupt):
            disk.commits.rows("SELECT 1")
    threading.Timer(0.02, held.go.set).start()
    assert disk.commits.rows("SELECT 2") == [(2,)]


def test_a_commit_with_an_unknown_result_is_applied_once(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error came after the data were on the disk."""
    transact, tried = commits_module.transact, list[list[Statement]]()

    def done_and_failed(
        connection: sqlite3.Connection, statements: list[Statement]
    ) -> None:
        transact(connection, statements)
        tried.append(list(statements))
        if len(tried) == 1:
            error = sqlite3.OperationalError("disk I/O error")
            error.sqlite_errorcode = sqlite3.SQLITE_IOERR_FSYNC
            raise error

    monkeypatch.setattr(commits_module, "transact", done_and_failed)
    disk.commits.write((ADD, (1, "one")), (ADD, (2, "two")))
    disk.commits.sync()
    assert disk.written() == [1, 2]
    assert tried[0] == tried[1]
    disk.until_told(2)
    assert [line.rpartition(":")[0].split()[-1] for line, _ in disk.told] == [
        "written",
        "again",
    ]


def test_an_sql_error_is_raised_without_waiting(disk: Disk) -> None:
    disk.commits.write(("INSERT INTO nowhere VALUES (1)", ()))
    with pytest.raises(sqlite3.OperationalError, match="no such table"):
        disk.commits.sync()
    assert disk.told == []


def test_a_deleted_database_is_not_written_any_more(disk: Disk) -> None:
    """SQLite would write to a place that no program finds."""
    disk.path.rename(disk.path.with_name("moved"))
    disk.commits.write((ADD, (1, "one")))
    with pytest.raises(ConfigError, match="moved, removed or unmounted"):
        disk.commits.sync()


def test_closing_during_an_outage_returns_what_is_lost_and_why(disk: Disk) -> None:
    disk.fill()
    disk.commits.write((ADD, (1, LONG)))
    disk.commits.write((ADD, (2, LONG)))
    disk.until_told(1)
    lost, error = disk.commits.close()
    assert [values[0] for _, values in lost] == [1, 2]
    assert isinstance(error, sqlite3.OperationalError)
    assert disk.written() == []


def test_closing_commits_what_waits(disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commits_module, "COMMIT_S", 3600.0)
    disk.commits.write((ADD, (1, "one")))
    disk.commits.write_file(disk.path.with_name("file"), b"content")
    assert disk.commits.close() == ([], None)
    assert disk.written() == [1]
    assert disk.path.with_name("file").read_bytes() == b"content"


def test_a_file_is_written_after_what_was_recorded_before(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of contents that follow one another meanwhile, the last one is written."""
    held, contents = Held(monkeypatch), list[bytes]()
    monkeypatch.setattr(
        commits_module, "write_whole", lambda _path, content: contents.append(content)
    )
    disk.commits.write((ADD, (1, "first")))
    disk.commits.write_file(disk.path.with_name("file"), b"first")
    assert held.begun.wait(DEADLINE_S)
    for content in (b"second", b"third"):
        disk.commits.write_file(disk.path.with_name("file"), content)
    assert contents == []
    held.go.set()
    disk.commits.sync()
    assert disk.written() == [1]
    assert contents[-1] == b"third"
    assert b"second" not in contents


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "is full"),
        (errno.EDQUOT, "is full"),
        (errno.EROFS, "is read-only"),
        (errno.EIO, "cannot be written"),
    ],
)
def test_writing_a_file_also_waits_and_keeps_the_old_contents(
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
    disk.commits.write_file(file, b"after")
    disk.commits.sync()
    assert file.read_bytes() == b"after"
    disk.until_told(1)
    assert words in disk.told[0][0]
