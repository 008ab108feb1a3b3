"""Keys on the machine that uses them: install a bundle, or make a key that waits to be signed."""

import contextlib
import os
import pwd
from pathlib import Path

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from zswarm.config.decode import from_json
from zswarm.errors import ConfigError, KeysError
from zswarm.security import certificates, keyring, requests
from zswarm.security.certificates import AUTHORITY, CERTIFICATE, KEY, MEMBERS, Verified
from zswarm.security.members import Holder, Members, Role, SignedMembers
from zswarm.system.files import make_private, write_whole

WAITING = "request.pem"  # a key whose certificate was requested
FILES = (AUTHORITY, CERTIFICATE, KEY, MEMBERS, WAITING)
SERVICE_USER = "zswarm"


def folder_for(role: Role, given: str) -> Path:
    """Return where this user installs keys of a role."""
    chosen = given or os.environ.get("ZSWARM_KEYS", "")
    if chosen not in ("", "none"):
        return Path(chosen)
    if role == "ot" and os.environ.get("SUDO_USER"):
        raise KeysError(
            "keys of a user belong to who runs zswarm-ot: do this without sudo"
        )
    return keyring.SYSTEM if role != "ot" and os.geteuid() == 0 else keyring.of_user()


def install(keys: Verified, folder: Path, *, force: bool) -> Members:
    """Install a bundle; return the list of members that is installed then.

    If it is interrupted, it can be repeated; until then the keys in the folder are refused.

    Args:
        keys: with a certificate.
        folder: made if it is missing.
        force: replace the keys of another authority or holder.
    """
    holder, certificate = keys.holder, keys.certificate
    if holder is None or certificate is None:
        raise ValueError("expected a bundle with a certificate")
    if not force:
        _refuse_others(folder, holder, keys.authority)
    key = keys.key or _own_key(folder, certificate)
    if key is None:
        raise KeysError(
            f"the certificate of {holder} is for a key that never left its machine, and {folder} "
            "does not hold it: join on the machine, as the user, where zswarm-keys request was run"
        )
    members, installed = keys.bundle.members, _members(folder, keys.authority)
    if installed is not None and installed.members.number > members.members.number:
        members = installed
    members.members.check(holder, f"{folder / MEMBERS}")
    owner = _make(folder, holder.role)
    write_whole(folder / KEY, certificates.key_pem(key), 0o600, owner)
    write_whole(folder / CERTIFICATE, keys.bundle.certificate.encode(), 0o644, owner)
    write_whole(folder / AUTHORITY, keys.bundle.authority.encode(), 0o644, owner)
    write_whole(folder / MEMBERS, msgspec.json.encode(members), 0o644, owner)
    if keys.key is None:
        (folder / WAITING).unlink(missing_ok=True)
    return members.members


def install_members(keys: Verified, folder: Path) -> int:
    """Install a newer list of members; return the number of the previous one, 0 if none."""
    own = certificates.fingerprint(_certificate(folder / AUTHORITY))
    if own != keys.authority:
        text = f"this is the list of another authority ({keys.authority})"
        raise KeysError(f"{text}; {folder} holds keys of {own}")
    installed = _members(folder, keys.authority)
    number = installed.members.number if installed else 0
    if keys.members.number < number:
        text = f"this is list {keys.members.number}, older than list {number}"
        raise KeysError(f"{text}, which is installed in {folder}")
    found = folder.stat()
    owner = (found.st_uid, found.st_gid) if os.geteuid() == 0 else None
    write_whole(folder / MEMBERS, msgspec.json.encode(keys.bundle.members), 0o644, owner)
    return number


def request(holder: Holder, addresses: list[str], folder: Path, *, force: bool) -> bytes:
    """Make a key, which waits in the folder for its certificate; return the request.

    Args:
        addresses: of the holder, besides its own names.
        folder: made if it is missing.
        force: replace a key that waits already.
    """
    if (folder / WAITING).exists() and not force:
        text = "a key waits here for its certificate already"
        raise KeysError(f"{folder}: {text}; --force forgets it and makes another")
    key = certificates.new_key()
    body = requests.make_request(holder, addresses, key)
    owner = _make(folder, holder.role)
    write_whole(folder / WAITING, certificates.key_pem(key), 0o600, owner)
    return body


def _make(folder: Path, role: Role) -> tuple[int, int] | None:
    """Make the folder, for its owner alone; return the owner."""
    owner = None
    if os.geteuid() == 0 and role != "ot":
        with contextlib.suppress(KeyError):  # the service does not run as this user here
            user = pwd.getpwnam(SERVICE_USER)
            owner = (user.pw_uid, user.pw_gid)
    make_private(folder, FILES, owner)
    return owner


def _certificate(path: Path) -> x509.Certificate:
    return certificates.read_certificate(keyring.read(path), f"{path}")


def _refuse_others(folder: Path, wanted: Holder, authority: str) -> None:
    if not (folder / CERTIFICATE).exists():
        return
    try:
        installed = certificates.common_name(_certificate(folder / CERTIFICATE).subject)
        own = certificates.fingerprint(_certificate(folder / AUTHORITY))
    except KeysError as error:
        raise KeysError(f"{error}; --force replaces it") from None
    if own != authority:
        text = f"keys of another authority ({own}, not {authority})"
        raise KeysError(f"{folder} holds {text}; --force replaces them")
    if installed != wanted.common_name:
        text = f"the keys of {installed}, and these are of {wanted.common_name}"
        raise KeysError(f"{folder} holds {text}; --force replaces them")


def _own_key(
    folder: Path, certificate: x509.Certificate
) -> ec.EllipticCurvePrivateKey | None:
    """Return the private key of a certificate, if it is in the folder, waiting or installed."""
    for path in (folder / WAITING, folder / KEY):
        if path.exists():
            key = certificates.read_key(keyring.read(path, secret=True), f"{path}")
            if key.public_key() == certificate.public_key():
                return key
    return None


def _members(folder: Path, authority: str) -> SignedMembers | None:
    """Return the installed list if the authority with this fingerprint signed it."""
    where = folder / MEMBERS
    try:
        certificate = _certificate(folder / AUTHORITY)
        signed = from_json(keyring.read(where), SignedMembers, f"{where}")
        certificates.check_members(signed, certificate, f"{where}")
    except ConfigError:  # missing or damaged: the new list replaces it
        return None
    return signed if signed.members.authority == authority else None
