"""A thread that commits what a run records, so that the run does not wait for the disk.

What is written is committed in the order in which it was written, so that the file always has a
beginning of it; statements written together are committed together.
"""

import contextlib
import sqlite3
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from zswarm.errors import ConfigError
from zswarm.ot.record.database import OUTAGES, Statement, outage, transact
from zswarm.system.files import write_whole

COMMIT_S = 0.03  # statements wait so long for others to be committed with them
UNSYNCED_S = 0.05  # the oldest statement that ``pace`` lets wait
RETRY_S = 1.0  # during a disk outage

Query = tuple[str, tuple[Any, ...]]


class Commits:
    """A SQLite file, open for writing; all methods are for one thread, ``sync`` is for any.

    Each statement must allow to be executed twice: a commit that failed may have reached the disk.

    Args:
        report: called with a line for the user when a disk outage begins (and None), and when it
            ends (and its seconds); by the thread that calls a method.

    Attributes:
        path: of the file.
    """

    def __init__(
        self,
        path: Path,
        connection: sqlite3.Connection,
        report: Callable[[str, float | None], None],
    ) -> None:
        self.path, self._folder = path, path.parent
        self._connection, self._report = connection, report
        # All that follows, and what a thread waits for.
        self._changed = threading.Condition()
        self._groups: list[tuple[float, tuple[Statement, ...]]] = []  # and since when
        self._files: dict[Path, bytes] = {}
        self._query: Query | None = None
        self._rows: list[Any] = []
        self._now = self._closing = self._without_log = False
        self._reports: list[tuple[str, float | None]] = []
        self._outage_since: float | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="record", daemon=True)
        self._thread.start()

    def write(self, *statements: Statement) -> None:
        """Have statements committed together, soon."""
        with self._changed:
            self._groups.append((time.monotonic(), statements))
            if len(self._groups) == 1:
                self._changed.notify_all()
        self.check()

    def write_file(self, path: Path, content: bytes) -> None:
        """Have a file replaced in one step, once all that was written before is committed.

        Of contents that follow one another quickly, only the last one is written.
        """
        with self._changed:
            self._files[path] = content
            self._changed.notify_all()
        self.check()

    def write_once(self) -> None:
        """Do without a write-ahead log, in which all that is large would be written first.

        Other programs cannot read while a commit is written then. If one reads now, the log stays.
        """
        self._without_log = True

    def check(self) -> None:
        """Report what happened to the disk; raise the error by which the thread ended.

        Raises:
            ConfigError: the file is gone, or a value is too large for SQLite.
            sqlite3.Error: a statement is wrong, or the file is damaged.
        """
        while self._reports:
            self._report(*self._reports.pop(0))
        if self._error is not None:
            raise self._error

    def pace(self) -> None:
        """Wait while something waits to be committed for longer than 0.05 s."""
        self._wait(lambda: not self._groups or self._age() < UNSYNCED_S)

    def sync(self) -> None:
        """Wait until all that was written is on the disk."""
        with self._changed:
            self._now = bool(self._groups)
            self._changed.notify_all()
        self._wait(lambda: not (self._groups or self._files))

    def rows(self, sql: str, *parameters: Any) -> list[Any]:
        """Commit everything, then query."""
        with self._changed:
            self._query = (sql, parameters)
            self._changed.notify_all()
        self._wait(lambda: self._query is None)
        return self._rows

    def close(self) -> tuple[list[Statement], BaseException | None]:
        """Commit if the disk lets us, and close the file.

        Returns:
            The statements that could not be committed, and why.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        self._connection.close()
        return [one for _, group in self._groups for one in group], self._error

    def _age(self) -> float:
        return time.monotonic() - self._groups[0][0]

    def _wait(self, over: Callable[[], bool]) -> None:
        """Wait for the thread, and report meanwhile."""
        while True:
            self.check()
            with self._changed:
                if over():
                    return
                self._changed.wait_for(lambda: over() or self._reports or self._error)

    # ---- the thread

    def _work(self) -> None:
        """Commit until the end; the thread's function."""
        try:
            while self._due():
                try:
                    self._commit()
                except (sqlite3.OperationalError, OSError) as error:
                    if not self._passes(error):
                        raise
        except BaseException as error:
            with self._changed:
                self._error = error
                self._changed.notify_all()

    def _due(self) -> bool:
        """Wait for something to do; return False at the end."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._groups or self._files or self._query or self._closing
            )
            if self._groups:  # others may follow, to be committed with them
                self._changed.wait_for(
                    lambda: self._now or self._query or self._closing,
                    max(0.0, COMMIT_S - self._age()),
                )
            self._now = False
            return bool(self._groups or self._files or self._query)

    def _commit(self) -> None:
        """Commit what waits, write files, answer the query.

        Raises:
            ConfigError: see ``check``.
            sqlite3.OperationalError, OSError: the disk refuses it; see ``outage``.
        """
        groups, files, query = list(self._groups), dict(self._files), self._query
        if not self.path.exists():  # SQLite would write to the unlinked file
            raise ConfigError(
                f"{self._folder}: moved, removed or unmounted while the run went on"
            )
        if self._without_log:
            self._without_log = False
            with contextlib.suppress(sqlite3.OperationalError):
                self._connection.execute("PRAGMA journal_mode = DELETE")
        try:
            if groups:
                transact(self._connection, [one for _, group in groups for one in group])
        except (sqlite3.DataError, OverflowError) as error:
            raise ConfigError(
                f"{self._folder}: cannot be recorded: {error}; SQLite takes at most "
                "1,000,000,000 bytes in a value"
            ) from None
        with self._changed:
            del self._groups[: len(groups)]
            self._changed.notify_all()
        for path, content in files.items():
            write_whole(path, content)
        rows = self._connection.execute(*query).fetchall() if query is not None else []
        with self._changed:
            for path, content in files.items():
                if self._files[path] is content:
                    del self._files[path]
            if self._query is query:  # else its caller was interrupted, and asks another
                self._query, self._rows = None, rows
            if self._outage_since is not None:
                waited, self._outage_since = time.monotonic() - self._outage_since, None
                line = (
                    f"the disk of {self._folder} can be written again: the run continues"
                )
                self._reports.append((line, waited))
            self._changed.notify_all()

    def _passes(self, error: sqlite3.OperationalError | OSError) -> bool:
        """Report a disk outage, and wait until the next attempt is due; return False if none is."""
        why = outage(error, self._folder)
        with self._changed:
            if not why or self._closing:
                return False
            if self._outage_since is None:
                self._outage_since = time.monotonic()
                line = f"the disk of {self._folder} {OUTAGES[why]}; nothing is lost"
                self._reports.append((line, None))
                self._changed.notify_all()
            self._changed.wait_for(lambda: self._closing, RETRY_S)
        return True
