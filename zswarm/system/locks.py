"""Locks between programs of a user: files in a private folder, opened through no link."""

import contextlib
import errno
import fcntl
import hashlib
import os
import stat
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO


def private_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return where programs of this user put sockets and locks."""
    if runtime := environment.get("RUNTIME_DIRECTORY", "").split(":")[0]:  # by systemd
        return Path(runtime)
    if os.geteuid() == 0:
        return Path("/run/zswarm")
    if runtime := environment.get("XDG_RUNTIME_DIR", ""):
        return Path(runtime) / "zswarm"
    return Path(tempfile.gettempdir()) / f"zswarm-{os.geteuid()}"


def folders() -> set[Path]:
    """Return where programs of this machine put sockets and locks that this user may see."""
    found = {private_folder(), Path("/run/zswarm")}
    found.add(Path(tempfile.gettempdir()) / f"zswarm-{os.geteuid()}")
    if session := os.environ.get("XDG_RUNTIME_DIR", ""):
        found.add(Path(session) / "zswarm")
    return found


def visible_folders() -> list[Path]:
    """Return those of the folders that no other user can have made.

    In /tmp another user can make the folder that a program of this user would have.
    """
    return [one for one in folders() if is_private(one) or is_private(one.parent)]


def make_private(here: Path) -> None:
    """Make such a folder; refuse one that other users can write in.

    Raises:
        OSError: its parent is missing, it cannot be made, or it is not this user's.
    """
    if not here.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(here.parent))
    with contextlib.suppress(FileExistsError):
        here.mkdir(mode=0o755 if os.geteuid() == 0 else 0o700)
    if not is_private(here):
        reason = "it is not a folder of this user, or others can write in it"
        raise PermissionError(errno.EPERM, reason, str(here))


def is_private(here: Path) -> bool:
    """Return whether this is a folder in which only this user and root can write."""
    try:
        # systemd's folder is a link if the user is dynamic
        found = here.stat(follow_symlinks="RUNTIME_DIRECTORY" in os.environ)
    except OSError:
        return False
    own = found.st_uid in (0, os.geteuid())
    return stat.S_ISDIR(found.st_mode) and own and not found.st_mode & 0o022


def locked(what: bytes) -> BinaryIO:
    """Return a file that locks what is described against this user's programs until it is closed.

    Raises:
        BlockingIOError: another program has locked it.
        OSError: the file cannot be opened, or is a link.
    """
    here = private_folder()
    make_private(here)
    path = here / f"{hashlib.blake2b(what, digest_size=8).hexdigest()}.lock"
    flags = os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC
    held = os.fdopen(os.open(path, flags, 0o600), "rb")
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        held.close()
        error.filename = str(path)
        raise
    return held
