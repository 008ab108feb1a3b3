"""Keys on the machine that uses them: a bundle is installed; a key waits there for its certificate."""

import os
import pwd
from pathlib import Path

import msgspec
from cryptography.hazmat.primitives.asymmetric import ec

from zswarm.errors import ConfigError, KeysError
from zswarm.files import make_private, write_whole
from zswarm.security import authority, certificates, keyring
from zswarm.security.bundle import Checked
from zswarm.security.members import Holder, Members, Role, SignedMembers
from zswarm.strict import from_json

WAITING = "request.pem"  # a key whose certificate was asked for
FILES = (certificates.AUTHORITY, certificates.CERTIFICATE, certificates.KEY, certificates.MEMBERS, WAITING)
SERVICE_USER = "zswarm"


def folder_for(role: Role, given: str) -> Path:
    """Where keys of a role are installed by this user.

    Raises:
        KeysError: a person's keys would become root's.
    """
    chosen = given or os.environ.get("ZSWARM_KEYS", "")
    if chosen not in ("", "none"):
        return Path(chosen)
    if role == "ot" and os.environ.get("SUDO_USER"):
        raise KeysError("keys of a user belong to who runs zswarm-ot: do this without sudo")
    return keyring.SYSTEM if role != "ot" and os.geteuid() == 0 else keyring.of_user()


def install(checked: Checked, folder: Path, *, force: bool) -> Members:
    """The holder's certificate and key, the authority and the members; the list that is installed now.

    Stopped in the middle it can be done again; until then what is there is refused.

    Args:
        checked: with an identity.
        folder: made where it is missing.
        force: replace the keys of another authority or holder.

    Raises:
        ConfigError: others are installed, there is no key for the certificate, or its holder was revoked since.
        OSError: the folder cannot be written.
    """
    identity, certificate = checked.identity, checked.certificate
    if identity is None or certificate is None:
        raise ValueError("expected a bundle with a certificate")
    if not force:
        _refuse_others(folder, identity.holder, checked.authority)
    key = checked.key or _own_key(folder, certificates.public_key(certificate))
    if key is None:
        raise KeysError(
            f"the certificate of {identity.holder} is for a key that never left its machine, and {folder} does not hold it:"
            " join on the machine, as the user, where zswarm-keys request was run"
        )
    before = _members(folder, checked.authority)
    members = before if before and before.members.number > checked.members.number else checked.bundle.members
    keyring.check_member(identity.holder, members.members, f"{folder}/{certificates.MEMBERS}")
    owner = _make(folder, identity.holder.role)
    write_whole(folder / certificates.KEY, certificates.key_pem(key), 0o600, owner)
    write_whole(folder / certificates.CERTIFICATE, checked.bundle.certificate.encode(), 0o644, owner)
    write_whole(folder / certificates.AUTHORITY, checked.bundle.authority.encode(), 0o644, owner)
    write_whole(folder / certificates.MEMBERS, msgspec.json.encode(members), 0o644, owner)
    if checked.key is None:
        (folder / WAITING).unlink(missing_ok=True)
    return members.members


def install_members(checked: Checked, folder: Path) -> int:
    """A newer list of members; the number of the one before, 0 where there was none.

    Raises:
        KeysError: of another authority than the keys there, or older.
        OSError: the folder cannot be written.
    """
    installed = certificates.read_certificate(keyring.read(folder / certificates.AUTHORITY), f"{folder}/{certificates.AUTHORITY}")
    if certificates.fingerprint(installed) != checked.authority:
        raise KeysError(
            f"this is the list of another authority ({checked.authority}); {folder} holds keys of"
            f" {certificates.fingerprint(installed)}"
        )
    before = _members(folder, checked.authority)
    number = before.members.number if before else 0
    if checked.members.number < number:
        raise KeysError(f"this is list {checked.members.number}, older than list {number}, which is installed in {folder}")
    found = folder.stat()
    owner = (found.st_uid, found.st_gid) if os.geteuid() == 0 else None
    write_whole(folder / certificates.MEMBERS, msgspec.json.encode(checked.bundle.members), 0o644, owner)
    return number


def request(whose: Holder, addresses: list[str], folder: Path, *, force: bool) -> bytes:
    """A new key, which waits in the folder for its certificate; what the authority is to sign.

    Args:
        whose: will hold it.
        addresses: beside its own names.
        folder: made where it is missing.
        force: forget a key that waits already.

    Raises:
        ConfigError: one waits, or an address is none.
        OSError: the folder cannot be written.
    """
    if (folder / WAITING).exists() and not force:
        raise KeysError(f"{folder}: a key waits here for its certificate already; --force forgets it and makes another")
    key = certificates.new_key()
    asked = authority.make_request(whose, addresses, key)
    owner = _make(folder, whose.role)
    write_whole(folder / WAITING, certificates.key_pem(key), 0o600, owner)
    return asked


def _make(folder: Path, role: Role) -> tuple[int, int] | None:
    """The folder, for its owner alone; who that is."""
    owner = None
    if os.geteuid() == 0 and role != "ot":
        try:
            user = pwd.getpwnam(SERVICE_USER)
            owner = (user.pw_uid, user.pw_gid)
        except KeyError:
            pass  # the service does not run on this machine, or not as this user
    make_private(folder, FILES, owner)
    return owner


def _refuse_others(folder: Path, wanted: Holder, authority_of: str) -> None:
    if not (folder / certificates.CERTIFICATE).exists():
        return
    where = f"{folder}/"
    try:
        name, installed = certificates.CERTIFICATE, certificates.AUTHORITY
        certificate = certificates.read_certificate(keyring.read(folder / name), where + name)
        fingerprint = certificates.fingerprint(certificates.read_certificate(keyring.read(folder / installed), where + installed))
    except KeysError as error:
        raise KeysError(f"{error}; --force replaces it") from None
    found = certificates.common_name(certificate.subject)
    if fingerprint != authority_of:
        raise KeysError(f"{folder} holds keys of another authority ({fingerprint}, not {authority_of}); --force replaces them")
    if found != wanted.common_name:
        raise KeysError(f"{folder} holds the keys of {found}, and these are of {wanted.common_name}; --force replaces them")


def _own_key(folder: Path, public: ec.EllipticCurvePublicKey) -> ec.EllipticCurvePrivateKey | None:
    """The key in the folder, waiting or installed, that a public key is of."""
    for name in (WAITING, certificates.KEY):
        if (folder / name).exists():
            key = certificates.read_key(keyring.read(folder / name, secret=True), str(folder / name))
            if key.public_key() == public:
                return key
    return None


def _members(folder: Path, fingerprint: str) -> SignedMembers | None:
    """The installed list, if it is one of this authority."""
    try:
        where = f"{folder}/"
        installed = certificates.read_certificate(keyring.read(folder / certificates.AUTHORITY), where)
        if certificates.fingerprint(installed) != fingerprint:
            return None
        signed = from_json(keyring.read(folder / certificates.MEMBERS), SignedMembers, where)
        certificates.check_members(signed, installed, where)
    except ConfigError:
        return None  # damaged or none: the new one takes its place
    return signed
