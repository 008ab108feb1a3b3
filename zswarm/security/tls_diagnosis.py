"""Why a program at an endpoint and this one refuse each other.

Zenoh itself only reports that it cannot connect.
"""

import contextlib
import socket
import ssl
from typing import Any

from zswarm.protocol.endpoint import Endpoint
from zswarm.security.keyring import Keyring
from zswarm.security.members import Holder

DIAL_S = 2.0
ALERT_S = 0.3  # a program that refuses a certificate sends an alert after the handshake
THERE = "the program there"
# Alerts about our certificate.
ALERTS = {
    "UNKNOWN_CA": f"{THERE} does not trust the authority of these keys: one of them is of another "
    "lab",
    "CERTIFICATE_EXPIRED": f"{THERE} reports that the keys here have expired: compare the clocks "
    "of both machines",
    "BAD_CERTIFICATE": f"{THERE} does not accept the certificate here: it is of another authority, "
    "or not valid by its clock",
    "CERTIFICATE_REQUIRED": f"{THERE} requires keys",
}
# X509_V_ERR_CERT_HAS_EXPIRED, X509_V_ERR_CERT_NOT_YET_VALID
DISTRUSTED = {
    10: f"the certificate of {THERE} has expired: zswarm-keys renew, and join there",
    9: f"the certificate of {THERE} is not valid yet: compare the clocks of both machines",
}
NO_TLS = (
    f"{THERE} uses no keys: it does not speak TLS; ZSWARM_KEYS=none uses none here, too"
)


def refusal(at: Endpoint, keyring: Keyring | None) -> str:
    """Return why keys keep the two apart; "" if they do not, or no keys are used here."""
    if keyring is None or at.protocol != "tls":
        return ""
    # needs cryptography, an extra that comes with keys
    from zswarm.security.certificates import AUTHORITY, CERTIFICATE, KEY

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.load_verify_locations(keyring.folder / AUTHORITY)
    context.load_cert_chain(keyring.folder / CERTIFICATE, keyring.folder / KEY)
    try:
        with (
            socket.create_connection((at.host, at.port), DIAL_S) as plain,
            context.wrap_socket(plain) as link,
        ):
            certificate = link.getpeercert() or {}
            link.settimeout(ALERT_S)
            with contextlib.suppress(TimeoutError):  # it accepted, and waits
                link.recv(1)
    except ssl.SSLCertVerificationError as error:
        other = f"{THERE} has keys of another authority than those here"
        return DISTRUSTED.get(error.verify_code, other)
    except ssl.SSLError as error:
        alert = (error.reason or "").upper()
        return next((words for mark, words in ALERTS.items() if mark in alert), NO_TLS)
    except (TimeoutError, ConnectionError):
        return NO_TLS
    except OSError:
        return ""  # it cannot be dialled at all, which is reported elsewhere
    subject: Any = certificate.get("subject", ())
    names = [value for part in subject for key, value in part if key == "commonName"]
    return _not_a_member(names[0] if names else "", keyring)


def speaks_tls(at: Endpoint) -> bool:
    """Return whether a program that was dialled in the clear expects TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with socket.create_connection((at.host, at.port), DIAL_S) as plain:
            context.wrap_socket(plain).close()
            return True
    except ssl.SSLError as error:
        return "ALERT" in (error.reason or "").upper()
    except OSError:
        return False


def _not_a_member(common_name: str, keyring: Keyring) -> str:
    holder = Holder.parse(common_name)
    if holder is None or holder.role == "ot":
        shown = repr(str(holder or common_name)[:100])
        return f"the keys of {THERE} are not those of a server or router, but of {shown}"
    members = keyring.members
    if holder.name in members.of(holder.role):
        return ""
    text = f"{holder} is not, or no longer, among the members in {keyring.folder}"
    remedy = "bring the newest list here (zswarm-keys join members.zkeys)"
    return f"{text} (list {members.number}): {remedy}"
