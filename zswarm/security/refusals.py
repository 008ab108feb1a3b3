"""Logs which programs were refused, and why.

Refused TLS handshakes are only in zenoh's own log, on standard output, which a daemon does not use.
Holders of a valid certificate are refused by the list of members.
"""

import os
import re
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

from zswarm.protocol import endpoint
from zswarm.security import tls_diagnosis
from zswarm.security.keyring import Keyring
from zswarm.security.members import Holder
from zswarm.system import log
from zswarm.system.text import clean

# Access rules log their refusals at no other level.
ZENOH_LOG = (
    "off,zenoh_link_tls=warn,zenoh::net::routing::interceptor::access_control=trace"
)
# These come from port scans and health checks.
UNREMARKABLE = ("handshake eof", "Connection reset", "os error 104")
DIALLED_S = 5.0  # after which a router should have been reached
EVERY_S = 10.0  # the same reason is logged at most so often: a refused program retries each second
MARK = re.compile(r"zenoh_link_tls::unicast: (.*)")
DENIED = re.compile(
    r"CertCommonName\(ot\.(?P<user>[^)]*)\).* is unauthorized to "
    r"(?:Query|.*Liveliness Token) \(ingress\) on (?P<key>\S+?/ot/(?P<named>[^/\s]*)\S*)"
)
DISTRUST = "it does not trust this lab's authority: its keys are of another one"
REASONS = {
    "certificate expired": "its certificate has expired: zswarm-keys renew, and join there",
    "not valid yet": "its certificate is not valid yet: compare the clocks of both machines",
    "UnknownCA": DISTRUST,
    "UnknownIssuer": "its certificate is of another authority",
    "BadSignature": "its certificate is of another authority",
    "DecryptError": f"{DISTRUST} of the same name",
    "sent no certificates": "it shows no certificate: it has no keys of this lab",
    "corrupt message": "it does not speak TLS: it has no keys, and would continue in the clear",
    "Expired": "to it, this machine's certificate has expired: zswarm-keys renew, and join here",
    "BadCertificate": "it does not accept this machine's certificate",
}


def watch_links() -> None:
    """Log the handshakes that zenoh refuses from now on; standard output becomes zenoh's."""
    os.environ.setdefault("NO_COLOR", "1")
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)
    zenoh.init_log_from_env_or(ZENOH_LOG)
    threading.Thread(target=_read, args=(reading,), name="refusals", daemon=True).start()


def log_stranger(certificate: str, address: str, reason: str) -> None:
    """Log a program that is not a member, for a daemon."""
    log.warning("member_unknown", certificate=certificate, address=address, reason=reason)


def watch_members(
    session: zenoh.Session,
    keyring: Keyring,
    report: Callable[[str, str, str], None] = log_stranger,
) -> None:
    """Report holders of certificates that are not members, each at most every 10 s.

    Args:
        session: whose links are watched.
        keyring: with the list of members.
        report: called with common name, address and reason, in zenoh's threads.
    """
    is_due = _limited()

    def on_link(event: Any) -> None:
        name = event.link.auth_identifier or ""
        new = event.kind == zenoh.SampleKind.PUT
        if new and (reason := why_refused(name, keyring)) and is_due(name):
            report(clean(name), event.link.dst, reason)

    callback = zenoh.handlers.Callback(on_link, indirect=False)
    session.info.declare_link_events_listener(callback, history=True)


def why_refused(common_name: str, keyring: Keyring) -> str:
    """Return why the holder of a certificate is refused; "" if it is not."""
    holder = Holder.parse(common_name)
    if holder is None or holder.name not in keyring.members.of(holder.role):
        remedy = "it can ask nothing"
        if keyring.role == "ot":
            remedy = "bring the newest list here (zswarm-keys join members.zkeys)"
        return f"not, or no longer, among the members (list {keyring.members.number}): {remedy}"
    if holder.role == keyring.role == "ss":
        return "a server does not dial servers: it can ask nothing"
    return ""


def watch_routers(connect: Sequence[str], keyring: Keyring | None) -> None:
    """Log, some seconds later, why a router to dial and this program refuse each other."""

    def look() -> None:
        for text in connect:
            at = endpoint.parse(text)
            reason = tls_diagnosis.refusal(at, keyring)
            if not reason and keyring is None and tls_diagnosis.speaks_tls(at):
                reason = "it lets in members only: zswarm-keys join BUNDLE"
            if reason:
                log.warning("router_refused", endpoint=text, reason=reason)

    if connect:
        timer = threading.Timer(DIALLED_S, look)
        timer.daemon = True
        timer.start()


def _limited() -> Callable[[str], bool]:
    """Return a function that is true for the same text at most once in 10 s."""
    due: dict[str, float] = {}

    def is_due(text: str) -> bool:
        now = time.monotonic()
        if now < due.get(text, now):
            return False
        due[text] = now + EVERY_S
        return True

    return is_due


def handshake_reason(line: str) -> str:
    """Return why a handshake failed by a line of zenoh's log; "" if it is about something else."""
    found = MARK.search(line)
    if found is None:
        return ""
    text = found[1].partition(" Hint:")[0]
    if any(mark in text for mark in UNREMARKABLE):
        return ""
    return next((words for mark, words in REASONS.items() if mark in text), clean(text))


def posed_as(line: str) -> tuple[str, str] | None:
    """Return the certificate and key of a user that used the name of another, or a wildcard."""
    denied = DENIED.search(line)
    if denied is None or denied["named"] == denied["user"]:
        return None
    return clean(f"ot.{denied['user']}"), clean(denied["key"])


def _read(reading: int) -> None:
    is_due = _limited()
    with os.fdopen(reading, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            if "RUST_LOG" in os.environ:  # the user asks for all of it
                sys.stderr.write(line)
            if (denied := posed_as(line)) and is_due(denied[0]):
                reason = "the key is not of its own name"
                log.warning(
                    "member_refused", certificate=denied[0], key=denied[1], reason=reason
                )
            elif (reason := handshake_reason(line)) and is_due(reason):
                log.warning("link_refused", reason=reason)
