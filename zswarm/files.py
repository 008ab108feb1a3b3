"""Files that are on the disk with all their content, or as they were before."""

import os
from collections.abc import Collection
from pathlib import Path

from zswarm.errors import ConfigError


def write_whole(path: Path, content: bytes, mode: int = 0o666, owner: tuple[int, int] | None = None) -> None:
    """A file is there with all its content, on the disk, or as it was before.

    Args:
        path: its name and ``.part`` is used meanwhile.
        content: all of it.
        mode: permissions, less the umask; nobody else could read it for a moment.
        owner: numbers of user and group; None: who runs the program.
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
            os.fsync(opened)
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    sync(path.parent)


def write_for_user(path: Path, content: bytes) -> None:
    """Into what a user named: a file whole or not at all; a link or a device, such as ``/dev/stdout``, stays what it is.

    Raises:
        ConfigError: it cannot be written.
    """
    try:
        if path.is_symlink() or (path.exists() and not path.is_file()):
            path.write_bytes(content)
        else:
            write_whole(path, content)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None


def sync(folder: Path) -> None:
    """What was renamed in a folder is on the disk."""
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def make_private(folder: Path, names: Collection[str], owner: tuple[int, int] | None = None) -> None:
    """A folder that only its owner may enter, for files of these names.

    Args:
        folder: made where it is missing, as those above it.
        names: also with ``.part``.
        owner: numbers of user and group; None: who runs the program.

    Raises:
        ConfigError: it holds other files: it is somebody else's, and stays as it is.
        OSError: it cannot be made.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)
    known = {*names, *(f"{name}.part" for name in names)}
    if other := sorted(set(os.listdir(folder)) - known):
        raise ConfigError(f"{folder}: expected a folder for keys alone, and it holds {other[0]!r}")
    folder.chmod(0o700)
    if owner is not None:
        os.chown(folder, *owner)
