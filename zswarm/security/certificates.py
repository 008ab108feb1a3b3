"""Certificates, keys and signatures: read, checked, put into words. EC P-256 and nothing else.

``where`` is put before the name of a file in an error: a folder with its ``/``, or a bundle with ``: ``.
"""

import base64
import contextlib
import hashlib
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import NamedTuple

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from zswarm.errors import KeysError
from zswarm.protocol.codec import clean
from zswarm.security.members import Holder, Members, SignedMembers, holder

AUTHORITY, CERTIFICATE, KEY, MEMBERS = "authority.pem", "certificate.pem", "key.pem", "members.json"
UNREADABLE = (  # what the library raises at bytes that are none of its own
    ValueError,
    TypeError,
    UnsupportedAlgorithm,
    x509.DuplicateExtension,
    x509.InvalidVersion,
    x509.UnsupportedGeneralNameType,
    Warning,
)
CURVE, HASH = ec.SECP256R1, hashes.SHA256
MEMBERS_MARK = b"zswarm members\n"  # nothing else that an authority signs begins so


class Identity(NamedTuple):
    """What a certificate that was checked vouches for."""

    holder: Holder
    authority: str
    not_before: datetime
    not_after: datetime


def fingerprint(certificate: x509.Certificate) -> str:
    """Of an authority, for people to compare: PRNY-624N-C2HJ-ADZT-..., 160 bits."""
    digest = hashlib.sha256(certificate.public_bytes(serialization.Encoding.DER)).digest()
    text = base64.b32encode(digest[:20]).decode()
    return "-".join(text[at : at + 4] for at in range(0, len(text), 4))


def read_certificate(pem: bytes, where: str) -> x509.Certificate:
    """A certificate whose key is one of ours.

    Raises:
        KeysError: it is none.
    """
    try:
        with warned():
            certificate = x509.load_pem_x509_certificate(pem)
            _ = certificate.subject, certificate.extensions, certificate.signature_hash_algorithm, certificate.not_valid_after_utc
            ours = is_ours(certificate.public_key())
    except UNREADABLE:
        raise KeysError(f"{where}: no certificate in PEM: damaged, or another file") from None
    if not ours:
        raise KeysError(f"{where}: the certificate's key is not EC P-256: zswarm-keys did not make it")
    return certificate


def read_key(pem: bytes, where: str) -> ec.EllipticCurvePrivateKey:
    """A private key.

    Raises:
        KeysError: it is none.
    """
    try:
        key = serialization.load_pem_private_key(pem, password=None)
    except UNREADABLE:
        raise KeysError(f"{where}: no private key in PEM: damaged, or another file") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not is_ours(key.public_key()):
        raise KeysError(f"{where}: the key is not EC P-256: zswarm-keys did not make it")
    return key


@contextlib.contextmanager
def warned() -> Iterator[None]:
    """What the library only warns of, such as a serial number below 0, is raised as all it cannot read."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def new_key() -> ec.EllipticCurvePrivateKey:
    """A private key."""
    return ec.generate_private_key(CURVE())


def key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """As it stands in a file."""
    encoding, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    return key.private_bytes(encoding, form, serialization.NoEncryption())


def public_pem(key: ec.EllipticCurvePublicKey) -> str:
    """As it stands in a file; equal for equal keys."""
    return key.public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo).decode()


def read_public(pem: str, where: str) -> ec.EllipticCurvePublicKey:
    """A public key.

    Raises:
        KeysError: it is none.
    """
    try:
        key = serialization.load_pem_public_key(pem.encode())
    except UNREADABLE:
        raise KeysError(f"{where}: no public key in PEM: damaged") from None
    if not isinstance(key, ec.EllipticCurvePublicKey) or not is_ours(key):
        raise KeysError(f"{where}: the key is not EC P-256: zswarm-keys did not make it")
    return key


def is_ours(key: object) -> bool:
    """Whether a public key is EC P-256."""
    return isinstance(key, ec.EllipticCurvePublicKey) and isinstance(key.curve, CURVE)


def public_key(certificate: x509.Certificate | x509.CertificateSigningRequest) -> ec.EllipticCurvePublicKey:
    """Of what was read and found to be ours."""
    key = certificate.public_key()
    if not isinstance(key, ec.EllipticCurvePublicKey):
        raise TypeError("expected a certificate with an EC key")
    return key


def fits(key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> bool:
    """Whether a certificate is of this key."""
    return key.public_key() == certificate.public_key()


def common_name(subject: x509.Name) -> str:
    """The one of a subject; "" where there is none or more."""
    names = subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
    return str(names[0].value) if len(names) == 1 else ""


def check_authority(authority: x509.Certificate, where: str) -> None:
    """Refuse what is no authority's certificate, or not now.

    Raises:
        KeysError: that.
    """
    try:
        constraints = authority.extensions.get_extension_for_class(x509.BasicConstraints).value
        authority.verify_directly_issued_by(authority)
    except (x509.ExtensionNotFound, InvalidSignature, *UNREADABLE):
        raise KeysError(f"{where}: no authority's certificate") from None
    if not constraints.ca:
        raise KeysError(f"{where}: no authority's certificate")
    _check_time(authority, where, "the authority", "zswarm-keys init makes a new one, which issues everyone's keys again")


def check(certificate: x509.Certificate, authority: x509.Certificate, where: str) -> Identity:
    """Refuse a certificate of another authority, of a role that is none of ours, or that is not valid now.

    Raises:
        KeysError: that.
    """
    try:
        certificate.verify_directly_issued_by(authority)
    except (InvalidSignature, *UNREADABLE):
        raise KeysError(
            f"{where}: the certificate is of another authority than {AUTHORITY} beside it ({fingerprint(authority)})"
        ) from None
    name = common_name(certificate.subject)
    whose = holder(name)
    if whose is None:
        raise KeysError(f"{where}: its common name is {clean(name)[:80]!r}; expected ss.NAME, ot.NAME or router.NAME")
    _check_time(certificate, where, str(whose), f"zswarm-keys renew {whose.name} on the authority's machine makes a new one")
    return Identity(whose, fingerprint(authority), certificate.not_valid_before_utc, certificate.not_valid_after_utc)


def sign(members: Members, key: ec.EllipticCurvePrivateKey) -> SignedMembers:
    """Signed by the authority whose key this is."""
    signature = key.sign(_canonical(members), ec.ECDSA(HASH()))
    return SignedMembers(members=members, signature=base64.b64encode(signature).decode())


def check_members(signed: SignedMembers, authority: x509.Certificate, where: str) -> Members:
    """The list, if this authority signed it.

    Raises:
        KeysError: another did, or nobody, or it was changed.
    """
    if signed.members.authority != fingerprint(authority):
        raise KeysError(
            f"{where}: the list of another authority ({clean(signed.members.authority)[:60]}); expected {fingerprint(authority)}"
        )
    try:
        public_key(authority).verify(
            base64.b64decode(signed.signature, validate=True), _canonical(signed.members), ec.ECDSA(HASH())
        )
    except (InvalidSignature, ValueError):
        raise KeysError(f"{where}: the authority did not sign this list, or it was changed since") from None
    return signed.members


def _canonical(members: Members) -> bytes:
    return MEMBERS_MARK + msgspec.json.encode(members)


def _check_time(certificate: x509.Certificate, where: str, whose: str, remedy: str) -> None:
    now = datetime.now(UTC)
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if now < begin:
        raise KeysError(
            f"{where}: the certificate of {whose} is valid from {begin:%Y-%m-%d %H:%M} UTC on, and this machine's clock says"
            f" {now:%Y-%m-%d %H:%M}: set the clock"
        )
    if now > end:
        raise KeysError(f"{where}: the certificate of {whose} expired on {end:%Y-%m-%d %H:%M} UTC; {remedy}")
