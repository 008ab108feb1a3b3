"""Genomes of megabytes: what the messages to servers take in the optimizer's memory."""

import subprocess
import sys
from pathlib import Path

import pytest

CANDIDATES = 100
PROGRAM = """
import re
import sys

import numpy as np

import zswarm

problem = zswarm.problem(
    simulator="xor", representation={"kind": "fully-meshed", "hidden": 1000}
)
genome = bytes(4 * problem.genes)
vectors = np.random.default_rng(0).standard_normal((int(sys.argv[1]), problem.genes), np.float32)
genomes = [vector.tobytes() for vector in vectors]
del vectors


def peak():
    with open("/proc/self/status") as status:
        return int(re.search(r"VmHWM:\\s+(\\d+)", status.read())[1]) / 1024


with open("/proc/self/clear_refs", "w") as clear:
    clear.write("5")  # the peak so far is forgotten
before = peak()
with zswarm.connect(servers="local") as connection:
    fitness = connection.evaluate(problem, genomes)
assert np.isfinite(fitness).all()
print(len(fitness), before, peak())
"""


@pytest.mark.long
def test_sending_large_genomes_takes_little_memory_besides_the_genomes(
    tmp_path: Path,
) -> None:
    """Of a hundred candidates of a million parameters, each message is made when it is sent."""
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(CANDIDATES)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    evaluated, before, peak = map(float, ended.stdout.split())
    assert evaluated == CANDIDATES
    assert peak < 1000, f"MB; {before} before, with the genomes"
    assert peak - before < 300, "MB for at most four messages of 4 MB on the way"
