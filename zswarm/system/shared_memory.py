"""POSIX shared memory that Python code of this process creates by name, and does not remove."""

import _posixshmem  # type: ignore[import-not-found]  # private
import contextlib
import os
from collections.abc import Callable
from multiprocessing import resource_tracker
from typing import Any


def watch(report: Callable[[str, bool], None]) -> Callable[[], None]:
    """Report each name before it is created, and once it is removed; return what ends that.

    Args:
        report: called with the name, and whether it is to exist.
    """
    create, remove = _posixshmem.shm_open, _posixshmem.shm_unlink

    def shm_open(path: str, flags: int, *mode: Any, **options: Any) -> int:
        if flags & os.O_CREAT:
            report(path, True)
        try:
            return int(create(path, flags, *mode, **options))
        except FileExistsError:  # another's
            report(path, False)
            raise

    def shm_unlink(path: str) -> None:
        remove(path)
        report(path, False)

    def stop() -> None:
        _posixshmem.shm_open, _posixshmem.shm_unlink = create, remove

    _posixshmem.shm_open, _posixshmem.shm_unlink = shm_open, shm_unlink
    return stop


def remove(name: str) -> None:
    """Remove shared memory that another process created, if it is still there."""
    with contextlib.suppress(OSError):
        _posixshmem.shm_unlink(name)
    # Python removes it at its own end otherwise, with a warning; it knows the name or not.
    resource_tracker.register(name, "shared_memory")
    resource_tracker.unregister(name, "shared_memory")
