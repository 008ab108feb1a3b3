"""Choose the folder in which compiled kernels are cached.

numba's own cache looks only at the file that defines a function, so it would return outdated code
after a change elsewhere. The cache folder is therefore named by a hash of all code that may be
compiled and of the processor (``version_hash.cache_hash``).
"""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import platformdirs

from zswarm.plugins.version_hash import cache_hash


def cache_folder() -> Path:
    """Create the folder below the first usable candidate.

    The candidates are ``$ZSWARM_CACHE``, systemd's ``$CACHE_DIRECTORY``, the user's cache folder
    and the temporary folder.
    """
    for candidate in _candidates():
        folder = candidate / cache_hash()
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
    return Path(tempfile.mkdtemp(prefix="zswarm-"))


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
