"""Every benchmark and every measuring target of the Makefile runs in its quick form."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.repository import REPOSITORY

DEADLINE_S = 1500
QUICK = {  # target: what it runs, small
    "bench": ["benchmarks/bench.py", "--quick"],
    "bench-methods": ["benchmarks/bench.py", "--quick", "--only", "methods"],
    "bench-noise": ["benchmarks/bench.py", "--quick", "--only", "noise"],
    "bench-quick": ["benchmarks/ratios.py", "--once"],
    "chaos": ["-m", "tests.chaos", "--first", "1000", "--seconds", "1"],
    "soak": ["benchmarks/soak.py", "--quick"],
}
ELSEWHERE = {  # target: what checks it
    "fuzz": "tests/attacks/test_fuzz.py",
    "paper": "tests/benchmarks/test_paper.py",
    "product": "tests/integration/test_every_part.py and tests/bits, with fewer combinations",
    "kills": "the faults, with as many kills",
    "reference": "tests/docs/test_docs.py",
    "scale": "bench --quick has it",
    "thorough": "the same tests with less of it",
}
NOT_CHECKS = {"clean", "format", "run"}


@pytest.mark.benchmarks
@pytest.mark.parametrize("target", QUICK)
def test_the_quick_form_of_a_target_runs_to_its_end(target: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, *QUICK[target]],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}"


def test_each_target_of_the_makefile_is_run_by_a_check() -> None:
    makefile = (REPOSITORY / "Makefile").read_text()
    (phony,) = re.findall(r"^\.PHONY: (.*)$", makefile, re.M)
    (marks,) = re.findall(r'-m "\(([\w ]+ or [\w ]+)\)', makefile)  # of make rest
    checked = set(re.findall(r"make ([\w-]+)", (REPOSITORY / ".ci" / "run").read_text()))
    checked |= {
        "docs-commands" if mark == "docs" else mark for mark in marks.split(" or ")
    }
    assert set(phony.split()) <= checked | set(QUICK) | set(ELSEWHERE) | NOT_CHECKS
