"""The measurement beside others works: real peers, a table, and a peer that is not there is named."""

import json
import struct
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture(scope="module")
def dispatch() -> ModuleType:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import dispatch
    finally:
        sys.path.remove(str(BENCHMARKS))
    return dispatch


def test_zswarm_and_a_process_pool_are_measured_side_by_side(tmp_path: Path) -> None:
    names = ["zswarm (TCP)", "ProcessPoolExecutor"]
    command = [sys.executable, BENCHMARKS / "dispatch.py", "--only", ",".join(names), "--out", tmp_path / "peers.json"]
    subprocess.run([*command, "--rounds", "1", "--population", "8", "--slots", "2", "--warm-s", "0"], check=True, timeout=120)
    found = json.loads((tmp_path / "peers.json").read_text())
    for name in names:
        measured = found["rounds"][0][name]
        assert measured["first_s"] > 0, measured
        assert all(way["noop_us"] > 0 and 0 < way["efficiency"] <= 1 for way in measured["ways"])
    assert [way["chunk"] for way in found["rounds"][0]["ProcessPoolExecutor"]["ways"]] == [1, 25, 100]
    table = (tmp_path / "peers.md").read_text()
    assert "| zswarm (TCP) | a daemon, by TCP | by itself |" in table
    assert "not measured" not in table


def test_an_answer_that_belongs_to_another_candidate_ends_the_measurement(dispatch: ModuleType) -> None:
    genomes = [struct.pack("<2f", number, 0.5) for number in range(8)]
    right = dispatch.Way("", 1, lambda genomes, _: [struct.unpack_from("<f", genome)[0] for genome in genomes])
    swapped = dispatch.Way("", 1, lambda genomes, sleeping: right.evaluate(genomes, sleeping)[::-1])
    assert dispatch.checked(right, genomes, False) > 0
    with pytest.raises(AssertionError, match="another's fitness"):
        dispatch.checked(swapped, genomes, False)


def test_a_peer_that_could_not_be_installed_is_named_with_the_reason(
    dispatch: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def answer(first_s: float, noop_us: float) -> dict:
        return {"first_s": first_s, "ways": [{"form": "map", "chunk": 1, "noop_us": noop_us, "efficiency": 0.9}]}

    monkeypatch.setattr(dispatch, "BUILD", tmp_path)
    (tmp_path / "peers").mkdir()
    (tmp_path / "peers" / "ray.refused").write_text("ERROR: No matching distribution found for ray>=2.40\n")
    missing = {"missing": dispatch.why_not_installed("Ray")}
    rounds = [
        {"load": 0.0, "zswarm": answer(1.0, 10.0), "ProcessPoolExecutor": answer(0.1, noop), "Ray": missing}
        for noop in (90.0, 100.0, 150.0)
    ]
    text = dispatch.markdown({"machine": "2 cores", "versions": {}, "population": 400, "slots": 4, "rounds": rounds})
    assert "- Ray: not measured in 3 of 3 rounds: ERROR: No matching distribution found for ray>=2.40" in text
    assert "| ProcessPoolExecutor | map | 1 | 100 (90.0 to 150) | 10.0 | .900 (.900 to .900) | 0.1 (0.1 to 0.1) |" in text
