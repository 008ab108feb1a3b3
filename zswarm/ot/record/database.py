"""The SQLite file of a record: how it is opened, written in transactions, and what may fail."""

import contextlib
import errno
import os
import shutil
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from zswarm.ot.record.schema import TABLES
from zswarm.system.temporary import LockedFolder

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
    "failing": "cannot be written: trying again",
    "locked": "is locked by another program: waiting for its end",
}
SYSTEM_WORDS = {"full": os.strerror(errno.ENOSPC), "read-only": os.strerror(errno.EROFS)}
# UnicodeDecodeError: SQLite quotes a damaged schema in its message.
UNREADABLE = (sqlite3.Error, OSError, UnicodeDecodeError)

Statement = tuple[str, tuple[Any, ...]]


def connect(path: Path) -> sqlite3.Connection:
    """Open a database for writing; commits are synced to the disk.

    Raises:
        sqlite3.DatabaseError: it is damaged, or cannot be written now; see ``outage``.
    """
    # The thread that opens it hands it to the one that commits.
    connection = sqlite3.connect(
        path, isolation_level=None, timeout=10.0, check_same_thread=False
    )
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
            copy = stack.enter_context(LockedFolder()).path
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
