"""Choose the folder in which compiled kernels are cached.

numba's own cache looks only at the file that defines a function, so it would return outdated code
after a change elsewhere. The cache folder is therefore named by a hash of all code that may be
compiled and of the processor (``version_hash.cache_hash``). Each change makes a new folder; folders
that were not used for 30 days are deleted. zswarm's own kernels have a folder that no plug-in
changes: all installations of the same code share it.
"""

import contextlib
import fcntl
import functools
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import platformdirs

from zswarm.plugins.version_hash import cache_hash
from zswarm.system.temporary import LockedFolder

LOCK = "in-use"  # locked while a process uses the folder; its time says when one began to
CACHE = re.compile("[0-9a-f]{32}")
UNUSED_S = 30 * 86400.0
_claims: list[int] = []  # descriptors, held until the process and its forks end


def cache_folder(code: str | None = None) -> Path:
    """Create the folder below the first usable candidate.

    The candidates are ``$ZSWARM_CACHE``, systemd's ``$CACHE_DIRECTORY``, the user's cache folder
    and the temporary folder.

    Args:
        code: hash of the code that may be compiled; by default of all, with plug-ins.
    """
    for candidate in _candidates():
        folder = candidate / (code or cache_hash())
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError:
            continue
        if (
            os.access(folder, os.W_OK | os.X_OK)
            and _is_ours(folder.parent)
            and _is_ours(folder)
        ):
            return folder
    return _without_cache().path


@functools.cache
def _without_cache() -> LockedFolder:
    """Return a folder of this process and its forks."""
    return LockedFolder()


def claimed(folder: Path) -> Path:
    """Mark a cache folder as used by this process and its children; delete old ones beside it."""
    while True:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        descriptor = _locked(folder, fcntl.LOCK_SH)
        if (
            descriptor is None
        ):  # a file system without locks: nothing is deleted there, either
            return folder
        if _is_at(descriptor, folder / LOCK):  # not deleted before it was locked
            break
        os.close(descriptor)
    os.utime(descriptor)
    _claims.append(descriptor)
    for other in folder.parent.iterdir():
        if other != folder and CACHE.fullmatch(other.name):
            with contextlib.suppress(
                OSError
            ):  # another program deletes it, or it is another's
                _clear(other)
    return folder


def _clear(folder: Path) -> None:
    """Delete a folder that no process uses, and none used lately."""
    lock = folder / LOCK
    used = (lock if lock.exists() else folder).stat().st_mtime
    if time.time() - used < UNUSED_S or not _is_ours(folder):
        return
    descriptor = _locked(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    if descriptor is not None:
        try:
            shutil.rmtree(folder)
        finally:
            os.close(descriptor)


def _locked(folder: Path, how: int) -> int | None:
    """Return the descriptor of a folder's lock, which holds it, or None without one."""
    descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, how)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _candidates() -> Iterator[Path]:
    for name in ("ZSWARM_CACHE", "CACHE_DIRECTORY"):
        if folder := os.environ.get(name):
            yield Path(folder)
    # A user without a home directory, as in containers: RuntimeError, or "~" in old platformdirs.
    with contextlib.suppress(RuntimeError):
        if (folder := platformdirs.user_cache_dir("zswarm")).startswith("/"):
            yield Path(folder)
    yield Path(tempfile.gettempdir(), f"zswarm-{os.getuid()}")


def _is_ours(folder: Path) -> bool:
    """Return whether only this user can write there: cached code is executed."""
    status = folder.stat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022
