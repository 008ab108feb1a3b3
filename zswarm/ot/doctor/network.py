"""Checks of the network: the port, multicast, firewalls and servers."""

import contextlib
import errno
import json
import secrets
import shutil
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import psutil

from zswarm import session
from zswarm.errors import ConfigError
from zswarm.ot.cluster import discovery
from zswarm.ot.doctor.finding import Findings, broken, ok, warning
from zswarm.plugins.version_hash import version_hash, versions
from zswarm.protocol.messages import Requirements
from zswarm.session import Reach
from zswarm.system import scouting
from zswarm.system.format import plural
from zswarm.system.processes import MODULE
from zswarm.system.text import clean

ASK_S = 10.0
HEARD_S = 1.0
LOOK_S = 1.5
UFW = Path("/etc/ufw/ufw.conf")
PORT, LAST_PORT = session.PORT, session.PORT + session.PORTS - 1
MUST_ADMIT = f"it must admit UDP {PORT} and, where zswarm-ss runs, TCP {PORT}-{LAST_PORT}"
EXAMPLE = ("emergency-exit", "fully-meshed")  # to compare versions
DOCUMENT = "docs/network.md"


def port(number: int = PORT) -> Findings:
    """Check who listens on a server's port."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("0.0.0.0", number))  # noqa: S104  as a server would; nothing listens
            yield ok(f"TCP {number} is free for a server")
            return
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                fix = "start servers with --listen and another port"
                yield warning(f"TCP {number}: {error.strerror}", fix)
                return
    for server, listen in _daemons().items():
        if any(end.rpartition(":")[2] == str(number) for end in listen):
            yield ok(f"TCP {number} is used by this machine's server {server}")
            return
    yield warning(
        f"TCP {number} is used by {_listener(number) or 'another program'}",
        "a server here takes the next free port; multicast finds it, --connect needs its number",
    )


def _daemons() -> dict[str, list[str]]:
    """Return the endpoints of this machine's servers that can be asked."""
    try:
        views = map(
            json.loads, _output(sys.executable, *MODULE, "zswarm.ss", "status", "--json")
        )
        return {
            clean(str(view["server"])): [str(end) for end in view["listen"]]
            for view in views
        }
    except (ValueError, KeyError, TypeError):
        return {}


def _listener(number: int) -> str:
    """Return the program that listens on a port, if this user may know it."""
    with contextlib.suppress(psutil.Error, OSError):
        for each in psutil.net_connections("tcp"):
            listens = each.status == psutil.CONN_LISTEN and each.laddr
            if listens and listens.port == number and each.pid:
                return f"{clean(psutil.Process(each.pid).name())} (process {each.pid})"
    return ""


def multicast(reach: Reach) -> Findings:
    """Check multicast through every interface that Zenoh uses, to the group and back."""
    if not reach.multicast:
        yield ok("off")
        return
    if fault := scouting.fault():
        yield warning(
            fault, f"name a server or router: --connect tcp/HOST:{PORT} ({DOCUMENT})"
        )
        return
    faults = {name: _echo_fault(index) for index, name in scouting.interfaces()}
    deaf = ", ".join(f"{name} ({fault})" for name, fault in faults.items() if fault)
    heard = ", ".join(name for name, fault in faults.items() if not fault)
    group = scouting.GROUP
    if deaf:
        yield warning(
            f"packets to {group} do not come back through {deaf}",
            f"if this machine has a firewall, {MUST_ADMIT}; or use --connect",
        )
    if heard:
        yield ok(f"{group} is sent and received through {heard}")


def _echo_fault(index: int) -> str:
    """Return why this machine does not receive its own messages on an interface; "" if it does."""
    group, number = scouting.GROUP.split(":")
    address = (group, int(number))
    member = struct.pack("=4s4si", socket.inet_aton(group), bytes(4), index)
    word = secrets.token_bytes(8)
    try:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        ):
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            receiver.bind(address)
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, member)
            # Stay on this machine.
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            sender.sendto(word, address)
            end = time.monotonic() + HEARD_S  # however much others send to the group
            while (rest := end - time.monotonic()) > 0:
                receiver.settimeout(rest)
                if receiver.recv(64) == word:
                    return ""
            return "nothing received"
    except TimeoutError:
        return "nothing received"
    except OSError as error:
        return error.strerror or str(error)


def firewall() -> Findings:
    """Check common firewalls."""
    found = [*_ufw(), *_firewalld(), *_nftables()]
    yield from found or [ok("none was found on this machine")]


def _ufw() -> Findings:
    with contextlib.suppress(OSError):
        if "ENABLED=yes" in UFW.read_text():
            fix = f"sudo ufw allow {PORT}/udp; sudo ufw allow {PORT}:{LAST_PORT}/tcp"
            yield warning(f"ufw is on: {MUST_ADMIT}", fix)


def _firewalld() -> Findings:
    if _output("firewall-cmd", "--state") == ["running"]:
        yield warning(
            f"firewalld runs: {MUST_ADMIT}",
            f"sudo firewall-cmd --permanent --add-port={PORT}/udp --add-port={PORT}-{LAST_PORT}/tcp"
            "; sudo firewall-cmd --reload",
        )


def _nftables() -> Findings:
    rules = "\n".join(_output("nft", "list", "ruleset"))  # only root may list them
    refuses = any(word in rules for word in ("policy drop", " reject", " drop"))
    if "hook input" not in rules or not refuses:
        return
    if str(PORT) in rules:
        yield ok(f"nftables has rules, some for port {PORT}")
    else:
        yield warning(
            f"nftables refuses some packets: {MUST_ADMIT}", "see sudo nft list ruleset"
        )


def _output(*command: str) -> list[str]:
    """Return the lines that a program prints; none if it cannot be run."""
    if shutil.which(command[0]) is None:
        return []
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=ASK_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return []
    return done.stdout.strip().splitlines()


def servers(realm: str, reach: Reach, simulators: Requirements | None = None) -> Findings:
    """Open a session, list the servers that are found, and compare their code with ours."""
    requirements = simulators or Requirements(
        simulator=EXAMPLE[0],
        representation=EXAMPLE[1],
        version_hash=version_hash(*EXAMPLE),
        versions=versions(*EXAMPLE),
    )
    try:
        survey = discovery.survey(realm, reach, requirements=requirements, wait_s=LOOK_S)
    except ConfigError as error:
        yield broken(str(error), f"fix what is named ({DOCUMENT})")
        return
    if not survey.servers:
        yield warning(
            f"none found in realm {realm}: only this machine's slots compute",
            f"start zswarm-ss on other machines; if it runs there: {DOCUMENT}",
        )
    for line in survey.findings:
        yield warning(clean(line), f'see {DOCUMENT}, "Diagnosis"')
    offers = [each for each in survey.servers if each.offer and not each.offer.mismatch]
    if offers:
        slots = plural(sum(each.offer.capacity for each in offers if each.offer), "slot")
        count = f"{len(offers)} in realm {realm} with {slots}"
        yield ok(f"{count}, of this version: {_names(offers)}")
    for found in survey.servers:
        if why := found.reason or (found.offer.mismatch if found.offer else ""):
            yield warning(
                clean(f"{found.server} is not used: {why}"),
                "install the same zswarm there; zswarm-ot servers --for EXPERIMENT compares",
            )


def _names(found: list[discovery.Found]) -> str:
    names = [clean(server.server) for server in found]
    return ", ".join(names[:5]) + (
        f" and {len(names) - 5} more" if len(names) > 5 else ""
    )
