"""The measurement beside others works: real peers, rows, and a peer that is not there is named."""

import json
import struct
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.docs.documents import REPOSITORY

BENCHMARKS = REPOSITORY / "benchmarks"


@pytest.fixture(scope="module")
def dispatch() -> ModuleType:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import dispatch
    finally:
        sys.path.remove(str(BENCHMARKS))
    return dispatch


@pytest.mark.benchmarks
def test_zswarm_and_a_process_pool_are_measured_side_by_side(tmp_path: Path) -> None:
    names = ["zswarm", "ProcessPoolExecutor"]
    command = [
        sys.executable,
        BENCHMARKS / "dispatch.py",
        "--only",
        ",".join(names),
        "--folder",
        tmp_path,
    ]
    subprocess.run(
        [
            *command,
            "--rounds",
            "1",
            "--populations",
            "8",
            "--slots",
            "2",
            "--seconds",
            "0",
        ],
        check=True,
        timeout=120,
    )
    found = json.loads((tmp_path / "dispatch.json").read_text())
    assert {"machine", "versions", "when"} <= set(found)
    for name in names:
        rows = {
            row.get("work", "start"): row for row in found["rows"] if row["peer"] == name
        }
        assert set(rows) == {"start", "noop", "sleep", "cpu"}, rows
        assert rows["start"]["first_s"] > 0
        assert rows["start"]["tree_mb"] > 1
        assert 0 < rows["noop"]["us_least"] == rows["noop"]["us_most"]
        assert 0 < rows["sleep"]["efficiency"] <= 1


def test_an_answer_that_belongs_to_another_candidate_ends_the_measurement(
    dispatch: ModuleType,
) -> None:
    genomes = [struct.pack("<2f", number, 0.5) for number in range(8)]
    right = dispatch.Way(
        "",
        "1",
        lambda genomes, *_: [struct.unpack_from("<f", genome)[0] for genome in genomes],
    )
    swapped = dispatch.Way("", "1", lambda *asked: right.evaluate(*asked)[::-1])
    assert dispatch.checked(right, genomes, "noop", 2) > 0
    with pytest.raises(AssertionError, match="another's fitness"):
        dispatch.checked(swapped, genomes, "noop", 2)


def test_a_peer_that_could_not_be_installed_is_named_with_the_reason(
    dispatch: ModuleType, tmp_path: Path
) -> None:
    (tmp_path / "ray.refused").write_text(
        "ERROR: No matching distribution found for ray>=2.40\n"
    )
    assert (
        dispatch.why_not_installed("Ray", tmp_path)
        == "ERROR: No matching distribution found for ray>=2.40"
    )
    assert dispatch.why_not_installed("joblib (loky)", tmp_path) == ""


def test_rounds_are_summarized_by_their_median_and_failed_rounds_stay_separate(
    dispatch: ModuleType,
) -> None:
    noop = {
        "peer": "Ray",
        "slots": 2,
        "form": "tasks",
        "cut": "1",
        "work": "noop",
        "population": 50,
    }
    rows = [noop | {"us": us} for us in (150.0, 90.0, 100.0)] + [
        {"peer": "Ray", "slots": 2, "missing": "took more than 180 s"}
    ]
    assert dispatch.summary(rows) == [
        noop | {"us": 100.0, "us_least": 90.0, "us_most": 150.0},
        rows[-1],
    ]
