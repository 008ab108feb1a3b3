"""Machines that are installed as docs/deploy.md says serve through any failure.

Whatever that is, the result is that of a run on one machine.
"""

import os
import re
import shlex
import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.integration.machines import CLEAN, Machine, Machines
from tests.integration.programs import Optimizer, query, wait_until
from tests.repository import REPOSITORY

pytestmark = pytest.mark.machines

DOCUMENT = (REPOSITORY / "docs" / "deploy.md").read_text()
# A run takes some seconds: long enough to disturb it.
EXPERIMENT = """
name = "served"
seed = 6
generations = 4
[problem]
simulator = "emergency-exit"
trials = 12
[problem.settings]
steps = 3000
agents = 20
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 50
"""
TRIALS = (50 + 3 * 37) * 12
DROP_IN = "/run/systemd/system/zswarm-ss.service.d"
CONFIGURE = "printf 'capacity = 1\\nrequire_keys = true\\n' > /etc/zswarm/ss.toml"
COUNTED = "SELECT coalesce(sum(count), 0) FROM outcomes"
SERVED = "SELECT count(DISTINCT server) FROM outcomes"


def by_path(version: str) -> str:
    """Return what pip installs on a machine, by its path there."""
    return f"zswarm[keys] @ file:///srv/wheels/zswarm-{version}-py3-none-any.whl"


def documented(heading: str, block: int = 0) -> str:
    """Return the commands of a section of docs/deploy.md."""
    section = DOCUMENT.split(f"# {heading}\n", 1)[1]
    blocks: list[str] = re.findall(r"^```sh\n(.*?)^```$", section, re.S | re.M)
    return blocks[block]


class Installed(Optimizer):
    """A ``zswarm-ot`` of a machine's own installation."""

    python = "/opt/zswarm/bin/python"


class Site:
    """Two servers, the workstations of Alice and the administrator, and runs on them."""

    def __init__(self, lab: Machines, workstation: Machine) -> None:
        self.lab, self.workstation = lab, workstation
        self.servers = [lab.machine(name) for name in ("lab-03", "lab-04")]
        self.runs: list[Run] = []
        self.ssh = lab.shared.parent / "ssh"
        self.ssh.mkdir()
        (self.ssh / "ssh").write_text(
            '#!/bin/sh\nexec $(cat "$(dirname "$0")/$1") "$2"\n'
        )
        (self.ssh / "ssh").chmod(0o755)
        (lab.shared / "experiment.toml").write_text(EXPERIMENT)
        for machine in self.servers:
            machine.switch_on()
        for machine in self.servers:
            machine.wait_up()
            machine.run(f"mkdir /etc/zswarm && {CONFIGURE}")
        with ThreadPoolExecutor() as side_by_side:
            for done in [
                side_by_side.submit(self.fleet, "install", machine)
                for machine in self.servers
            ]:
                done.result()

    def fleet(self, what: str, *machines: Machine, **environment: str) -> str:
        """Run deploy/fleet.sh with an ``ssh`` that enters the named machine; return its output."""
        for machine in machines:
            (self.ssh / machine.name).write_text(shlex.join(machine.inside("sh", "-c")))
        done = subprocess.run(
            [
                str(REPOSITORY / "deploy" / "fleet.sh"),
                what,
                *(machine.name for machine in machines),
            ],
            capture_output=True,
            text=True,
            cwd=self.lab.shared,
            env=os.environ
            | {"PACKAGE": by_path("0.1.0")}
            | environment
            | {"PATH": f"{self.ssh}:{os.environ['PATH']}"},
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def run(self, *options: str, servers: str = "2") -> "Run":
        self.runs.append(
            Run(self, f"run-{len(self.runs)}", ["--servers", servers, *options])
        )
        return self.runs[-1]

    def run_on(self, machine: Machine) -> "Run":
        """Run on this server alone."""
        for other in self.servers:
            if other is not machine:
                other.run("systemctl stop zswarm-ss")
        return self.run(servers="1")

    def mend(self) -> None:
        """End the runs and repair what a test broke."""
        for run in self.runs:
            run.close()
        for machine in self.servers:
            if not machine.is_on:
                machine.switch_on()
            machine.plug()
        for machine in self.servers:
            machine.wait_up()
            machine.run(
                f"{CONFIGURE}; rm -rf {DROP_IN}; systemctl daemon-reload; systemctl start zswarm-ss"
            )


class Run(Installed):
    """Run an experiment on the workstation."""

    def __init__(self, site: Site, name: str, options: list[str]) -> None:
        arguments = [
            "run",
            "/srv/experiment.toml",
            "--json",
            "--out",
            f"/srv/{name}",
            *options,
        ]
        self.record = site.lab.shared / name / "served"
        super().__init__(site.lab.shared, name, arguments, site.workstation.inside())

    def counted(self, sql: str = COUNTED) -> int:
        rows = query(self.record, sql)
        return int(rows[0][0]) if rows else 0

    def wait_said(self, words: str) -> None:
        try:
            wait_until(lambda: words in self.err.read_text(), f"the run says {words!r}")
        except AssertionError as error:
            raise AssertionError(
                f"{error}; but:\n{self.err.read_text()}{self.counted()} trials of {TRIALS} are "
                "counted"
            ) from None

    def wait_counted(self, trials: int) -> None:
        wait_until(
            lambda: self.counted() > trials or self.process.poll() is not None,
            f"{trials} trials are counted",
        )
        assert self.process.poll() is None, self.err.read_text()
        assert self.counted() < TRIALS, "the run is over too early for this test"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    folder = tmp_path_factory.mktemp("lab")
    with Machines(folder) as made:
        build_wheels(folder, made.shared / "wheels")
        yield made
    shutil.rmtree(made.shared)


@pytest.fixture(scope="module")
def workstation(lab: Machines) -> Machine:
    """The administrator's machine with the authority and all keys in /srv; and Alice's."""
    machine = lab.machine("desk")
    machine.switch_on()
    machine.wait_up()
    machine.run(
        "python3 -m venv /opt/zswarm && "
        f"/opt/zswarm/bin/pip install --no-compile '{by_path('0.1.0')}'"
    )
    machine.run(
        f"PATH=/opt/zswarm/bin:$PATH; cd /srv; {documented('Keys')}zswarm-keys join --yes "
        "alice.zkeys"
    )
    return machine


def build_wheels(folder: Path, wheels: Path) -> None:
    """Build wheels of this repository and its requirements for the machines' Python."""
    subprocess.run([*CLEAN, "python3", "-m", "venv", str(folder / "venv")], check=True)
    python = str(folder / "venv" / "bin" / "python")
    command = [
        python,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--wheel-dir",
        str(wheels),
        f"{REPOSITORY}[keys]",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    shutil.rmtree(folder / "venv")


@pytest.fixture(scope="module")
def installed(lab: Machines, workstation: Machine) -> Site:
    return Site(lab, workstation)


@pytest.fixture
def site(installed: Site) -> Iterator[Site]:
    """Repair the site before a test."""
    yield installed
    installed.mend()


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the history hash of the experiment on one local slot."""
    folder = tmp_path_factory.mktemp("alone")
    (folder / "experiment.toml").write_text(EXPERIMENT)
    options = ["--servers", "local", "--set", "cluster.local_slots=1"]
    return str(
        Optimizer(folder, "alone", ["run", "experiment.toml", "--json", *options]).done()[
            "history_hash"
        ]
    )


def show(machine: Machine, *names: str) -> list[str]:
    """Return systemd's properties of the server's unit."""
    lines = machine.run(
        f"systemctl show zswarm-ss {' '.join(f'-p {name}' for name in names)}"
    ).splitlines()
    told = dict(line.split("=", 1) for line in lines)
    return [told[name] for name in names]


def wait_active(machine: Machine) -> None:
    machine.wait_until(lambda: show(machine, "ActiveState") == ["active"], "it serves")


def restart_counted(machine: Machine, restarts: int) -> None:
    machine.wait_until(
        lambda: show(machine, "NRestarts", "ActiveState") == [str(restarts), "active"],
        "it serves again",
    )


# ---- the document


def test_the_documented_commands_install_upgrade_and_uninstall(
    lab: Machines, workstation: Machine
) -> None:
    """Installed, looked at, upgraded and uninstalled, as it says; then nothing is left of it."""
    with lab.machine("lab-01") as machine:
        machine.wait_up()
        before = machine.run(LEFT)
        machine.run("cp -p /srv/lab-01.zkeys /srv/gate.zkeys ~")
        assert "Authority: " in machine.run(documented("Install"), "y\n")
        assert show(machine, "ActiveState", "SubState", "User") == [
            "active",
            "running",
            "zswarm",
        ]
        looked_at = machine.run(documented("Install", 1))
        assert "slots" in looked_at
        assert "server_ready" in looked_at
        assert "in_the_clear" not in looked_at
        assert "Reloaded zswarm-ss.service" in machine.run("journalctl --unit zswarm-ss")
        check(machine, "zswarm-ss")
        pid = show(machine, "MainPID")
        machine.run(documented("Upgrade"))
        assert show(machine, "ActiveState") == ["active"]
        assert show(machine, "MainPID") != pid
        machine.run(documented("A router"), "y\n")
        assert machine.run("systemctl is-active zswarm-router") == "active\n"
        check(machine, "zswarm-router")
        assert ports(machine) == {"tcp 7466", "tcp 7467", "udp 7467"}
        machine.run(
            "systemctl disable --now zswarm-router && rm /etc/systemd/system/zswarm-router.service"
        )
        machine.run(documented("Uninstall"))
        assert machine.run(LEFT) == before
        assert ports(machine) == set()


def test_a_user_without_root_has_a_server(lab: Machines, workstation: Machine) -> None:
    """The server runs in the user's own systemd, as the document describes."""
    with lab.machine("lab-02") as machine:
        machine.wait_up()
        user = machine.run(
            "useradd --create-home alice && loginctl enable-linger alice && id --user alice"
        ).strip()
        machine.wait_until(
            lambda: machine.run(f"ls /run/user/{user} 2>/dev/null || :"),
            "the user's systemd is there",
        )
        as_alice = [
            "runuser",
            "-u",
            "alice",
            "--",
            "env",
            "HOME=/home/alice",
            f"XDG_RUNTIME_DIR=/run/user/{user}",
            "sh",
            "-euc",
        ]
        machine.run("install -m 600 -o alice /srv/lab-02.zkeys /home/alice")
        machine.run(shlex.join([*as_alice, documented("Without root")]), "y\n")
        told = machine.run(shlex.join([*as_alice, "systemctl --user status zswarm-ss"]))
        assert "active (running)" in told
        assert "slots busy" in told
        machine.run(shlex.join([*as_alice, "systemctl --user stop zswarm-ss"]))


LEFT = (
    "find /etc /opt /run /usr /var -name '*zswarm*' 2>/dev/null; "
    "getent passwd zswarm || :; pgrep zswarm || :"
)


def check(machine: Machine, unit: str) -> None:
    """Check the installed, running unit as deploy/check-units.sh does."""
    assert machine.run(f"systemd-analyze verify --man=no {unit}.service 2>&1") == ""
    machine.run(f"systemd-analyze security --no-pager --threshold=12 {unit}")


def ports(machine: Machine) -> set[str]:
    """Return sockets that listen beyond loopback, other than those for answers."""
    lines = [
        line.split()
        for line in machine.run(
            "ss --no-header --listening --tcp --udp --numeric"
        ).splitlines()
    ]
    ends = [(line[0], *line[4].rsplit(":", 1)) for line in lines]
    return {
        f"{kind} {port}"
        for kind, address, port in ends
        if "127." not in address and int(port) < 32_768
    }


# ---- a run on two servers


def test_a_run_survives_a_pulled_cable_and_a_power_cut(site: Site, alone: str) -> None:
    """Pull one server's cable and the other's power; both come back, one by its boot."""
    first, second = site.servers
    run = site.run()
    run.wait_counted(100)
    first.unplug()
    run.wait_counted(run.counted() + 300)
    second.cut_power()
    run.wait_said("none computes now")
    counted = run.counted()
    first.plug()
    run.wait_counted(counted + 100)
    second.switch_on()
    assert run.done()["history_hash"] == alone
    second.wait_up()
    wait_active(second)


def test_a_killed_server_is_restarted(site: Site, alone: str) -> None:
    """It returns with all its slots, and the run continues on it."""
    first = site.servers[0]
    restarts = int(show(first, "NRestarts")[0])
    run = site.run_on(first)
    run.wait_counted(100)
    old = processes(first)
    first.run("systemctl kill --kill-whom=main --signal=KILL zswarm-ss")
    restart_counted(first, restarts + 1)
    assert run.done()["history_hash"] == alone
    assert run.counted(SERVED) == 2
    assert len(old) > 1
    assert not old & processes(first)


def processes(machine: Machine) -> set[str]:
    """Return the server's processes: program and slots."""
    return set(machine.run("pgrep --uid zswarm").split())


def test_a_hanging_server_is_restarted(site: Site, alone: str) -> None:
    """Its loop does nothing for as long as WatchdogSec, here made short."""
    second = site.servers[1]
    second.run(
        f"mkdir -p {DROP_IN} && printf '[Service]\\nWatchdogSec=10\\n' > {DROP_IN}/short.conf && "
        "systemctl daemon-reload"
    )
    second.run("systemctl restart zswarm-ss")
    restarts = int(show(second, "NRestarts")[0])
    run = site.run_on(second)
    run.wait_counted(100)
    second.run("systemctl kill --kill-whom=main --signal=STOP zswarm-ss")
    restart_counted(second, restarts + 1)
    assert "Watchdog timeout" in second.run("journalctl --boot --unit zswarm-ss")
    assert run.done()["history_hash"] == alone
    assert run.counted(SERVED) == 2


def test_a_stopped_server_finishes_running_work(site: Site, alone: str) -> None:
    """Waiting work is left to the next server, which here is the same one, started again."""
    first = site.servers[0]
    run = site.run_on(first)
    run.wait_counted(100)
    first.run("systemctl stop zswarm-ss")
    assert show(first, "Result", "ActiveState", "ExecMainStatus") == [
        "success",
        "inactive",
        "143",
    ]
    log = first.run("journalctl --boot --unit zswarm-ss --lines 20 --output cat")
    assert "server_stopped" in log
    assert "drain_cut_short" not in log
    first.run("systemctl start zswarm-ss")
    assert run.done()["history_hash"] == alone
    assert run.counted(SERVED) == 2


def test_a_server_reads_its_keys_again_during_a_run(site: Site, alone: str) -> None:
    """Under the same id: nothing is evaluated elsewhere, or again."""
    first = site.servers[0]
    run = site.run_on(first)
    run.wait_counted(100)
    site.workstation.run("cd /srv && /opt/zswarm/bin/zswarm-keys issue --optimizer bob")
    (site.lab.shared / "lab-03.zkeys").unlink(missing_ok=True)
    site.fleet("join", first)
    assert run.done()["history_hash"] == alone
    assert run.counted(SERVED) == 1
    assert "reload_refused" not in first.run("journalctl --boot --unit zswarm-ss")


def test_users_without_keys_are_refused(site: Site) -> None:
    """The server refuses them, and both sides report the reason in words."""
    first = site.servers[0]
    script = f"zswarm-ot servers --no-multicast --wait 2 --connect tcp/{first.address}:7467 2>&1"
    told = site.workstation.run(
        f"PATH=/opt/zswarm/bin:$PATH; ZSWARM_KEYS=none {script} && exit 1 || [ $? = 4 ]"
    )
    assert "lets in members only" in " ".join(told.split())
    assert "it does not speak TLS" in first.run("journalctl --boot --unit zswarm-ss")


def test_a_mistake_in_the_configuration_is_shown_and_not_tried_again(site: Site) -> None:
    first = site.servers[0]
    first.run(
        """echo 'capacity = "many"' > /etc/zswarm/ss.toml; ! systemctl restart zswarm-ss"""
    )
    assert show(first, "ActiveState", "ExecMainStatus", "NRestarts") == [
        "failed",
        "78",
        "0",
    ]
    assert "capacity" in first.run("systemctl status zswarm-ss || :")


def test_without_its_keys_a_server_does_not_start(site: Site) -> None:
    """The installed example has ``require_keys = true``."""
    first = site.servers[0]
    first.run("mv /etc/zswarm/keys /etc/zswarm/away")
    try:
        first.run("! systemctl restart zswarm-ss")
        assert show(first, "ActiveState", "ExecMainStatus") == ["failed", "78"]
        assert "keys" in first.run(
            "journalctl --boot --unit zswarm-ss --lines 10 --output cat"
        )
    finally:
        first.run("mv /etc/zswarm/away /etc/zswarm/keys")


def test_compiled_kernels_outlive_a_restart(site: Site, alone: str) -> None:
    first = site.servers[0]
    kept = "cd /var/cache/zswarm && find . -name '*.nb?' -printf '%p %T@ %U\\n' | sort"
    assert site.run_on(first).done()["history_hash"] == alone
    kernels = first.run(kept)
    assert len(kernels.splitlines()) > 5
    first.run("systemctl restart zswarm-ss")
    assert site.run(servers="1").done()["history_hash"] == alone
    assert first.run(kept) == kernels


def test_servers_are_upgraded_during_a_run(site: Site, alone: str) -> None:
    """A server with equal code is used; one with other code is named and not used."""
    first, second = site.servers
    wheels = [next((site.lab.shared / "wheels").glob("zswarm-*.whl"))]
    wheels.append(rebuilt(wheels[0], "0.1.1", ""))
    wheels.append(rebuilt(wheels[0], "0.2.0", "# computes otherwise"))
    run = site.run_on(first)
    run.wait_counted(100)
    assert site.fleet("upgrade", first, PACKAGE=by_path("0.1.1")) == "lab-03: upgrade\n"
    counted = run.counted()
    run.wait_counted(counted + 100)
    site.fleet("upgrade", first, PACKAGE=by_path("0.2.0"))
    assert {"active", "0.2.0"} <= set(re.split(r"[\s,]+", site.fleet("status", first)))
    run.wait_said("is not used: versions differ")
    assert run.err.read_text().count("is not used") == 1
    site.fleet("upgrade", second, PACKAGE=by_path("0.1.1"))
    assert run.done()["history_hash"] == alone
    assert run.counted(SERVED) == 3
    for wheel in wheels[1:]:
        wheel.unlink()
    site.fleet("upgrade", first, second)


def rebuilt(wheel: Path, version: str, line: str) -> Path:
    """Rebuild the wheel as another version, with one more line in a file that computes."""
    made = wheel.with_name(wheel.name.replace("0.1.0", version))
    with (
        zipfile.ZipFile(wheel) as old,
        zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for entry in old.infolist():
            body = old.read(entry)
            if entry.filename.endswith(".dist-info/METADATA"):
                body = body.replace(b"Version: 0.1.0", b"Version: " + version.encode())
            if entry.filename == "zswarm/system/version.py":
                body = body.replace(b"0.1.0", version.encode())
            if entry.filename == "zswarm/evaluate.py":
                body += line.encode()
            new.writestr(entry.filename.replace("0.1.0", version), body)
    return made
