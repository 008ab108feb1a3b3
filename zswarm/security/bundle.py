"""Files that bring keys to a machine: ``lab-01.zkeys``.

A bundle holds the authority's certificate, the list of members, the holder's certificate, and its key unless that never
left its machine. ``members.zkeys`` holds the first two only.
"""

from pathlib import Path
from typing import Literal

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from zswarm.errors import ConfigError, KeysError
from zswarm.files import write_whole
from zswarm.security import certificates, keyring
from zswarm.security.certificates import Identity
from zswarm.security.members import Members, SignedMembers
from zswarm.strict import from_json

SUFFIX = ".zkeys"
MEMBERS_FILE = f"members{SUFFIX}"


class Bundle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The file, in JSON."""

    format: Literal["zswarm-keys-1"] = "zswarm-keys-1"
    authority: str  # PEM
    certificate: str = ""  # PEM; "": a list of members only
    key: str = ""  # PEM; "": it is on its machine already
    members: SignedMembers


class Checked(msgspec.Struct, frozen=True, kw_only=True):
    """A bundle that may be installed."""

    bundle: Bundle
    authority: str  # fingerprint
    members: Members
    identity: Identity | None  # None: a list of members only
    certificate: x509.Certificate | None
    key: ec.EllipticCurvePrivateKey | None


def write(path: Path, bundle: Bundle) -> None:
    """A file that only its owner may read."""
    write_whole(path, msgspec.json.format(msgspec.json.encode(bundle)) + b"\n", 0o600 if bundle.key else 0o644)


def read(path: Path) -> Checked:
    """A bundle whose parts belong together, are valid now, and let its holder in.

    Raises:
        KeysError: anything else; one line says what.
    """
    body = keyring.read(path)
    try:
        bundle = from_json(body, Bundle, str(path))
    except ConfigError:  # it would quote what it found, which may be a key
        raise KeysError(f"{path}: no bundle of zswarm-keys, or not whole") from None
    where = f"{path}: "
    authority = certificates.read_certificate(bundle.authority.encode(), where + certificates.AUTHORITY)
    certificates.check_authority(authority, where + certificates.AUTHORITY)
    members = certificates.check_members(bundle.members, authority, where + certificates.MEMBERS)
    identity = certificate = key = None
    if bundle.certificate:
        certificate = certificates.read_certificate(bundle.certificate.encode(), where + certificates.CERTIFICATE)
        identity = certificates.check(certificate, authority, where + certificates.CERTIFICATE)
        keyring.check_member(identity.holder, members, where + certificates.MEMBERS)
    if bundle.key:
        key = certificates.read_key(bundle.key.encode(), where + certificates.KEY)
        if certificate is None or not certificates.fits(key, certificate):
            raise KeysError(f"{where}{certificates.KEY}: not the key of {certificates.CERTIFICATE} beside it")
    return Checked(
        bundle=bundle,
        authority=certificates.fingerprint(authority),
        members=members,
        identity=identity,
        certificate=certificate,
        key=key,
    )
