"""The first run on a machine: it reports what it compiles, and leaves other machines alone."""

import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tests.integration.programs import Optimizer, Server
from zswarm.config.sections import ClusterConfig
from zswarm.ot.commands import run

pytestmark = pytest.mark.programs

KERNELS = """
from zswarm.kernels.jit import array, compile_all, float64, kernel, void

@kernel(void(array(float64)))
def one(numbers):
    numbers[0] = 1.0

@kernel(void(array(float64)))
def two(numbers):
    numbers[0] = 2.0

@kernel(void(array(float64)))
def three(numbers):
    one(numbers)

compile_all(lambda missing, kernels: print(missing, kernels))
"""
COMPILING = re.compile(
    r"^compiling kernel (\d+) of (\d+), once \((\d+) s\)$", re.MULTILINE
)


def test_each_kernel_is_reported_before_it_is_compiled(tmp_path: Path) -> None:
    (tmp_path / "kernels.py").write_text(KERNELS)

    def reported() -> list[str]:
        done = subprocess.run(
            [sys.executable, "kernels.py"],
            cwd=tmp_path,
            env={"ZSWARM_CACHE": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.splitlines()

    assert reported() == ["3 3", "2 3", "1 3"]
    assert reported() == [], "they are cached"


def test_a_cold_run_reports_the_kernels_that_it_compiles(tmp_path: Path) -> None:
    """In order, again and again with the time since it began, and not in the next run."""
    arguments = ["run", "xor", "--generations", "1", "--servers", "local"]

    def evolve(name: str) -> list[tuple[int, ...]]:
        environment = {"ZSWARM_CACHE": str(tmp_path / "cache"), "ZSWARM_PLAIN": ""}
        optimizer = Optimizer(tmp_path, name, [*arguments, "--json"], **environment)
        optimizer.done()
        found = COMPILING.findall(optimizer.err.read_text())
        return [tuple(map(int, line)) for line in found]

    cold = evolve("cold")
    assert len({kernels for _, kernels, _ in cold}) == 1
    assert [number for number, _, _ in cold] == sorted(number for number, _, _ in cold)
    assert [seconds for *_, seconds in cold] == sorted(seconds for *_, seconds in cold)
    assert 1 <= cold[0][0] <= cold[-1][0] <= cold[0][1]
    assert evolve("warm") == []


def test_a_run_without_an_argument_uses_this_machine_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It names the servers that it finds meanwhile; ``--servers auto`` uses them."""
    server = Server(tmp_path, "lab-07", capacity=1).ready()
    reach = ClusterConfig(connect=[server.endpoint], multicast=False)
    try:
        with run.naming_unused_servers(reach):
            searching = [
                each for each in threading.enumerate() if each.name == run.SEARCHER
            ]
            searching[0].join()
    finally:
        server.close()
    said = capsys.readouterr().err
    assert said.startswith("1 server found: lab-07-")
    assert "zswarm-ot run --servers auto" in said
    optimizer = Optimizer(tmp_path, "ot", ["run", "--generations", "1", "--json"])
    assert optimizer.done()["run"] == "runs/stadium"
    assert "stadium: 2 slots of this machine\n" in optimizer.err.read_text()
