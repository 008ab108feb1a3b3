"""Why a program at an endpoint and this one do not let each other in: zenoh itself only says that it cannot connect."""

import contextlib
import socket
import ssl
from typing import Any

from zswarm.endpoint import Endpoint
from zswarm.security.keyring import Keyring
from zswarm.security.members import holder

DIAL_S = 2.0
ALERT_S = 0.3  # a side that refuses a certificate says so after the handshake
ERROR_EXPIRED, ERROR_NOT_YET = 10, 9  # X509_V_ERR_...
# What the other side says of our certificate.
ALERTS = {
    "UNKNOWN_CA": "the program there does not trust the authority of these keys: they are of another lab, or it has others",
    "CERTIFICATE_EXPIRED": "the program there says that the keys here have expired: compare the clocks of both machines",
    "BAD_CERTIFICATE": "the program there does not accept the certificate here: of another authority, or not valid by its clock",
    "CERTIFICATE_REQUIRED": "the program there wants keys",
}


def refusal(at: Endpoint, keyring: Keyring | None) -> str:
    """Why keys keep the two apart; "" when they do not, or when no keys are used here."""
    if keyring is None or at.protocol != "tls":
        return ""
    from zswarm.security.certificates import AUTHORITY, CERTIFICATE, KEY

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.load_verify_locations(keyring.folder / AUTHORITY)
    context.load_cert_chain(keyring.folder / CERTIFICATE, keyring.folder / KEY)
    try:
        with socket.create_connection((at.host, at.port), DIAL_S) as plain, context.wrap_socket(plain) as link:
            certificate = link.getpeercert() or {}
            link.settimeout(ALERT_S)
            with contextlib.suppress(TimeoutError):  # it waits for what comes next: it accepted
                link.recv(1)
    except ssl.SSLCertVerificationError as error:
        return _distrusted(error)
    except ssl.SSLError as error:
        said = (error.reason or "").upper()
        return next((words for mark, words in ALERTS.items() if mark in said), _NO_TLS)
    except (TimeoutError, ConnectionError):
        return _NO_TLS
    except OSError:
        return ""  # it cannot be dialled at all, which is told elsewhere
    subject: Any = certificate.get("subject", ())
    names = [value for part in subject for key, value in part if key == "commonName"]
    return _stranger(names[0] if names else "", keyring)


_NO_TLS = "the program there goes without keys: it does not speak TLS; ZSWARM_KEYS=none goes without them, too"


def speaks_tls(at: Endpoint) -> bool:
    """Whether a program that was dialled in the clear wants TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with socket.create_connection((at.host, at.port), DIAL_S) as plain, context.wrap_socket(plain):
            return True
    except ssl.SSLError as error:
        return "ALERT" in (error.reason or "").upper()
    except OSError:
        return False


def _distrusted(error: ssl.SSLCertVerificationError) -> str:
    match error.verify_code:
        case code if code == ERROR_EXPIRED:
            return "the certificate of the program there has expired: zswarm-keys renew, and join there"
        case code if code == ERROR_NOT_YET:
            return "the certificate of the program there is not valid yet: compare the clocks of both machines"
    return "the program there has keys of another authority than those here"


def _stranger(common_name: str, keyring: Keyring) -> str:
    who = holder(common_name)
    if who is None or who.role == "ot":
        return f"the keys of the program there are not those of a server or router, but of {str(who or common_name)[:100]!r}"
    if who.name not in keyring.members.of(who.role):
        return (
            f"{who} is not, or no more, among the members in {keyring.folder} (list {keyring.members.number}):"
            " bring the newest list here (zswarm-keys join members.zkeys)"
        )
    return ""
