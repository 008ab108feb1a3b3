"""Write files completely or not at all."""

import contextlib
import fcntl
import os
from collections.abc import Collection
from pathlib import Path

from zswarm.errors import ConfigError


def write_whole(
    path: Path, content: bytes, mode: int = 0o666, owner: tuple[int, int] | None = None
) -> None:
    """Write a file and sync it to disk; on an error it stays as it was.

    Args:
        path: the file; its name with ``.part`` is used until it is complete.
        content: everything.
        mode: permissions, less the umask, from the first byte on.
        owner: numeric user and group; None: those of the process.
    """
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    opened = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(opened, "wb") as file:
            if owner is not None:
                os.fchown(opened, *owner)
            file.write(content)
            file.flush()
            sync_descriptor(opened)
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    sync(path.parent)


def write_for_user(path: Path, content: bytes) -> None:
    """Write a file that a user named; write into a link or a device, such as ``/dev/stdout``."""
    try:
        if path.is_symlink() or (path.exists() and not path.is_file()):
            path.write_bytes(content)
        else:
            write_whole(path, content)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None


def sync(folder: Path) -> None:
    """Sync a folder to disk, so that renamed files in it survive a crash."""
    opened = os.open(folder, os.O_RDONLY)
    try:
        sync_descriptor(opened)
    finally:
        os.close(opened)


def sync_descriptor(descriptor: int) -> None:
    """Wait until an open file or folder is on the disk; on macOS, also out of the drive's cache."""
    if hasattr(fcntl, "F_FULLFSYNC"):
        with contextlib.suppress(OSError):  # a file system that does not know it
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
            return
    os.fsync(descriptor)


def make_private(
    folder: Path, names: Collection[str], owner: tuple[int, int] | None = None
) -> None:
    """Create a folder that only its owner may enter, for files of the given names.

    Args:
        folder: created with its parents if missing.
        names: files it may hold, also with ``.part``.
        owner: numeric user and group; None: those of the process.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)
    known = {*names, *(f"{name}.part" for name in names)}
    if other := sorted(set(os.listdir(folder)) - known):
        raise ConfigError(
            f"{folder}: expected a folder for keys alone, and it holds {other[0]!r}"
        )
    folder.chmod(0o700)
    if owner is not None:
        os.chown(folder, *owner)
