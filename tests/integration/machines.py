"""A lab of machines: real systemd systems on one switch, each with its own address. Needs root.

A machine is this machine's own file system with an overlay in memory, booted by systemd-nspawn: the
same programs, nothing downloaded, everything written is thrown away. All mounts, the switch and the
machines live in namespaces of one process. When it ends, at the latest with the tests, the kernel
removes everything except the machines' control groups. These are then empty, and the next lab
removes them.
"""

import errno
import os
import re
import secrets
import shlex
import shutil
import signal
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import pytest

from tests.integration.programs import DEADLINE_S, children, wait_until

SPACE = "8g"  # of memory, at most, that all machines may write
BOOT_S = 90.0
RUN_S = 180.0
LOOK_S = 0.2  # between two looks at a machine, each of which starts programs there
PREFIX = "zswarm"  # of a control group: zswarm-<pid of the test>-<6 hex digits>
# Version 2, also where it is mounted beside version 1; and where systemd keeps its own groups on
# such a system.
HIERARCHIES = [
    Path("/sys/fs/cgroup"),
    Path("/sys/fs/cgroup/unified"),
    Path("/sys/fs/cgroup/systemd"),
]
HIERARCHIES = [folder for folder in HIERARCHIES if (folder / "cgroup.procs").exists()]
CLEAN = [
    "env",
    "-i",
    "PIP_CONFIG_FILE=/etc/pip.conf",
    "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    "HOME=/root",
    "LANG=C.UTF-8",
]

# Files in the folder given are mounted, not in a folder of the machine's: tests side by side do not
# meet.
PLACE = """
mount -t tmpfs -o size={space},mode=755 tmpfs {folder}
ip link set lo up
ip link add switch type bridge mcast_snooping 0 forward_delay 0
ip link set switch up
exec sleep infinity
"""

# An empty machine-id: an identity of its own. No unit of the image's is started beside what systemd
# itself needs.
DISK = """
cd {folder}
mkdir upper-{name} work-{name} {name}
mount -t overlay overlay -o lowerdir=/,upperdir=upper-{name},workdir=work-{name} {name}
cd {name}/etc
: > machine-id
echo {name} > hostname
rm -rf systemd/system/*.wants systemd/network
ln -sf /usr/lib/systemd/system/multi-user.target systemd/system/default.target
mkdir -p systemd/network systemd/system/multi-user.target.wants
mkdir -p systemd/system/network-online.target.wants
ln -s /usr/lib/systemd/system/systemd-networkd.service systemd/system/multi-user.target.wants/
ln -s /usr/lib/systemd/system/systemd-networkd-wait-online.service \\
    systemd/system/network-online.target.wants/
printf '%s\\n' '[Match]' Name=host0 '[Network]' Address={address}/24 \\
    LinkLocalAddressing=ipv6 IPv6AcceptRA=no \
    '[Route]' Destination=224.0.0.0/4 Scope=link > systemd/network/10-host0.network
printf '%s\\n' '[global]' no-index=true find-links=/srv/wheels > pip.conf
"""


class Machine:
    """One of them, off at first. Use as ``with lab.machine(name) as machine``, or switch it on."""

    def __init__(self, lab: "Machines", name: str, number: int) -> None:
        self.name, self.address = name, f"10.78.0.{number}"
        self._lab = lab
        self._nspawn: subprocess.Popen[bytes] | None = None
        self._init = 0  # its process 1, as it is numbered outside
        lab.run(
            DISK.format(
                folder=shlex.quote(str(lab.folder)), name=name, address=self.address
            )
        )

    def __enter__(self) -> Self:
        self.switch_on()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.cut_power()

    @property
    def is_on(self) -> bool:
        """Return whether the machine has power."""
        return self._nspawn is not None

    def switch_on(self) -> None:
        """Boot the machine; return before it is up."""
        assert self._nspawn is None
        log = self._lab.folder.parent / f"{self.name}.log"
        command = [
            "systemd-nspawn",
            "--quiet",
            f"--directory={self._lab.folder / self.name}",
            f"--machine={self.name}",
            "--boot",
        ]
        command += [
            "--register=no",
            "--keep-unit",
            "--network-bridge=switch",
            "--link-journal=no",
            "--console=pipe",
        ]
        command += [
            "--resolv-conf=off",
            "--timezone=off",
            f"--bind={self._lab.shared}:/srv",
        ]
        # In a group of its own, of version 2: there systemd is told when the last process of a
        # service ended.
        groups = [shlex.quote(str(folder / self.name)) for folder in self._lab.groups]
        enter = "".join(
            f"mkdir -p {group}; echo 0 > {group}/cgroup.procs; " for group in groups
        )
        environment = "export SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=1; "
        with log.open("ab") as out:
            self._nspawn = self._lab.popen(
                ["sh", "-eu", "-c", f"{enter}{environment}exec {shlex.join(command)}"],
                out,
            )
        self._init = wait_until(self._find_init, f"{self.name} boots: {log}")

    def wait_up(self) -> None:
        """Wait until systemd has started everything."""
        self.wait_until(
            # systemctl waits itself, as soon as systemd answers it.
            lambda: (
                self.run("systemctl is-system-running --wait || :").strip()
                in ("running", "degraded")
            ),
            "it is up",
            BOOT_S,
        )

    def wait_until(
        self, condition: Callable[[], Any], what: str, deadline_s: float = DEADLINE_S
    ) -> None:
        """Wait until a condition that runs programs on a machine is true."""
        wait_until(condition, f"{self.name}: {what}", deadline_s, LOOK_S)

    def run(self, script: str, answers: str = "") -> str:
        """Run a shell script as root on its console, answer its prompts, return its output."""
        command = self.inside("sh", "-eu", "-c", script)
        done = subprocess.run(
            command, input=answers, capture_output=True, text=True, timeout=RUN_S
        )
        assert done.returncode == 0, f"{self.name}: {script}\n{done.stdout}{done.stderr}"
        return done.stdout

    def inside(self, *command: str) -> list[str]:
        """Return the command that runs a command on the machine."""
        enter = [
            "nsenter",
            "-t",
            str(self._init),
            "-m",
            "-u",
            "-i",
            "-n",
            "-p",
            "--",
            "setpriv",
            "--pdeathsig",
            "KILL",
        ]
        return [*enter, *CLEAN, *command]

    def unplug(self) -> None:
        """Pull the cable from the switch: packets are lost, nothing is reset."""
        self._lab.run(f"ip link set vb-{self.name} down")

    def plug(self) -> None:
        """Plug the cable in again."""
        self._lab.run(f"ip link set vb-{self.name} up")

    def cut_power(self) -> None:
        """End everything at once; the disk stays as it is."""
        os.kill(self._init, signal.SIGKILL)
        self.wait_off()

    def wait_off(self) -> None:
        """Wait until none of its processes runs."""
        if self._nspawn is not None:
            self._nspawn.wait(BOOT_S)
        self._nspawn, self._init = None, 0

    def _find_init(self) -> int:
        """Return the host's id of process 1 in its PID namespace; 0 before it exists."""
        assert self._nspawn is not None
        assert self._nspawn.poll() is None, f"{self.name} does not boot"
        below = [self._nspawn.pid]
        while below:
            process = below.pop()
            numbers = _numbers(process)
            if len(numbers) == self._lab.depth + 1 and numbers[-1] == "1":
                return process
            below += children(process)
        return 0


class Machines:
    """Use as ``with Machines(folder) as lab``; skips the test where this is not permitted.

    Attributes:
        shared: a folder that every machine sees as /srv. What is in its ``wheels`` is what pip
            finds there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.shared = folder / "machines", folder / "shared"
        self.folder.mkdir()
        (self.shared / "wheels").mkdir(parents=True)
        self.machines: list[Machine] = []
        name = f"{PREFIX}-{os.getpid()}-{secrets.token_hex(3)}"
        self.groups = [folder / name for folder in HIERARCHIES]

    def __enter__(self) -> Self:
        if reason := _forbidden():
            pytest.skip(reason)
        for group in [
            group for folder in HIERARCHIES for group in folder.glob(f"{PREFIX}-*-*")
        ]:
            owner = re.fullmatch(rf"{PREFIX}-([0-9]+)-[0-9a-f]{{6}}", group.name)
            if owner and not Path(f"/proc/{owner[1]}").exists():
                _remove(group)
        script = "set -eu" + PLACE.format(
            space=SPACE, folder=shlex.quote(str(self.folder))
        )
        self._holder = subprocess.Popen(
            [*_HOLD, "sh", "-c", script], stdin=subprocess.DEVNULL
        )
        self._first = wait_until(self._find_first, "the lab is made")
        self.depth = len(_numbers(self._first))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._holder.kill()  # and with it all in its namespaces
        self._holder.wait()
        for machine in self.machines:
            machine.wait_off()
        for group in self.groups:
            _remove(group)

    def machine(self, name: str) -> Machine:
        """Add a machine that is switched off."""
        made = Machine(self, name, len(self.machines) + 1)
        self.machines.append(made)
        return made

    def run(self, script: str) -> None:
        """Run a shell script next to the machines."""
        done = subprocess.run(
            [*self._inside(), "sh", "-eu", "-c", script], capture_output=True, text=True
        )
        assert done.returncode == 0, f"{script}\n{done.stderr}"

    def popen(self, command: Sequence[str], out: IO[bytes]) -> subprocess.Popen[bytes]:
        """Start a program next to the machines."""
        return subprocess.Popen(
            [*self._inside(), *command],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
        )

    def _inside(self) -> list[str]:
        return ["nsenter", "-t", str(self._first), "-m", "-n", "-p", "--", *CLEAN]

    def _find_first(self) -> int:
        """Return the process that holds the namespaces, once it has made all and sleeps."""
        assert self._holder.poll() is None, "the lab cannot be made"
        return next(
            (
                child
                for child in children(self._holder.pid)
                if Path(f"/proc/{child}/comm").read_text() == "sleep\n"
            ),
            0,
        )


# Ends with the test's process, and takes all that was started in it along; its mounts and
# interfaces go with it.
_HOLD = [
    "setpriv",
    "--pdeathsig",
    "KILL",
    "unshare",
    "--mount",
    "--net",
    "--pid",
    "--fork",
    "--kill-child",
    "--mount-proc",
]
_HOLD += ["--propagation", "private"]


def _forbidden() -> str:
    if os.geteuid() != 0:
        return "booting machines needs root"
    for program, package in (
        ("systemd-nspawn", "systemd-container"),
        ("ip", "iproute2"),
        ("nsenter", "util-linux"),
    ):
        if shutil.which(program) is None:
            return f"booting machines needs the program {program} (Debian: apt install {package})"
    if not any((folder / "cgroup.controllers").exists() for folder in HIERARCHIES):
        return "booting machines needs control groups of version 2"
    make = (
        "mkdir upper work all && "
        "mount -t overlay overlay -o lowerdir=/,upperdir=upper,workdir=work all"
    )
    script = f"mount -t tmpfs tmpfs /mnt && cd /mnt && {make} && ip link add switch type bridge"
    tried = subprocess.run([*_HOLD, "sh", "-c", script], capture_output=True, text=True)
    if tried.returncode != 0:
        return f"namespaces, overlays or bridges are not permitted here: {tried.stderr.strip()}"
    fit = "import ensurepip, sys; sys.exit(sys.version_info < (3, 11))"
    if (
        subprocess.run([*CLEAN, "python3", "-c", fit], capture_output=True).returncode
        != 0
    ):
        return "the system's python3 is not 3.11 with venv (Debian: apt install python3-venv)"
    return ""


def _remove(group: Path) -> None:
    """Remove a control group and those below it after a killed machine's last process left.

    The kernel holds a group for a moment after its last process is gone, and processes that end
    are no longer listed: only the removal itself shows that a group is empty.
    """
    wait_until(lambda: _removed(group), f"{group} is empty")


def _removed(group: Path) -> bool:
    below = sorted(group.rglob("**/"), key=lambda path: len(path.parts), reverse=True)
    try:
        for folder in below:
            folder.rmdir()
    except OSError as error:
        if error.errno != errno.EBUSY:
            raise
        return False
    return True


def _numbers(process: int) -> list[str]:
    """Return a process's ids, outermost namespace first; empty when it is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return []
    return next(line for line in lines if line.startswith("NSpid:")).split()[1:]
