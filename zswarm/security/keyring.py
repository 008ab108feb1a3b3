"""The keys that a program uses: where they are installed, and whether they may be used.

``find`` needs nothing; ``load`` needs the package cryptography (the extra ``keys``).
"""

import os
import stat
from datetime import datetime
from pathlib import Path

import msgspec

from zswarm import extras
from zswarm.errors import ConfigError, KeysError
from zswarm.security.members import IN_WORDS, Holder, Members, SignedMembers
from zswarm.strict import from_json

SYSTEM = Path("/etc/zswarm/keys")
MAX_FILE = 1 << 20  # bytes; a list of 10,000 members takes half of it
PROGRAMS = {"ss": "zswarm-ss", "ot": "zswarm-ot", "router": "zswarm-router"}


class Keyring(msgspec.Struct, frozen=True):
    """Keys that are whole, valid now, and among the members."""

    folder: Path
    role: str  # "ss" | "ot" | "router"
    name: str
    authority: str  # fingerprint, PRNY-624N-C2HJ-ADZT-...
    not_before: datetime  # UTC
    not_after: datetime
    members: Members


def find(given: str = "") -> Path | None:
    """The folder of the installed keys; None where none are installed.

    The given one, else that of ``ZSWARM_KEYS`` ("none": go without); else the first that holds keys which this user may read, of
    /etc/zswarm/keys and the user's own. Keys of the system that this user may not read are better than none: they are
    refused, and nothing goes on in the clear.
    """
    if chosen := given or os.environ.get("ZSWARM_KEYS", ""):
        return Path(chosen) if chosen != "none" else None
    places = {folder: _installed(folder) for folder in (SYSTEM, of_user())}
    for wanted in (True, None):
        for folder, installed in places.items():
            if installed is wanted:
                return folder
    return None


def installed(role: str) -> Keyring | None:
    """The installed keys, for a program of a role; None where none are installed.

    Raises:
        KeysError: they cannot be used.
    """
    folder = find()
    return load(folder, role) if folder is not None else None


def of_user() -> Path:
    """Where a user's own keys are installed."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config"), "zswarm", "keys")


def load(folder: Path, role: str = "") -> Keyring:
    """The keys of a folder.

    Args:
        folder: from ``find``.
        role: that the program needs: "ss", "ot" or "router"; "": any.

    Raises:
        KeysError: they cannot be used; one line says why, and what to do.
    """
    try:
        from zswarm.security import certificates
    except ModuleNotFoundError as error:
        raise KeysError(f"{folder}: keys need the package {error.name}: {extras.how('keys')}") from None

    where = f"{folder}/"
    if _installed(folder) is False:
        raise KeysError(f"{folder}: no keys are installed here; zswarm-keys join BUNDLE installs some")
    authority_pem, certificate_pem, key_pem, members_json = (
        read(folder / name, secret=name == certificates.KEY)
        for name in (certificates.AUTHORITY, certificates.CERTIFICATE, certificates.KEY, certificates.MEMBERS)
    )
    authority = certificates.read_certificate(authority_pem, where + certificates.AUTHORITY)
    certificate = certificates.read_certificate(certificate_pem, where + certificates.CERTIFICATE)
    key = certificates.read_key(key_pem, where + certificates.KEY)
    certificates.check_authority(authority, where + certificates.AUTHORITY)
    identity = certificates.check(certificate, authority, where + certificates.CERTIFICATE)
    if not certificates.fits(key, certificate):
        raise KeysError(f"{where}{certificates.KEY}: not the key of {certificates.CERTIFICATE} beside it")
    holder = identity.holder
    if role and holder.role != role:
        raise KeysError(f"{folder}: these are the keys of {holder}; {PROGRAMS[role]} needs those of a {IN_WORDS[role]}")
    try:
        signed = from_json(members_json, SignedMembers, where + certificates.MEMBERS)
    except ConfigError:
        raise KeysError(f"{where}{certificates.MEMBERS}: no list of members: damaged, or another file") from None
    members = certificates.check_members(signed, authority, where + certificates.MEMBERS)
    check_member(holder, members, where + certificates.MEMBERS)
    return Keyring(
        folder, holder.role, holder.name, identity.authority, identity.not_before, identity.not_after, members
    )  # fmt: skip


def check_member(holder: Holder, members: Members, where: str) -> None:
    """Refuse who is not let in.

    Raises:
        KeysError: that.
    """
    if holder.name not in members.of(holder.role):
        raise KeysError(f"{where}: {holder} is not, or no more, among the members (list {members.number}): it was revoked")


def read(path: Path, *, secret: bool = False) -> bytes:
    """A file of keys.

    Args:
        secret: refuse it where others than its owner may read it.

    Raises:
        KeysError: it is missing, cannot be read, is no file, too large, or no secret.
    """
    try:
        opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe would wait for its other end
        with os.fdopen(opened, "rb") as file:
            found = os.fstat(opened)
            if not stat.S_ISREG(found.st_mode):
                raise KeysError(f"{path}: not a file")
            if secret and found.st_mode & 0o077:
                raise KeysError(
                    f"{path}: others than its owner may read this key (mode {stat.S_IMODE(found.st_mode):o}): chmod 600 it;"
                    " if others use this machine, have it revoked and a new one issued"
                )
            content = file.read(MAX_FILE + 1)
    except FileNotFoundError:
        raise KeysError(f"{path}: missing") from None
    except PermissionError:
        raise KeysError(f"{path}: cannot be read: keys are their owner's alone, and this program runs as another user") from None
    except OSError as error:
        raise KeysError(f"{path}: cannot be read: {error.strerror}") from None
    if len(content) > MAX_FILE:
        raise KeysError(f"{path}: larger than any file of keys")
    return content


def _installed(folder: Path) -> bool | None:
    """Whether keys are installed there; None: this user may not know."""
    try:
        return (folder / "certificate.pem").exists() and (os.access(folder / "key.pem", os.R_OK) or None)
    except OSError:
        return None
