"""A SQLite file that is written in whole transactions and waits for a disk that takes nothing."""

import contextlib
import errno
import os
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from zswarm.errors import ConfigError

COMMIT_S = 0.1
RETRY_S = 1.0  # while the disk takes nothing
NETWORK_FILE_SYSTEMS = {"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "afs", "ceph", "glusterfs", "lustre", "fuse.sshfs"}
# What a disk does that may pass, as SQLite and the system call it.
PASSING_SQLITE = {
    sqlite3.SQLITE_FULL: "full",
    sqlite3.SQLITE_READONLY: "read-only",
    sqlite3.SQLITE_IOERR: "failing",
    sqlite3.SQLITE_CANTOPEN: "failing",
    sqlite3.SQLITE_BUSY: "locked",
}
PASSING_SYSTEM = {
    errno.ENOSPC: "full",
    errno.EDQUOT: "full",
    errno.EROFS: "read-only",
    errno.EACCES: "read-only",
    errno.EPERM: "read-only",
    errno.EIO: "failing",
    errno.EFBIG: "failing",
    errno.ESTALE: "failing",
}
WAITING_FOR = {
    "full": "is full: waiting for room",
    "read-only": "is read-only: waiting until it can be written",
    "failing": "does not take what is written: trying again",
    "locked": "is locked by another program: waiting for its end",
}

SYSTEM_WORDS = {"full": os.strerror(errno.ENOSPC), "read-only": os.strerror(errno.EROFS)}

T = TypeVar("T")
Statement = tuple[str, tuple[Any, ...]]


class Database:
    """A SQLite file, open for writing.

    What is written waits in a list until it is committed as a whole. Each statement may be executed a second time, for a
    commit that failed may have reached the disk.

    Args:
        path: the file.
        connection: to it, from ``connect``.
        tell: takes a line for the user when the disk begins to take nothing (and None), and another when it takes data
            again, with the seconds between.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, tell: Callable[[str, float | None], None]) -> None:
        self.unwritten: list[Statement] = []
        self._path, self._folder = path, path.parent
        self._connection, self._tell = connection, tell
        self._next_commit = 0.0
        self._waiting_since: float | None = None

    def write(self, *statements: Statement) -> None:
        """Have them committed together, within 0.1 s if more is written or ``flush`` called then."""
        self.unwritten += statements
        self.flush()

    def flush(self) -> None:
        """Commit if the last commit is 0.1 s ago; what the disk does not take now waits."""
        if time.monotonic() >= self._next_commit:
            with self._patience():
                self.commit()

    def settle(self, *statements: Statement) -> None:
        """Write, and wait until all is on the disk."""
        self.unwritten += statements  # at once: Ctrl-C before leaves none of it, after all of it
        if self.unwritten:
            self.insist(self.commit)

    def rows(self, sql: str, *parameters: Any) -> list[Any]:
        """What a query finds; what was written is read, too."""
        self.settle()
        return self.insist(lambda: self._connection.execute(sql, parameters).fetchall())

    def insist(self, action: Callable[[], T]) -> T:
        """Do it, as soon as the disk lets it be done."""
        while True:
            with self._patience():
                return action()
            time.sleep(RETRY_S)

    def commit(self) -> None:
        """Everything unwritten in one transaction, now.

        Raises:
            ConfigError: the file is gone.
            sqlite3.OperationalError, OSError: the disk does not take it; see ``passing``.
        """
        self._next_commit = time.monotonic() + (COMMIT_S if self._waiting_since is None else RETRY_S)
        if not self.unwritten:
            return
        if not self._path.exists():  # SQLite would go on writing to where nobody finds it
            raise ConfigError(f"{self._folder}: moved, removed or unmounted while the run went on")
        transact(self._connection, self.unwritten)
        self.unwritten = []

    def close(self) -> None:
        """Let go of the file; what is unwritten is not committed."""
        self._connection.close()

    @contextlib.contextmanager
    def _patience(self) -> Iterator[None]:
        """A fault of the disk that may pass is told once, and when it has passed."""
        try:
            yield
        except (sqlite3.OperationalError, OSError) as error:
            why = passing(error, self._folder)
            if not why:
                raise
            if self._waiting_since is None:
                self._waiting_since = time.monotonic()
                self._tell(f"the disk of {self._folder} {WAITING_FOR[why]}; nothing is lost", None)
        else:
            if self._waiting_since is not None:
                waited, self._waiting_since = time.monotonic() - self._waiting_since, None
                self._tell(f"the disk of {self._folder} takes data again: going on", waited)


def connect(path: Path) -> sqlite3.Connection:
    """A connection whose commits are synced to the disk.

    Raises:
        sqlite3.DatabaseError: damaged, or not to be written now; see ``passing``.
    """
    connection = sqlite3.connect(path, isolation_level=None, timeout=10.0)
    try:
        # WAL needs memory shared between all that open the file.
        connection.execute(f"PRAGMA journal_mode = {'DELETE' if on_network(path) else 'WAL'}")
        connection.execute("PRAGMA synchronous = FULL")
    except BaseException:  # Ctrl-C, too, must not leave it open
        connection.close()
        raise
    return connection


def transact(connection: sqlite3.Connection, statements: Iterable[Statement]) -> None:
    """All of them or none; of a commit that fails either may be true."""
    try:
        connection.execute("BEGIN IMMEDIATE")
        for sql, parameters in statements:
            connection.execute(sql, parameters)
        connection.execute("COMMIT")
    except BaseException:  # Ctrl-C, too, must not leave the transaction open
        if connection.in_transaction:
            with contextlib.suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
        raise


def passing(error: BaseException, folder: Path) -> str:
    """What the disk does, if that may pass: a key of ``WAITING_FOR``; else ""."""
    why = ""
    if isinstance(error, sqlite3.Error):
        why = PASSING_SQLITE.get(getattr(error, "sqlite_errorcode", 0) & 0xFF, "")
    elif isinstance(error, OSError):
        why = PASSING_SYSTEM.get(error.errno or 0, "")
    with contextlib.suppress(OSError):
        disk = os.statvfs(folder)
        if why == "failing" and disk.f_flag & os.ST_RDONLY:
            return "read-only"
        if why == "failing" and not disk.f_bavail:  # SQLite does not say so of the log's index
            return "full"
    return why


def in_words(error: BaseException, folder: Path) -> str:
    """An error of the disk that holds a folder, without numbers and paths."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return SYSTEM_WORDS.get(passing(error, folder)) or str(error)


def on_network(path: Path) -> bool:
    """Whether a path lies on a network file system (where Linux tells)."""
    try:
        mounts = [line.split() for line in Path("/proc/self/mounts").read_text().splitlines()]
    except OSError:
        return False
    inside = [mount for mount in mounts if path.resolve().is_relative_to(mount[1])]
    return bool(inside) and max(inside, key=lambda mount: len(mount[1]))[2] in NETWORK_FILE_SYSTEMS
