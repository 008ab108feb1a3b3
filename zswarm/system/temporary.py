"""Private temporary folders that do not outlive their program for long.

A program holds a lock on its folder while it lives, with the processes that it forks. The next
program that makes one removes those of killed programs.
"""

import contextlib
import fcntl
import os
import shutil
import stat
import tempfile
import time
from pathlib import Path
from typing import Self

PREFIX = "zswarm-of-"
YOUNG_S = 60.0  # a folder's program may not have locked it yet


class LockedFolder:
    """A private folder, which is removed when the ``with`` block or its program ends.

    Attributes:
        path: of the folder.
    """

    def __init__(self) -> None:
        remove_orphans(Path(tempfile.gettempdir()))
        self.path = Path(tempfile.mkdtemp(prefix=PREFIX))  # mode 0700
        self._lock = os.open(self.path, os.O_RDONLY)
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.remove()

    def remove(self) -> None:
        """Remove the folder with what is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self._lock)


def remove_orphans(parent: Path) -> None:
    """Remove the folders that killed programs of this user have left."""
    for folder in parent.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            found = folder.lstat()
            young = time.time() - found.st_mtime < YOUNG_S
            if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode) or young:
                continue
            lock = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
            finally:
                os.close(lock)
