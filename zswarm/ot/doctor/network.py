"""The network: who has our port, whether multicast works, what a firewall may stop, and which servers are found."""

import contextlib
import errno
import json
import os
import secrets
import shutil
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from zswarm import session
from zswarm.errors import ConfigError
from zswarm.ot import discovery
from zswarm.ot.doctor.finding import Finding, broken, ok, warning
from zswarm.ot.terminal import plural
from zswarm.protocol.codec import clean
from zswarm.protocol.messages import Requirements
from zswarm.session import Reach
from zswarm.version_hash import version_hash, versions

ASK_S = 10.0
HEARD_S = 1.0
LOOK_S = 1.5
UFW = Path("/etc/ufw/ufw.conf")
LET_IN = f"UDP {session.PORT} and, where zswarm-ss runs, TCP {session.PORT}-{session.PORT + session.PORTS - 1}"
EXAMPLE = ("emergency-exit", "fully-meshed")  # by which versions are compared
DOCUMENT = "docs/network.md"


def port(number: int = session.PORT) -> Iterator[Finding]:
    """Who listens where a server does."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("0.0.0.0", number))  # noqa: S104  as a server would; nothing listens
            yield ok("port", f"TCP {number} is free for a server")
            return
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                yield warning("port", f"TCP {number}: {error.strerror}", "start servers with --listen and another port")
                return
    for server, listen in _daemons().items():
        if any(end.rpartition(":")[2] == str(number) for end in listen):
            yield ok("port", f"TCP {number} is used by this machine's server {server}")
            return
    yield warning(
        "port",
        f"TCP {number} is used by {_holder(number) or 'another program'}",
        "a server here takes the next free port: multicast finds it, but --connect needs that port's number",
    )


def _daemons() -> dict[str, list[str]]:
    """The servers of this machine that can be asked, and where they listen."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "zswarm.ss", "status", "--json"], capture_output=True, text=True, timeout=ASK_S, check=False
        )
        views = [json.loads(line) for line in done.stdout.splitlines()]
        return {clean(str(view["server"])): [str(end) for end in view["listen"]] for view in views}
    except (OSError, ValueError, KeyError, TypeError, subprocess.TimeoutExpired):
        return {}


def _holder(number: int) -> str:
    """The program that listens on a port, as far as this user may know."""
    sockets = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        try:
            rows = [line.split() for line in Path(table).read_text().splitlines()[1:]]
        except OSError:
            continue
        sockets |= {f"socket:[{row[9]}]" for row in rows if row[3] == "0A" and int(row[1].rpartition(":")[2], 16) == number}
    for process in Path("/proc").iterdir() if sockets else ():
        if process.name.isdigit() and _has(process, sockets):
            with contextlib.suppress(OSError):  # it ended meanwhile
                name = (process / "comm").read_text(errors="replace").strip()
                return f"{clean(name)} (process {process.name})"
    return ""


def _has(process: Path, sockets: set[str]) -> bool:
    try:
        return any(os.readlink(file) in sockets for file in (process / "fd").iterdir())
    except OSError:
        return False  # of another user, or it ended


def multicast(reach: Reach) -> Iterator[Finding]:
    """Through every interface that Zenoh uses, to the group and back."""
    if not reach.multicast:
        yield ok("multicast", "not asked for")
        return
    if fault := session.multicast_fault():
        yield warning("multicast", fault, f"name a server or router: --connect tcp/HOST:{session.PORT} ({DOCUMENT})")
        return
    faults = {name: _unheard(index) for index, name in session.scouting_interfaces()}
    deaf = [f"{name} ({fault})" for name, fault in faults.items() if fault]
    heard = [name for name, fault in faults.items() if not fault]
    if deaf:
        yield warning(
            "multicast",
            f"what is sent to {session.SCOUTING_GROUP} does not come back through {', '.join(deaf)}",
            f"a firewall of this machine? It must let in {LET_IN}; or use --connect",
        )
    if heard:
        yield ok("multicast", f"{session.SCOUTING_GROUP} is sent and heard through {', '.join(heard)}")


def _unheard(index: int) -> str:
    """Why this machine does not hear itself through an interface; "" when it does."""
    group, number = session.SCOUTING_GROUP.split(":")
    member = struct.pack("=4s4si", socket.inet_aton(group), bytes(4), index)
    word = secrets.token_bytes(8)
    try:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        ):
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            receiver.bind((group, int(number)))
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, member)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)  # other machines need not hear it
            sender.sendto(word, (group, int(number)))
            end = time.monotonic() + HEARD_S  # however much others send to the group
            while (left := end - time.monotonic()) > 0:
                receiver.settimeout(left)
                if receiver.recv(64) == word:
                    return ""
            return "nothing heard"
    except TimeoutError:
        return "nothing heard"
    except OSError as error:
        return error.strerror or str(error)


def firewall() -> Iterator[Finding]:
    """Those that are commonly installed."""
    found = [*_ufw(), *_firewalld(), *_nftables()]
    yield from found or [ok("firewall", "none is seen on this machine")]


def _ufw() -> Iterator[Finding]:
    try:
        on = "ENABLED=yes" in UFW.read_text()
    except OSError:
        return
    if on:
        rules = f"sudo ufw allow {session.PORT}/udp"
        yield warning(
            "firewall", f"ufw is on: it must let in {LET_IN}", f"{rules}; sudo ufw allow {session.PORT}:{session.PORT + 99}/tcp"
        )


def _firewalld() -> Iterator[Finding]:
    if _said("firewall-cmd", "--state") == "running":
        yield warning(
            "firewall",
            f"firewalld runs: it must let in {LET_IN}",
            f"sudo firewall-cmd --permanent --add-port={session.PORT}/udp "
            f"--add-port={session.PORT}-{session.PORT + 99}/tcp; sudo firewall-cmd --reload",
        )


def _nftables() -> Iterator[Finding]:
    rules = _said("nft", "list", "ruleset")  # root alone may see them
    if "hook input" in rules and ("policy drop" in rules or " reject" in rules or " drop" in rules):
        if f"{session.PORT}" in rules:
            yield ok("firewall", f"nftables has rules, some for port {session.PORT}")
        else:
            yield warning("firewall", f"nftables refuses something: it must let in {LET_IN}", "look at: sudo nft list ruleset")


def _said(*command: str) -> str:
    if shutil.which(command[0]) is None:
        return ""
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=ASK_S, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        return ""


def servers(realm: str, reach: Reach, simulators: Requirements | None = None) -> Iterator[Finding]:
    """A session opens; who is found, and whether their code is ours."""
    wanted = simulators or Requirements(
        simulator=EXAMPLE[0], representation=EXAMPLE[1], version_hash=version_hash(*EXAMPLE), versions=versions(*EXAMPLE)
    )
    try:
        survey = discovery.survey(realm, reach, requirements=wanted, wait_s=LOOK_S)
    except ConfigError as error:
        yield broken("servers", str(error), f"mend what is named ({DOCUMENT})")
        return
    if not survey.servers:
        text = f"none found in realm {realm}: this machine's slots compute alone"
        yield warning("servers", text, f"start zswarm-ss on other machines; if it runs there: {DOCUMENT}")
        for line in survey.findings:
            yield warning("servers", clean(line), f'see {DOCUMENT}, "Diagnosis"')
        return
    offers = [found for found in survey.servers if found.offer is not None and not found.offer.mismatch]
    if offers:
        slots = sum(found.offer.capacity for found in offers if found.offer)
        yield ok("servers", f"{len(offers)} in realm {realm} with {plural(slots, 'slot')}, of this version: {_names(offers)}")
    for found in survey.servers:
        why = found.reason or (found.offer.mismatch if found.offer else "")
        if why:
            text = clean(f"{found.server} is not used: {why}")
            yield warning("servers", text, "install the same zswarm there; zswarm-ot servers --for EXPERIMENT compares")


def _names(found: list[discovery.Found]) -> str:
    names = [clean(server.server) for server in found]
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
