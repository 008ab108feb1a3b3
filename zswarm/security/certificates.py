"""Certificates, keys and signatures: build, read and check them. EC P-256 and nothing else.

``where`` is the name of a file in an error, such as that of a certificate in a bundle.
"""

import base64
import contextlib
import hashlib
import ipaddress
import warnings
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Literal, NamedTuple, TypeGuard, cast

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PrivateFormat,
    PublicFormat,
)
from cryptography.x509.oid import ExtendedKeyUsageOID

from zswarm.errors import KeysError
from zswarm.security.members import Holder, Members, SignedMembers
from zswarm.system.text import clean

AUTHORITY = "authority.pem"
CERTIFICATE = "certificate.pem"
KEY = "key.pem"
MEMBERS = "members.json"
UNREADABLE = (  # what the library raises at bytes that it cannot read
    ValueError,
    TypeError,
    UnsupportedAlgorithm,
    x509.DuplicateExtension,
    x509.InvalidVersion,
    x509.UnsupportedGeneralNameType,
    Warning,
)
CURVE, HASH = ec.SECP256R1, hashes.SHA256
MEMBERS_MARK = b"zswarm members\n"  # nothing else that an authority signs begins with it
NOT_OURS = "is not EC P-256: zswarm-keys did not make it"


class Bundle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of a holder and the list of members, as in a ``.zkeys`` file."""

    format: Literal["zswarm-keys-1"] = "zswarm-keys-1"
    authority: str  # PEM
    certificate: str = ""  # PEM; "": a list of members only
    key: str = ""  # PEM; "": it is on its machine already
    members: SignedMembers


class Verified(NamedTuple):
    """A bundle whose parts belong together and are valid now."""

    bundle: Bundle
    authority: str  # fingerprint
    holder: Holder | None  # None: a list of members only
    certificate: x509.Certificate | None
    key: ec.EllipticCurvePrivateKey | None

    @property
    def members(self) -> Members:
        """The list of members."""
        return self.bundle.members.members


# ---- build --------------------------------------------------------------------------------


def subject(common_name: str) -> x509.Name:
    """Return the subject of a certificate."""
    return x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, common_name)])


def build(
    common_name: str,
    public: ec.EllipticCurvePublicKey,
    issuer: x509.Name,
    issuer_key: ec.EllipticCurvePrivateKey,
    valid: tuple[datetime, datetime],
    names: Sequence[str] | None,
) -> x509.Certificate:
    """Return a signed certificate.

    Args:
        valid: from, until.
        names: and addresses of its holder; None: it is an authority's.
    """
    is_authority = names is None
    usage = x509.KeyUsage(
        digital_signature=True,
        key_cert_sign=is_authority,
        crl_sign=is_authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
    constraints = x509.BasicConstraints(
        is_authority, path_length=0 if is_authority else None
    )
    issuer_id = x509.AuthorityKeyIdentifier.from_issuer_public_key(
        issuer_key.public_key()
    )
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject(common_name))
        .issuer_name(issuer)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(valid[0])
        .not_valid_after(valid[1])
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .add_extension(issuer_id, critical=False)
        .add_extension(constraints, critical=True)
        .add_extension(usage, critical=True)
    )
    if names is not None:
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        builder = builder.add_extension(alternatives(names), critical=False)
    return builder.sign(issuer_key, HASH())


def alternatives(names: Sequence[str]) -> x509.SubjectAlternativeName:
    """Return names and addresses as they are in a certificate."""
    found: list[x509.GeneralName] = []
    for name in names:
        try:
            found.append(x509.IPAddress(ipaddress.ip_address(name)))
        except ValueError:
            found.append(x509.DNSName(name))
    return x509.SubjectAlternativeName(found)


def fingerprint(certificate: x509.Certificate) -> str:
    """Return 160 bits for people to compare, such as PRNY-624N-C2HJ-ADZT-..."""
    digest = hashlib.sha256(certificate.public_bytes(Encoding.DER)).digest()
    text = base64.b32encode(digest[:20]).decode()
    return "-".join(text[at : at + 4] for at in range(0, len(text), 4))


# ---- keys ---------------------------------------------------------------------------------


def new_key() -> ec.EllipticCurvePrivateKey:
    """Return a new private key."""
    return ec.generate_private_key(CURVE())


def key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return a private key as PEM."""
    return key.private_bytes(
        Encoding.PEM, PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def public_pem(key: ec.EllipticCurvePublicKey) -> str:
    """Return a public key as PEM; equal for equal keys."""
    return key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()


def read_key(pem: str, where: str) -> ec.EllipticCurvePrivateKey:
    """Return a private key."""
    try:
        key = serialization.load_pem_private_key(pem.encode(), password=None)
    except UNREADABLE:
        raise KeysError(
            f"{where}: no private key in PEM: damaged, or another file"
        ) from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not is_ours(key.public_key()):
        raise KeysError(f"{where}: the key {NOT_OURS}")
    return key


def read_public(pem: str, where: str) -> ec.EllipticCurvePublicKey:
    """Return a public key."""
    try:
        key = serialization.load_pem_public_key(pem.encode())
    except UNREADABLE:
        raise KeysError(f"{where}: no public key in PEM: damaged") from None
    if not is_ours(key):
        raise KeysError(f"{where}: the key {NOT_OURS}")
    return key


def is_ours(key: object) -> TypeGuard[ec.EllipticCurvePublicKey]:
    """Return whether a public key is EC P-256."""
    return isinstance(key, ec.EllipticCurvePublicKey) and isinstance(key.curve, CURVE)


def check_fits(
    key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate | None, where: str
) -> None:
    """Refuse a key that is not the certificate's."""
    if certificate is None or key.public_key() != certificate.public_key():
        raise KeysError(f"{where}: not the key of the certificate next to it")


# ---- certificates -------------------------------------------------------------------------


@contextlib.contextmanager
def strict() -> Iterator[None]:
    """Raise what the library only warns of, such as a negative serial number."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def read_certificate(pem: str, where: str) -> x509.Certificate:
    """Return a certificate whose key ``is_ours``."""
    try:
        with strict():
            certificate = x509.load_pem_x509_certificate(pem.encode())
            # These are decoded when they are first used.
            _ = certificate.subject, certificate.extensions
            _ = certificate.signature_hash_algorithm, certificate.not_valid_after_utc
            ours = is_ours(certificate.public_key())
    except UNREADABLE:
        raise KeysError(
            f"{where}: no certificate in PEM: damaged, or another file"
        ) from None
    if not ours:
        raise KeysError(f"{where}: the certificate's key {NOT_OURS}")
    return certificate


def common_name(name: x509.Name) -> str:
    """Return the common name of a subject; "" if it has none or several."""
    names = name.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
    return str(names[0].value) if len(names) == 1 else ""


def check_authority(authority: x509.Certificate, where: str) -> None:
    """Refuse a certificate that is not an authority's, or not valid now."""
    try:
        constraints = authority.extensions.get_extension_for_class(
            x509.BasicConstraints
        ).value
        authority.verify_directly_issued_by(authority)
        valid = constraints.ca
    except (x509.ExtensionNotFound, InvalidSignature, *UNREADABLE):
        valid = False
    if not valid:
        raise KeysError(f"{where}: not the certificate of an authority")
    remedy = "zswarm-keys init makes a new one, which issues all keys again"
    _check_time(authority, where, "the authority", remedy)


def check(
    certificate: x509.Certificate, authority: x509.Certificate, where: str
) -> Holder:
    """Return the holder of a certificate."""
    try:
        certificate.verify_directly_issued_by(authority)
    except (InvalidSignature, *UNREADABLE):
        other = (
            f"another authority than {AUTHORITY} next to it ({fingerprint(authority)})"
        )
        raise KeysError(f"{where}: the certificate is of {other}") from None
    name = common_name(certificate.subject)
    holder = Holder.parse(name)
    if holder is None:
        text = f"its common name is {clean(name)[:80]!r}; expected ss.NAME, ot.NAME or router.NAME"
        raise KeysError(f"{where}: {text}")
    remedy = f"zswarm-keys renew {holder.name} on the authority's machine makes a new one"
    _check_time(certificate, where, str(holder), remedy)
    return holder


def verify(bundle: Bundle, where: str) -> Verified:
    """Check that keys belong together, are valid now, and that their holder is a member.

    Args:
        where: put before the name of a file: a folder and ``/``, or a bundle and ``: ``.
    """
    authority = read_certificate(bundle.authority, where + AUTHORITY)
    check_authority(authority, where + AUTHORITY)
    members = check_members(bundle.members, authority, where + MEMBERS)
    holder = certificate = key = None
    if bundle.certificate:
        certificate = read_certificate(bundle.certificate, where + CERTIFICATE)
        holder = check(certificate, authority, where + CERTIFICATE)
    if bundle.key:
        key = read_key(bundle.key, where + KEY)
        check_fits(key, certificate, where + KEY)
    if holder is not None:
        members.check(holder, where + MEMBERS)
    return Verified(bundle, fingerprint(authority), holder, certificate, key)


def _check_time(
    certificate: x509.Certificate, where: str, holder: str, remedy: str
) -> None:
    now, minute = datetime.now(UTC), "%Y-%m-%d %H:%M"
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if now < begin:
        raise KeysError(
            f"{where}: the certificate of {holder} is valid from {begin:{minute}} UTC on, and this "
            f"machine's clock is at {now:{minute}}: set the clock"
        )
    if now > end:
        raise KeysError(
            f"{where}: the certificate of {holder} expired on {end:{minute}} UTC; {remedy}"
        )


# ---- the list of members ------------------------------------------------------------------


def sign(members: Members, key: ec.EllipticCurvePrivateKey) -> SignedMembers:
    """Return a list that the authority with this key signed."""
    signature = key.sign(_canonical(members), ec.ECDSA(HASH()))
    return SignedMembers(members=members, signature=base64.b64encode(signature).decode())


def check_members(
    signed: SignedMembers, authority: x509.Certificate, where: str
) -> Members:
    """Return the list if this authority signed it."""
    own, other = fingerprint(authority), signed.members.authority
    if other != own:
        raise KeysError(
            f"{where}: the list of another authority ({clean(other)[:60]}); expected {own}"
        )
    # ``read_certificate`` checked its type.
    key = cast(ec.EllipticCurvePublicKey, authority.public_key())
    try:
        signature = base64.b64decode(signed.signature, validate=True)
        key.verify(signature, _canonical(signed.members), ec.ECDSA(HASH()))
    except (InvalidSignature, ValueError):
        raise KeysError(
            f"{where}: the authority did not sign this list, or it was changed since"
        ) from None
    return signed.members


def _canonical(members: Members) -> bytes:
    return MEMBERS_MARK + msgspec.json.encode(members)
