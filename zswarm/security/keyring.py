"""The keys that a program uses: where they are installed, and whether they may be used.

``find`` needs no package; ``load`` needs cryptography (the extra ``keys``).
"""

import os
import stat
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from zswarm.config.decode import from_json
from zswarm.errors import ConfigError, KeysError
from zswarm.security.members import IN_WORDS, Members, Role, SignedMembers
from zswarm.system import extras

SYSTEM = Path("/etc/zswarm/keys")
MAX_FILE = 1 << 20  # bytes; a list of 10,000 members takes half of it
PROGRAMS: dict[Role, str] = {
    "ss": "zswarm-ss",
    "ot": "zswarm-ot",
    "router": "zswarm-router",
}


class Keyring(NamedTuple):
    """Keys that are whole, valid now, and those of a member."""

    folder: Path
    role: Role
    name: str
    authority: str  # fingerprint, PRNY-624N-C2HJ-ADZT-...
    not_after: datetime  # UTC
    members: Members


def find(given: str = "") -> Path | None:
    """Return the folder of the installed keys; None if there are none.

    It is the given one, or that of ``ZSWARM_KEYS`` ("none": use no keys), or the first with keys
    that this user may read of /etc/zswarm/keys and the user's own. Keys of the system that this
    user may not read are found, too: to refuse them is better than to continue in the clear.
    """
    if chosen := given or os.environ.get("ZSWARM_KEYS", ""):
        return Path(chosen) if chosen != "none" else None
    places = {folder: _installed(folder) for folder in (SYSTEM, of_user())}
    for wanted in (True, None):
        for folder, found in places.items():
            if found is wanted:
                return folder
    return None


def installed(role: Role) -> Keyring | None:
    """Return the installed keys, for a program of a role; None if there are none."""
    folder = find()
    return load(folder, role) if folder is not None else None


def of_user() -> Path:
    """Return where a user's own keys are installed."""
    config = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
    return Path(config, "zswarm", "keys")


def folders() -> set[Path]:
    """Return where keys of this machine may be, of any user."""
    return {SYSTEM, of_user(), find() or SYSTEM}


def load(folder: Path, role: Role | None = None) -> Keyring:
    """Return the keys of a folder.

    Args:
        folder: from ``find``.
        role: that the program needs; None: any.
    """
    try:
        from zswarm.security import certificates  # needs cryptography, an extra
    except ModuleNotFoundError as error:
        raise KeysError(
            f"{folder}: keys need the package {error.name}: {extras.how('keys')}"
        ) from None
    if _installed(folder) is False:
        raise KeysError(
            f"{folder}: no keys are installed here; zswarm-keys join BUNDLE installs some"
        )
    names = certificates.AUTHORITY, certificates.CERTIFICATE, certificates.MEMBERS
    authority, own, members = (read(folder / name) for name in names)
    key = read(folder / certificates.KEY, secret=True)
    where = f"{folder / certificates.MEMBERS}"
    try:
        signed = from_json(members, SignedMembers, where)
    except ConfigError:
        raise KeysError(
            f"{where}: not a list of members: damaged, or another file"
        ) from None
    found = certificates.verify(
        certificates.Bundle(
            authority=authority, certificate=own, key=key, members=signed
        ),
        f"{folder}/",
    )
    holder, certificate = found.holder, found.certificate
    if holder is None or certificate is None or found.key is None:
        raise KeysError(
            f"{folder}: {certificates.CERTIFICATE} or {certificates.KEY} is empty"
        )
    if role is not None and holder.role != role:
        needed = f"{PROGRAMS[role]} needs those of a {IN_WORDS[role]}"
        raise KeysError(f"{folder}: these are the keys of {holder}; {needed}")
    end = certificate.not_valid_after_utc
    return Keyring(folder, *holder, found.authority, end, found.members)


def read(path: Path, *, secret: bool = False) -> str:
    """Return the text of a file of keys; bytes that are not text become surrogates.

    Args:
        secret: refuse a file that others than its owner may read.
    """
    try:
        # A pipe would wait for its other end.
        opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        with os.fdopen(opened, "rb") as file:
            found = os.fstat(opened)
            if not stat.S_ISREG(found.st_mode):
                raise KeysError(f"{path}: not a file")
            if secret and found.st_mode & 0o077:
                mode = f"{stat.S_IMODE(found.st_mode):o}"
                raise KeysError(
                    f"{path}: others than its owner may read this key (mode {mode}): chmod 600 it; "
                    "if others use this machine, have it revoked and a new one issued"
                )
            content = file.read(MAX_FILE + 1)
    except FileNotFoundError:
        raise KeysError(f"{path}: missing") from None
    except PermissionError:
        why = "keys are their owner's alone, and this program runs as another user"
        raise KeysError(f"{path}: cannot be read: {why}") from None
    except OSError as error:
        raise KeysError(f"{path}: cannot be read: {error.strerror}") from None
    if len(content) > MAX_FILE:
        raise KeysError(f"{path}: larger than any file of keys")
    return content.decode(errors="surrogateescape")


def _installed(folder: Path) -> bool | None:
    """Return whether keys are installed there; None if this user may not know."""
    try:
        readable = os.access(folder / "key.pem", os.R_OK) or None
        return (folder / "certificate.pem").exists() and readable
    except OSError:
        return None
