"""Requests for certificates: for which holder, under which names, and for which public key.

A key that never leaves its machine asks by a file, PKCS #10 in PEM: ``lab-01.zrequest``.
"""

import ipaddress
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from zswarm.errors import KeysError
from zswarm.security import certificates, keyring
from zswarm.security.members import Holder, new_holder

LOCAL = ("localhost", "127.0.0.1")  # in every certificate
LABEL = "[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?"
HOST_NAME = re.compile(rf"(?=.{{1,253}}\Z){LABEL}(\.{LABEL})*", re.I)


class Request(NamedTuple):
    """A request for a certificate."""

    holder: Holder
    names: list[str]
    public_key: ec.EllipticCurvePublicKey
    key: ec.EllipticCurvePrivateKey | None = None  # None: it is on its machine


def alternative_names(holder: Holder, addresses: Sequence[str]) -> list[str]:
    """Return the names and addresses by which a holder may be dialled."""
    own = () if holder.role == "ot" else (holder.name, f"{holder.name}.local")
    return list(
        dict.fromkeys([*own, *LOCAL, *(_address(holder, text) for text in addresses)])
    )


def make_request(
    holder: Holder, addresses: Sequence[str], key: ec.EllipticCurvePrivateKey
) -> bytes:
    """Return a request that ``read_request`` reads."""
    builder = x509.CertificateSigningRequestBuilder(
        certificates.subject(holder.common_name)
    )
    names = certificates.alternatives(alternative_names(holder, addresses))
    signed = builder.add_extension(names, critical=False).sign(key, certificates.HASH())
    return signed.public_bytes(serialization.Encoding.PEM)


def read_request(path: Path) -> Request:
    """Read a request; check names and addresses as for a new holder."""
    pem = keyring.read(path)
    try:
        with certificates.strict():
            request = x509.load_pem_x509_csr(pem.encode())
            found = Holder.parse(certificates.common_name(request.subject))
            public, is_signed = request.public_key(), request.is_signature_valid
            kind = x509.SubjectAlternativeName
            alternatives = request.extensions.get_extension_for_class(kind).value
    except (x509.ExtensionNotFound, *certificates.UNREADABLE):
        text = "not a request of zswarm-keys: damaged, or another file"
        raise KeysError(f"{path}: {text}") from None
    if found is None or not is_signed or not certificates.is_ours(public):
        raise KeysError(f"{path}: not a request that zswarm-keys request made")
    holder = new_holder(*found)
    own = alternative_names(holder, [])
    further = [text for name in alternatives if (text := str(name.value)) not in own]
    return Request(holder, alternative_names(holder, further), public)


def _address(holder: Holder, text: str) -> str:
    try:
        return str(ipaddress.ip_address(text))
    except ValueError:
        pass
    if not HOST_NAME.fullmatch(text) or text.rpartition(".")[2].isdigit():
        raise KeysError(
            f"address {text[:80]!r} of {holder}: expected an address such as 10.0.0.5, or a host's "
            "name without wildcards"
        )
    return text.lower()
