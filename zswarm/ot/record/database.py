"""The SQLite file of a record: written in whole transactions, also through a disk outage."""

import contextlib
import errno
import os
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from zswarm.errors import ConfigError
from zswarm.ot.record.schema import TABLES

COMMIT_S = 0.1
RETRY_S = 1.0  # during a disk outage
WAL = b"\x02\x02"  # bytes 18 and 19 of a database with a write-ahead log
TRIGGERS = "SELECT 1 FROM sqlite_master WHERE type = 'trigger'"
SIDE_FILES = ("-wal", "-shm", "-journal")  # that SQLite keeps next to a database
NETWORK_FILE_SYSTEMS = frozenset(
    "nfs nfs4 cifs smb3 smbfs 9p afs ceph glusterfs lustre fuse.sshfs".split()
)
# Disk errors that may pass, as SQLite and as the system call reports them.
TRANSIENT_SQLITE = {
    sqlite3.SQLITE_FULL: "full",
    sqlite3.SQLITE_READONLY: "read-only",
    sqlite3.SQLITE_IOERR: "failing",
    sqlite3.SQLITE_CANTOPEN: "failing",
    sqlite3.SQLITE_BUSY: "locked",
}
TRANSIENT_SYSTEM = {
    errno.ENOSPC: "full",
    errno.EDQUOT: "full",
    errno.EROFS: "read-only",
    errno.EACCES: "read-only",
    errno.EPERM: "read-only",
    errno.EIO: "failing",
    errno.EFBIG: "failing",
    errno.ESTALE: "failing",
}
OUTAGES = {
    "full": "is full: waiting for room",
    "read-only": "is read-only: waiting until it can be written",
    "failing": "does not take what is written: trying again",
    "locked": "is locked by another program: waiting for its end",
}
SYSTEM_WORDS = {"full": os.strerror(errno.ENOSPC), "read-only": os.strerror(errno.EROFS)}
# UnicodeDecodeError: SQLite quotes a damaged schema in its message.
UNREADABLE = (sqlite3.Error, OSError, UnicodeDecodeError)

T = TypeVar("T")
Statement = tuple[str, tuple[Any, ...]]


class Database:
    """A SQLite file, open for writing.

    Statements wait in a list until they are committed together. Each must allow to be executed
    twice: a commit that failed may have reached the disk.

    Args:
        report: called with a line for the user when an outage begins (and None), and when it ends
            (and its seconds).

    Attributes:
        path: of the file.
        unwritten: what is not committed yet.
    """

    def __init__(
        self,
        path: Path,
        connection: sqlite3.Connection,
        report: Callable[[str, float | None], None],
    ) -> None:
        self.unwritten: list[Statement] = []
        self.path, self._folder = path, path.parent
        self._connection, self._report = connection, report
        self._next_commit = 0.0
        self._outage_since: float | None = None

    def write(self, *statements: Statement) -> None:
        """Commit statements together, at the next ``flush`` that is due."""
        self.unwritten += statements
        self.flush()

    def flush(self) -> None:
        """Commit if the last commit was 0.1 s ago; during an outage statements wait."""
        if time.monotonic() >= self._next_commit:
            with self._outages():
                self.commit()

    def write_now(self, *statements: Statement) -> None:
        """Commit everything and wait until it is on the disk."""
        self.unwritten += statements  # in one step: Ctrl-C loses all of them or none
        if self.unwritten:
            self.retry(self.commit)

    def rows(self, sql: str, *parameters: Any) -> list[Any]:
        """Commit everything, then query."""
        self.write_now()
        return self.retry(lambda: self._connection.execute(sql, parameters).fetchall())

    def retry(self, action: Callable[[], T]) -> T:
        """Call until the disk lets the action succeed."""
        while True:
            with self._outages():
                return action()
            time.sleep(RETRY_S)

    def commit(self) -> None:
        """Commit everything in one transaction, now.

        Raises:
            ConfigError: the file is gone, or a value is too large for SQLite.
            sqlite3.OperationalError, OSError: the disk refuses it; see ``outage``.
        """
        pause = COMMIT_S if self._outage_since is None else RETRY_S
        self._next_commit = time.monotonic() + pause
        if not self.unwritten:
            return
        if not self.path.exists():  # SQLite would write to the unlinked file
            raise ConfigError(
                f"{self._folder}: moved, removed or unmounted while the run went on"
            )
        try:
            transact(self._connection, self.unwritten)
        except (sqlite3.DataError, OverflowError) as error:
            raise ConfigError(
                f"{self._folder}: cannot be recorded: {error}; SQLite takes at most "
                "1,000,000,000 bytes in a value"
            ) from None
        self.unwritten = []

    def write_once(self) -> None:
        """Do without a write-ahead log, in which all that is large would be written first.

        Other programs cannot read while a commit is written then. If one reads now, the log stays.
        """
        with contextlib.suppress(sqlite3.OperationalError):
            self._connection.execute("PRAGMA journal_mode = DELETE")

    def close(self) -> None:
        """Close the file without a commit."""
        self._connection.close()

    @contextlib.contextmanager
    def _outages(self) -> Iterator[None]:
        """Report the first failure of an outage, and the first success after it."""
        try:
            yield
        except (sqlite3.OperationalError, OSError) as error:
            why = outage(error, self._folder)
            if not why:
                raise
            if self._outage_since is None:
                self._outage_since = time.monotonic()
                self._report(
                    f"the disk of {self._folder} {OUTAGES[why]}; nothing is lost", None
                )
        else:
            if self._outage_since is not None:
                waited, self._outage_since = time.monotonic() - self._outage_since, None
                self._report(
                    f"the disk of {self._folder} takes data again: the run continues",
                    waited,
                )


def connect(path: Path) -> sqlite3.Connection:
    """Open a database for writing; commits are synced to the disk.

    Raises:
        sqlite3.DatabaseError: it is damaged, or cannot be written now; see ``outage``.
    """
    connection = sqlite3.connect(path, isolation_level=None, timeout=10.0)
    try:
        # WAL needs memory that is shared by all programs that open the file.
        connection.execute(
            f"PRAGMA journal_mode = {'DELETE' if on_network(path) else 'WAL'}"
        )
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA trusted_schema = OFF")
        # Debian's SQLite overwrites what it deletes, which writes a large state twice more.
        connection.execute("PRAGMA secure_delete = OFF")
        # The record may come from somebody else, whose SQL would run when something is written.
        if connection.execute(TRIGGERS).fetchone():
            raise sqlite3.DatabaseError("it has a trigger; zswarm makes none")
        # macOS: without it the drive may still have what was synced in its cache.
        connection.execute("PRAGMA fullfsync = ON")
    except BaseException:  # KeyboardInterrupt, too
        connection.close()
        raise
    return connection


@contextlib.contextmanager
def read_only(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a record for reading; no file is created or changed next to it.

    Raises:
        sqlite3.Error, OSError, UnicodeDecodeError: it cannot be read.
    """
    path = path.resolve()
    log = path.with_name(f"{path.name}-wal")
    with path.open("rb") as file:
        header, size = file.read(20), file.seek(0, os.SEEK_END)
    page = int.from_bytes(header[16:18]) or 1
    with contextlib.ExitStack() as stack:

        def opened(at: Path, how: str) -> sqlite3.Connection:
            database = sqlite3.connect(f"{at.as_uri()}?{how}", uri=True)
            stack.callback(database.close)
            database.text_factory = lambda raw: raw.decode(errors="replace")
            database.execute("PRAGMA trusted_schema = OFF")
            kinds = dict(
                database.execute("SELECT name, type FROM sqlite_master").fetchall()
            )
            if missing := [name for name in TABLES if kinds.get(name) != "table"]:
                raise sqlite3.DatabaseError(f"no table {missing[0]}")
            return database

        if header[18:] == WAL and not (log.is_file() and log.stat().st_size):
            if size % page:  # SQLite would read the missing end as zeros
                raise sqlite3.DatabaseError("its end is missing")
            # The log is empty. Without `immutable` SQLite would create one.
            yield opened(path, "immutable=1")
            return
        try:
            database = opened(path, "mode=ro")
        except sqlite3.OperationalError as error:
            unwritable = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY)
            if error.sqlite_errorcode & 0xFF not in unwritable or not log.is_file():
                raise
            # SQLite needs an index next to the log, but may not write there.
            copy = Path(
                stack.enter_context(tempfile.TemporaryDirectory(prefix="zswarm-"))
            )
            for source in (path, log):
                shutil.copyfile(source, copy / source.name)
            database = opened(copy / path.name, "mode=rw")
        yield database


def transact(connection: sqlite3.Connection, statements: Iterable[Statement]) -> None:
    """Execute all statements or none; a commit that fails may be either."""
    try:
        connection.execute("BEGIN IMMEDIATE")
        for sql, parameters in statements:
            connection.execute(sql, parameters)
        connection.execute("COMMIT")
    except BaseException:  # KeyboardInterrupt, too
        if connection.in_transaction:
            with contextlib.suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
        raise


def outage(error: BaseException, folder: Path) -> str:
    """Return the key in ``OUTAGES`` of an error that may pass, else ""."""
    why = ""
    if isinstance(error, sqlite3.Error):
        why = TRANSIENT_SQLITE.get(getattr(error, "sqlite_errorcode", 0) & 0xFF, "")
    elif isinstance(error, OSError):
        why = TRANSIENT_SYSTEM.get(error.errno or 0, "")
    with contextlib.suppress(OSError):
        disk = os.statvfs(folder)
        if why == "failing" and disk.f_flag & os.ST_RDONLY:
            return "read-only"
        # SQLite reports a full disk as an I/O error when it extends the log's index.
        if why == "failing" and not disk.f_bavail:
            return "full"
    return why


def describe(error: BaseException, folder: Path) -> str:
    """Describe a disk error without numbers and paths."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return SYSTEM_WORDS.get(outage(error, folder)) or str(error)


def on_network(path: Path) -> bool:
    """Return whether a path is on a network file system, according to Linux."""
    try:
        mounts = [
            line.split() for line in Path("/proc/self/mounts").read_text().splitlines()
        ]
    except OSError:
        return False
    inside = [mount for mount in mounts if path.resolve().is_relative_to(mount[1])]
    return (
        bool(inside)
        and max(inside, key=lambda mount: len(mount[1]))[2] in NETWORK_FILE_SYSTEMS
    )
