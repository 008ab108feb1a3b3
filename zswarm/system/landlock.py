"""Hide files from this process and all that it starts, by Linux's Landlock (landlock(7)).

Landlock only grants, so everything beside the hidden paths is granted: what lies next to them and
next to each folder above them. A file that is made there later cannot be read either.
"""

import contextlib
import ctypes
import os
import stat
import struct
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

# The same on all architectures since Linux 5.13.
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
VERSION = 1  # flag: return the version of the interface
OLDEST = 2  # before, no file could be moved to another folder
PATH_BENEATH = 1
READ_FILE, REFER = 1 << 2, 1 << 13
NO_NEW_PRIVS = 38  # of prctl; what Landlock asks for
OTHERS_WRITE = 0o002


def hide(paths: Iterable[Path]) -> bool:
    """Make folders unreadable, for good, for the calling thread and what it starts.

    Paths that do not exist are ignored, and those below a folder in which everyone writes, as /tmp:
    new files there must be readable.

    Returns:
        whether all that exist are hidden; False on kernels without Landlock.
    """
    there = {path.resolve() for path in paths if path.exists()}
    hidden = {path for path in there if not _is_shared(path)}
    if not hidden:
        return not there
    if not supported():
        return False
    attributes = struct.pack("=Q", READ_FILE | REFER)
    rules = _call(CREATE_RULESET, attributes, len(attributes), 0)
    if rules < 0:
        return False
    try:
        _grant(rules, Path("/"), REFER)
        for path in _beside(Path("/"), hidden):
            _grant(rules, path, READ_FILE)
        ctypes.CDLL(None).prctl(NO_NEW_PRIVS, 1, 0, 0, 0)
        return _call(RESTRICT_SELF, rules, 0) == 0 and hidden == there
    finally:
        os.close(rules)


def why_not(paths: Iterable[Path]) -> str:
    """Return why ``hide`` cannot hide folders; "" if it can, or there are none."""
    there = [path.resolve() for path in paths if path.exists()]
    if there and not supported():
        return "this kernel has no Landlock: Linux 5.19 or newer has"
    if shared := [path for path in there if _is_shared(path)]:
        return f"everyone may write in a folder above {shared[0]}"
    return ""


def supported() -> bool:
    """Return whether this kernel has Landlock, as new as is needed."""
    return sys.platform == "linux" and _call(CREATE_RULESET, None, 0, VERSION) >= OLDEST


def _is_shared(path: Path) -> bool:
    return any(above.stat().st_mode & OTHERS_WRITE for above in path.parents)


def _beside(folder: Path, hidden: set[Path]) -> Iterator[Path]:
    """Yield all in a folder but what is hidden, and likewise in folders above that."""
    above = {parent for path in hidden for parent in path.parents}
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            path = Path(entry.path)
            if path in above:
                yield from _beside(path, hidden)
            elif path not in hidden:
                yield path


def _grant(rules: int, path: Path, rights: int) -> None:
    """Grant rights to what is in a folder, or to a file; links grant nothing."""
    with contextlib.suppress(OSError):  # it is gone
        at = os.open(path, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            if not stat.S_ISLNK(os.fstat(at).st_mode):
                rule = struct.pack("=Qi", rights, at)
                _call(ADD_RULE, rules, PATH_BENEATH, rule, 0)
        finally:
            os.close(at)


def _call(number: int, *arguments: int | bytes | None) -> int:
    return int(ctypes.CDLL(None).syscall(ctypes.c_long(number), *arguments))
