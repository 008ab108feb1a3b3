"""Who was refused, and why, in words for an administrator's log.

What the TLS handshake refuses only zenoh knows, and only its own log tells: on standard output, where a daemon writes
nothing. What a valid certificate is refused for, the list of members tells.
"""

import os
import re
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

from zswarm import endpoint
from zswarm.protocol import codec
from zswarm.security import handshake
from zswarm.security.keyring import Keyring
from zswarm.security.members import holder

ZENOH_LOG = "off,zenoh_link_tls=warn,zenoh::net::routing::interceptor::access_control=trace"  # the rules tell at no other level
UNREMARKABLE = ("handshake eof", "Connection reset", "os error 104")  # somebody looked whether the port is open
DIALLED_S = 5.0  # after which a router should have been reached
EVERY_S = 10.0  # the same reason is told at most so often: a refused program tries again each second
MARK = re.compile(r"zenoh_link_tls::unicast: (.*)")
DENIED = re.compile(r"CertCommonName\(ot\.([^)]*)\).* is unauthorized to (?:Query|.*Liveliness Token) \(ingress\) on (\S+)")
REASONS = {
    "certificate expired": "its certificate has expired: zswarm-keys renew, and join there",
    "not valid yet": "its certificate is not valid yet: compare the clocks of both machines",
    "UnknownCA": "it does not trust this lab's authority: its keys are of another one",
    "UnknownIssuer": "its certificate is of another authority",
    "BadSignature": "its certificate is of another authority",
    "DecryptError": "it does not trust this lab's authority: its keys are of another one of the same name",
    "sent no certificates": "it shows no certificate: it has no keys of this lab",
    "corrupt message": "it does not speak TLS: a program without keys, which would go on in the clear",
    "Expired": "it says that this machine's certificate has expired: zswarm-keys renew, and join here",
    "BadCertificate": "it does not accept this machine's certificate",
}


def watch_links() -> None:
    """Log whatever handshake zenoh refuses, from now on; standard output is zenoh's then."""
    os.environ.setdefault("NO_COLOR", "1")
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)
    zenoh.init_log_from_env_or(ZENOH_LOG)
    threading.Thread(target=_read, args=(reading,), name="refusals", daemon=True).start()


def _log() -> Any:
    import structlog  # of daemons: it brings all of rich, for which a run that only looks who refuses it would wait

    return structlog.get_logger()


def log_stranger(certificate: str, address: str, reason: str) -> None:
    """For a daemon."""
    _log().warning("member_unknown", certificate=certificate, address=address, reason=reason)


def watch_members(session: zenoh.Session, keyring: Keyring, tell: Callable[[str, str, str], None] = log_stranger) -> None:
    """Tell of whoever has a certificate of the authority and is not let in; of each name every 10 s at most.

    Args:
        tell: takes the common name, an address and the reason, on zenoh's threads.
    """
    told = _Seldom()

    def on_link(event: Any) -> None:
        name = event.link.auth_identifier or ""
        if event.kind == zenoh.SampleKind.PUT and (reason := strange(name, keyring)) and told.now(name):
            tell(codec.clean(name), event.link.dst, reason)

    session.info.declare_link_events_listener(zenoh.handlers.Callback(on_link, indirect=False), history=True)


def strange(common_name: str, keyring: Keyring) -> str:
    """Why the holder of a certificate is not let in; "" when it is."""
    who = holder(common_name)
    if who is None or who.name not in keyring.members.of(who.role):
        then = "bring the newest list here (zswarm-keys join members.zkeys)" if keyring.role == "ot" else "it can ask nothing"
        return f"not, or no more, among the members (list {keyring.members.number}): {then}"
    if who.role == "ss" and keyring.role == "ss":
        return "a server does not dial servers: it can ask nothing"
    return ""


def watch_routers(connect: Sequence[str], keyring: Keyring | None) -> None:
    """Log, some seconds later, why a router that is to be dialled and this program do not let each other in."""

    def look() -> None:
        for text in connect:
            at = endpoint.parse(text)
            reason = handshake.refusal(at, keyring)
            if not reason and keyring is None and handshake.speaks_tls(at):
                reason = "it lets in members only: zswarm-keys join BUNDLE"
            if reason:
                _log().warning("router_refused", endpoint=text, reason=reason)

    if connect:
        timer = threading.Timer(DIALLED_S, look)
        timer.daemon = True
        timer.start()


class _Seldom:
    """The same at most every 10 s."""

    def __init__(self) -> None:
        self._told: dict[str, float] = {}

    def now(self, what: str) -> bool:
        now = time.monotonic()
        if now < self._told.get(what, now):
            return False
        self._told[what] = now + EVERY_S
        return True


def in_words(line: str) -> str:
    """Why a handshake failed, from a line of zenoh's log; "" when it is of something else."""
    said = MARK.search(line)
    if said is None:
        return ""
    text = said[1].partition(" Hint:")[0]
    if any(mark in text for mark in UNREMARKABLE):
        return ""
    return next((words for mark, words in REASONS.items() if mark in text), codec.clean(text))


def another_users(line: str) -> tuple[str, str] | None:
    """The certificate and the key of who asked or showed itself in another user's name, or in all users' by a wildcard."""
    denied = DENIED.search(line)
    if denied is None or "/ot/" not in denied[2]:
        return None
    user, key = denied.groups()
    return None if key.split("/ot/")[1].split("/")[0] == user else (codec.clean(f"ot.{user}"), codec.clean(key))


def _read(reading: int) -> None:
    told = _Seldom()
    with os.fdopen(reading, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            if "RUST_LOG" in os.environ:  # somebody wants to see all of it
                sys.stderr.write(line)
            if (denied := another_users(line)) and told.now(denied[0]):
                _log().warning("member_refused", certificate=denied[0], key=denied[1], reason="the key is not of its own name")
            elif (reason := in_words(line)) and told.now(reason):
                _log().warning("link_refused", reason=reason)
