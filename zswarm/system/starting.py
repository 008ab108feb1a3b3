"""Let other programs of this machine know that a daemon is starting, until it can be reached.

A locked file says so: a daemon that is killed leaves its file, but not its lock.
"""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from zswarm.system.locks import make_private, private_folder, visible_folders

SUFFIX = ".starting"


class Starting:
    """Marks this program as starting; without a folder for the file it is not marked."""

    _file: BinaryIO | None = None

    def __init__(self) -> None:
        here = private_folder()
        self._path = here / f"{os.getpid()}{SUFFIX}"
        with contextlib.suppress(OSError):
            make_private(here)
            for path in _stale(here):
                path.unlink()
            self._file = _opened(self._path, os.O_CREAT | os.O_RDWR)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def end(self) -> None:
        """Remove the mark; a second call does nothing."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            self._file.close()
            self._file = None


def daemons() -> int:
    """Return how many daemons of this machine, which this user can see, are starting."""
    found = [path for folder in visible_folders() for path in folder.glob("*" + SUFFIX)]
    return sum(is_locked(path) for path in found)


def _stale(here: Path) -> Iterator[Path]:
    return (path for path in here.glob("*" + SUFFIX) if not is_locked(path))


def is_locked(path: Path) -> bool:
    """Return whether the program that made a file is still starting."""
    try:
        with _opened(path, os.O_RDONLY) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # it was removed meanwhile, or is not readable
        pass
    return False


def _opened(path: Path, flags: int) -> BinaryIO:
    return os.fdopen(os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644), "rb")
