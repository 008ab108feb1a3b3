"""Build a lab of network namespaces: hosts on switches, with links to cut.

It needs root and iproute2, and touches nothing outside.

Everything, switches included, lives in namespaces of one lab, so labs side by side may use the same
addresses. They are deleted at the end, and those of a test that was killed by the next lab.
"""

import os
import re
import secrets
import shutil
import signal
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

NAMESPACES = Path("/run/netns")
PREFIX = "zswarm"  # of a namespace: zswarm-<pid of the test>-<6 hex digits>-<number>


class Host:
    """Add a host with one interface per network: ``eth0``, ``eth1``, ... as in ``networks``."""

    def __init__(self, lab: "Lab", networks: tuple["Network", ...]) -> None:
        self.namespace = lab.add_namespace()
        # Put before a command; the process is the command's own.
        self.inside = ["ip", "netns", "exec", self.namespace]
        self._networks = networks
        self.addresses = [
            network.plug(self, f"eth{number}") for number, network in enumerate(networks)
        ]
        if networks:
            _ip("-n", self.namespace, "route", "add", "224.0.0.0/4", "dev", "eth0")
        self.address = self.addresses[0] if networks else "127.0.0.1"
        for number in range(len(networks)):
            self._wait_up(f"eth{number}")

    def _wait_up(self, interface: str) -> None:
        """Wait for the interfaces: Zenoh ignores one that is not running when it opens."""
        end = time.monotonic() + 60.0
        while (
            "LOWER_UP" not in (told := self.run("ip", "-o", "link", "show", interface))
            or "state UP" not in told
        ):
            assert time.monotonic() < end, f"{interface} does not come up: {told}"
            time.sleep(0.01)

    def run(self, *command: str) -> str:
        """Run a short command here and return its output."""
        return subprocess.run(
            [*self.inside, *command], check=True, capture_output=True, text=True
        ).stdout

    def succeeds(self, *command: str) -> bool:
        """Return whether a short command succeeds here."""
        return (
            subprocess.run(
                [*self.inside, *command], check=False, capture_output=True
            ).returncode
            == 0
        )

    def cut(self, network: int = 0) -> None:
        """Pull the cable from the switch: packets are lost, nothing is reset."""
        self._networks[network].port(self, f"eth{network}", "down")

    def mend(self, network: int = 0) -> None:
        """Plug the cable in again."""
        self._networks[network].port(self, f"eth{network}", "up")


class Network:
    """A switch that floods multicast, with addresses 10.77.<number>.<host>/24 and no routing."""

    def __init__(self, lab: "Lab", number: int) -> None:
        self.number = number
        self._namespace = lab.add_namespace()
        self._hosts: list[str] = []
        _ip(
            "-n",
            self._namespace,
            "link",
            "add",
            "switch",
            "type",
            "bridge",
            "mcast_snooping",
            "0",
            "forward_delay",
            "0",
        )
        _ip("-n", self._namespace, "link", "set", "switch", "up")

    def plug(self, host: Host, interface: str) -> str:
        """Connect an interface and return its address."""
        self._hosts.append(host.namespace)
        address, port = f"10.77.{self.number}.{len(self._hosts)}", f"p{len(self._hosts)}"
        cable = ("type", "veth", "peer", "name", interface, "netns", host.namespace)
        _ip("-n", self._namespace, "link", "add", port, *cable)
        _ip("-n", self._namespace, "link", "set", port, "master", "switch", "up")
        _ip("-n", host.namespace, "address", "add", f"{address}/24", "dev", interface)
        _ip("-n", host.namespace, "link", "set", interface, "up")
        return address

    def port(self, host: Host, interface: str, state: str) -> None:
        """Switch a host's port up or down."""
        assert interface.startswith("eth")
        _ip(
            "-n",
            self._namespace,
            "link",
            "set",
            f"p{self._hosts.index(host.namespace) + 1}",
            state,
        )


class Lab:
    """Use as ``with Lab() as lab``; skips the test where namespaces are not permitted."""

    def __init__(self) -> None:
        self._name = f"{PREFIX}-{os.getpid()}-{secrets.token_hex(3)}"
        self._namespaces: list[str] = []
        self._networks = 0

    def __enter__(self) -> Self:
        if reason := _forbidden():
            pytest.skip(reason)
        for namespace in sorted(NAMESPACES.glob(f"{PREFIX}-*-*-*")):
            owner = re.fullmatch(
                rf"{PREFIX}-([0-9]+)-[0-9a-f]{{6}}-[0-9]+", namespace.name
            )
            if owner and not Path(f"/proc/{owner[1]}").exists():
                _delete(namespace.name)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for namespace in self._namespaces:
            _delete(namespace)

    def network(self) -> Network:
        """Add a switch without hosts."""
        self._networks += 1
        return Network(self, self._networks)

    def host(self, *networks: Network) -> Host:
        """Add a host on these networks; multicast leaves by the first one."""
        return Host(self, networks)

    def add_namespace(self) -> str:
        """Add an empty namespace with loopback up."""
        name = f"{self._name}-{len(self._namespaces)}"
        _ip("netns", "add", name)
        self._namespaces.append(name)
        _ip("-n", name, "link", "set", "lo", "up")
        return name


def _forbidden() -> str:
    if shutil.which("ip") is None:
        return "network namespaces need the program ip (Debian: apt install iproute2)"
    name = f"{PREFIX}-{os.getpid()}-{secrets.token_hex(3)}-0"
    tried = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
    if tried.returncode != 0:
        return f"network namespaces are not permitted here: {tried.stderr.strip()}"
    tried = subprocess.run(
        ["ip", "-n", name, "link", "add", "switch", "type", "bridge"],
        capture_output=True,
        text=True,
    )
    _delete(name)
    return (
        f"no bridge can be made here: {tried.stderr.strip()}"
        if tried.returncode != 0
        else ""
    )


def _delete(namespace: str) -> None:
    """Delete a namespace after its processes, which would keep it alive."""
    end = time.monotonic() + 10.0
    while (pids := _pids(namespace)) and time.monotonic() < end:
        for pid in pids:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        time.sleep(0.01)
    subprocess.run(["ip", "netns", "delete", namespace], capture_output=True)


def _pids(namespace: str) -> list[int]:
    """Return a namespace's processes; unreaped ones have already left it."""
    told = subprocess.run(
        ["ip", "netns", "pids", namespace], capture_output=True, text=True
    )
    return [int(pid) for pid in told.stdout.split()]


def _ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, f"ip {' '.join(arguments)}: {done.stderr.strip()}"
