"""A generation of large genomes is written at most twice, in little memory."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "large_genomes.py"


@pytest.mark.thorough
def test_large_genomes_are_written_once_in_little_memory(tmp_path: Path) -> None:
    arguments = [sys.executable, str(SCRIPT), "200", "100000", "2", "nnga", "all"]
    done = subprocess.run(
        arguments, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    numbers = json.loads(done.stdout)
    assert numbers["genomes_mb"] > 80
    assert numbers["written"] <= 2.0
    # 390; half a generation more while the disk is behind; one copied would be 80 more
    assert numbers["memory_mb"] < 455
