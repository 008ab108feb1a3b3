"""docs/deploy.md on real systems: what it says is installed word by word, and serves whatever happens to the machines.

Whatever that is, the result is that of a run on one machine.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from machines import CLEAN, Machine, Machines
from programs import Optimizer, query, wait_until

pytestmark = pytest.mark.machines

REPOSITORY = Path(__file__).parents[2]
DOCUMENT = (REPOSITORY / "docs" / "deploy.md").read_text()
# A run takes some seconds: long enough to disturb it.
EXPERIMENT = """
name = "served"
seed = 6
generations = 4
[problem]
simulator = "emergency-exit"
trials = 20
[problem.settings]
steps = 1000
agents = 20
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 50
"""
TRIALS = (50 + 3 * 37) * 20
COUNTED = "SELECT coalesce(sum(count), 0) FROM outcomes"
SERVED = "SELECT count(DISTINCT server) FROM outcomes"


def documented(heading: str, block: int = 0) -> str:
    """The commands of a section of docs/deploy.md."""
    section = DOCUMENT.split(f"# {heading}\n", 1)[1]
    return re.findall(r"^```sh\n(.*?)^```$", section, re.S | re.M)[block]


class Installed(Optimizer):
    """A ``zswarm-ot`` of a machine's own installation."""

    python = "/opt/zswarm/bin/python"


class Site:
    """Two machines that serve and a workstation, all installed; and the runs on it."""

    def __init__(self, lab: Machines) -> None:
        self.lab = lab
        self.servers = [lab.machine(name) for name in ("ss1", "ss2")]
        self.workstation = lab.machine("ws")
        self.runs = 0
        (lab.shared / "experiment.toml").write_text(EXPERIMENT)
        for machine in lab.machines:
            machine.switch_on()
        for machine in lab.machines:
            machine.wait_up()
        with ThreadPoolExecutor() as side_by_side:
            installs = [side_by_side.submit(self.fleet, "install", machine) for machine in self.servers]
            self.workstation.run("python3 -m venv /opt/zswarm && /opt/zswarm/bin/pip install zswarm")
            for install in installs:
                install.result()

    def fleet(self, what: str, *machines: Machine, **environment: str) -> str:
        """Run deploy/fleet.sh; ssh is a program that enters the machine of that name."""
        folder = self.lab.shared.parent / f"ssh-{what}-{machines[0].name}"
        folder.mkdir(exist_ok=True)
        enter = "\n".join(f'{machine.name}) shift; exec {" ".join(machine.inside("sh", "-c"))} "$*";;' for machine in machines)
        (folder / "ssh").write_text(f"#!/bin/sh\ncase $1 in\n{enter}\nesac\nexit 255\n")
        (folder / "ssh").chmod(0o755)
        done = subprocess.run(
            [str(REPOSITORY / "deploy" / "fleet.sh"), what, *(machine.name for machine in machines)],
            capture_output=True, text=True, env=os.environ | environment | {"PATH": f"{folder}:{os.environ['PATH']}"},
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def run(self, *options: str, servers: str = "2") -> "Run":
        self.runs += 1
        return Run(self, f"run-{self.runs}", ["--servers", servers, *options])


class Run(Installed):
    """A run of the workstation."""

    def __init__(self, site: Site, name: str, options: list[str]) -> None:
        arguments = ["run", "/srv/experiment.toml", "--json", "--out", f"/srv/{name}", *options]
        self.record = site.lab.shared / name / "served"
        super().__init__(site.lab.shared, name, arguments, site.workstation.inside())

    def counted(self, sql: str = COUNTED) -> int:
        rows = query(self.record, sql)
        return int(rows[0][0]) if rows else 0

    def wait_counted(self, trials: int) -> None:
        wait_until(lambda: self.counted() > trials or self.process.poll() is not None, f"{trials} trials are counted")
        assert self.process.poll() is None, self.err.read_text()
        assert self.counted() < TRIALS, "the run is over too early for this test"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    folder = tmp_path_factory.mktemp("lab")
    with Machines(folder) as made:
        build_wheels(folder, made.shared / "wheels")
        yield made
    shutil.rmtree(made.shared)


def build_wheels(folder: Path, wheels: Path) -> None:
    """This repository and what it needs, for the machines' Python."""
    subprocess.run([*CLEAN, "python3", "-m", "venv", folder / "venv"], check=True)
    command = [folder / "venv" / "bin" / "python", "-m", "pip", "wheel", "--quiet", "--wheel-dir", wheels, f"{REPOSITORY}"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    shutil.rmtree(folder / "venv")


@pytest.fixture(scope="module")
def site(lab: Machines) -> Site:
    return Site(lab)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The history hash of the experiment on one slot of this machine."""
    folder = tmp_path_factory.mktemp("alone")
    (folder / "experiment.toml").write_text(EXPERIMENT)
    options = ["--servers", "local", "--set", "cluster.local_slots=1"]
    return str(Optimizer(folder, "alone", ["run", "experiment.toml", "--json", *options]).done()["history_hash"])


def show(machine: Machine, *properties: str) -> list[str]:
    """What systemd says of the server's unit."""
    return machine.run(f"systemctl show zswarm-ss --value {' '.join(f'-p {name}' for name in properties)}").split("\n")[:-1]


def wait_active(machine: Machine) -> None:
    wait_until(lambda: show(machine, "ActiveState") == ["active"], f"{machine.name} serves")


# ---- a run on two servers


def test_a_run_survives_a_pulled_cable_and_a_power_cut(site: Site, alone: str) -> None:
    """One server's cable is pulled, then the other's power is cut; both come back, the second by itself at its boot."""
    first, second = site.servers
    run = site.run()
    run.wait_counted(100)
    first.unplug()
    run.wait_counted(run.counted() + 300)
    second.cut_power()
    wait_until(lambda: "no server computes now" in run.err.read_text(), "the run misses its servers")
    counted = run.counted()
    first.plug()
    run.wait_counted(counted + 100)
    second.switch_on()
    assert run.done()["history_hash"] == alone
    second.wait_up()
    wait_active(second)
