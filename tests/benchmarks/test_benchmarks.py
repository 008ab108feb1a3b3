"""docs/benchmarks.md shows results, gives reasons for missed targets; ratios find regressions."""

import copy
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.docs.documents import REPOSITORY

BENCHMARKS = REPOSITORY / "benchmarks"
RESULTS = BENCHMARKS / "results.json"
SCRIPTS = (
    "bench",
    "commands",
    "dispatch",
    "methods",
    "many_servers",
    "page",
    "populations",
    "ratios",
    "runs",
    "scaling",
    "startup",
)
ABOUT = {
    "when": "2026-01-01 00:00 UTC",
    "machine": {
        "cores": 2,
        "cpu": "a core",
        "gib": 24,
        "system": "Linux",
        "python": "3.11",
        "load": 0.1,
    },
    "versions": {"zswarm": "0.1.0"},
}


def load(name: str) -> Any:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        return __import__(name)
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope="module")
def page() -> ModuleType:
    return load("page")


@pytest.fixture(scope="module")
def ratios() -> ModuleType:
    return load("ratios")


def row(peer: str, work: str, slots: int, value: float, cut: str = "1") -> dict[str, Any]:
    what = "us" if work == "noop" else "efficiency"
    of = {
        "peer": peer,
        "slots": slots,
        "form": "map",
        "cut": cut,
        "work": work,
        "population": 400,
    }
    return of | {what: value, f"{what}_least": value, f"{what}_most": value}


@pytest.fixture
def results() -> dict[str, Any]:
    """Return results in which every measured target is met."""
    dispatch = [
        row("zswarm", "noop", 4, 5.0, "automatic"),
        row("Ray", "noop", 4, 600.0),
        row("Ray", "noop", 4, 30.0, "1 per worker"),
        {
            "peer": "Dask distributed",
            "slots": 4,
            "missing": "No module named 'distributed'",
        },
        *(row("zswarm", "sleep", slots, 0.96, "automatic") for slots in (2, 4, 8, 16)),
        row("Ray", "sleep", 4, 0.7),
    ]
    kernels = [
        {
            "kernel": "arena-aggregation",
            "variant": variant,
            "agents": 8,
            "agent_steps_per_s": rate,
        }
        for variant, rate in (("numba", 6e6), ("C", 7e6), ("pymunk", 4e4))
    ]
    kernels.append(
        {
            "kernel": "arena-aggregation",
            "variant": "vmas flocking",
            "agents": 8,
            "missing": "vmas is not there",
        }
    )
    startup = [
        {
            "what": "first result",
            "of": "zswarm-ot run",
            "how": "warm",
            "s": 0.6,
            "s_least": 0.5,
            "s_most": 0.7,
        }
    ]
    startup += [
        {"what": "memory", "of": "slot", "own_mb": 30.0, "pss_mb": 40.0, "processes": 4}
    ]
    return {
        "dispatch": ABOUT | {"rows": dispatch, "rounds": 3},
        "kernels": ABOUT | {"rows": kernels},
        "startup": ABOUT | {"rows": startup},
    }


def test_the_page_and_the_readme_show_the_results(page: ModuleType) -> None:
    results = json.loads(RESULTS.read_text())
    advice = "run: python benchmarks/page.py"
    assert (REPOSITORY / "docs" / "benchmarks.md").read_text() == page.document(
        results
    ), advice
    readme = (REPOSITORY / "README.md").read_text()
    assert readme == page.beside(results, readme), advice


def test_the_page_reports_met_targets_missing_tools_and_the_machine(
    page: ModuleType, results: dict[str, Any]
) -> None:
    text = page.document(results)
    assert (
        "| no-op, 400 candidates, 4 slots: us per candidate | at most 5.0 | 5.0 | met |"
        in text
    )
    times = "| 400 candidates, 4 slots: times faster than"
    assert f"{times} Ray | at least 25.0 | 120 | met |" in text
    assert f"{times} Dask distributed | at least 40.0 |  | not measured |" in text
    assert "- Dask distributed: not measured: No module named 'distributed'\n" in text
    assert (
        "| arena-aggregation, 8 agents: time relative to tuned C | at most 1.25 | 1.17 | met |"
        in text
    )
    assert "- arena-aggregation, vmas flocking: not measured: vmas is not there\n" in text
    assert "2 cores of a core, 24 GiB, Linux, Python 3.11" in text
    assert not re.search(r"^\{\w+\}$", text, re.M)


def test_a_missed_target_without_a_reason_makes_no_page(
    page: ModuleType,
    results: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If the reason is given, the page states it and the factor of the miss."""
    results["dispatch"]["rows"][0]["us"] = 25.0
    shutil.copy(BENCHMARKS / "page.md", tmp_path)
    monkeypatch.setattr(page, "HERE", tmp_path)
    (tmp_path / "missed.toml").write_text("noop-Ray = 'Ray became faster.'\n")
    with pytest.raises(SystemExit, match=r"'noop' \(no-op, 400 candidates.*25\.0\)$"):
        page.document(results)
    (tmp_path / "missed.toml").write_text(
        "noop = 'The machine was busy.'\nnoop-Ray = 'Ray became faster.'\n"
    )
    text = page.document(results)
    assert "| at most 5.0 | 25.0 | missed by a factor of 5.00 |" in text
    assert (
        "- **no-op, 400 candidates, 4 slots: us per candidate**: The machine was busy.\n"
        in text
    )


def test_the_readme_has_the_medians_of_the_measured_tools(
    page: ModuleType, results: dict[str, Any]
) -> None:
    before = (
        "| zswarm | 1.0 | .5 | yes |\n| Ray | 1,246 | .10 | no |\n"
        "| Dask distributed | 1,000 | .20 | no |\n"
    )
    after = (
        "| zswarm | 5.0 | .960 | yes |\n| Ray | 600 | .700 | no |\n"
        "| Dask distributed | 1,000 | .20 | no |\n"
    )
    assert page.beside(results, before) == after


@pytest.mark.benchmarks
def test_charts_are_drawn_for_measured_parts_only(
    page: ModuleType, results: dict[str, Any], tmp_path: Path
) -> None:
    page.charts.draw(results, tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "bench-dispatch.png",
        "bench-kernels.png",
    ]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in tmp_path.iterdir())


def test_a_learning_curve_is_the_best_after_each_evaluation_and_depends_on_the_seed_alone() -> (
    None
):
    methods = load("methods")
    (_, curve), (_, again), (_, other) = (
        methods.learn(methods.Run("xor", "nnga", seed, 120)) for seed in (1, 1, 2)
    )
    assert len(curve) == 120
    assert (np.diff(curve) >= 0).all()
    assert curve[-1] > curve[0]
    assert curve.tolist() == again.tolist() != other.tolist()


def test_a_value_of_zero_is_missed_by_no_factor() -> None:
    assert load("aims").Aim("key", "what", 0.6, True, 0.0).row[-1] == "missed"


@pytest.mark.benchmarks
def test_methods_are_compared_after_the_same_number_of_evaluations(
    page: ModuleType, tmp_path: Path
) -> None:
    """Methods appear in the table, with their speed against random search, and in the charts."""
    methods = load("methods")
    curves = {"random": np.linspace(0.0, 1.0, 1000), "steep": np.linspace(0.0, 4.0, 1000)}
    spread = np.array([[0.0], [0.1], [0.2]])
    rows = [
        methods.row(task, name, curve + spread)
        for task in methods.TASKS
        for name, curve in curves.items()
    ]
    results = {"methods": ABOUT | {"rows": rows, "seeds": 3}}
    text = page.document(results)
    assert "| method | stadium, 1,000 | random's after | xor, 1,000 |" in text
    assert re.search(r"^\| random \| 1\.1 \(1\.05 to 1\.15\) \| 1,000 \|", text, re.M)
    (steep,) = re.findall(r"^\| steep \| 4\.1 \(4\.05 to 4\.15\) \| (\d+) \|", text, re.M)
    assert 250 <= int(steep) < 300
    page.charts.draw(results, tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {
        f"bench-methods-{task}.png" for task in methods.TASKS
    }


def test_parts_measured_again_replace_old_ones_and_others_stay(
    results: dict[str, Any], tmp_path: Path
) -> None:
    file, bench = tmp_path / "results.json", load("bench")
    file.write_text(json.dumps(results))
    (tmp_path / "kernels.json").write_text(json.dumps(ABOUT | {"rows": []}))
    bench.merged(["kernels", "scale"], tmp_path, file)
    assert json.loads(file.read_text()) == copy.deepcopy(results) | {
        "kernels": ABOUT | {"rows": []}
    }


def test_a_ratio_that_got_worse_by_more_than_its_tolerance_is_found(
    ratios: ModuleType,
) -> None:
    kept = {
        "a": {"ratio": 10.0, "tolerance": 0.2},
        "b": {"ratio": 1.0, "tolerance": 0.1},
        "gone": {"ratio": 1.0, "tolerance": 0.1},
    }
    found = ratios.compared(kept, {"a": 7.9, "b": 0.91, "new": 3.0})
    assert [(ratio.name, ratio.worse) for ratio in found] == [
        ("a", True),
        ("b", False),
        ("new", False),
    ]
    assert [str(ratio) for ratio in found] == [
        "WORSE  a: 7.9, kept 10, tolerance 20%",
        "ok     b: 0.91, kept 1, tolerance 10%",
        "new    new: 3",
    ]


def test_renewed_ratios_keep_their_tolerances(ratios: ModuleType) -> None:
    kept = {
        "a": {"ratio": 10.0, "tolerance": 0.5},
        "other machine's": {"ratio": 1.0, "tolerance": 0.1},
    }
    assert ratios.renewed(kept, {"a": 12.3456, "b": 2.0}) == kept | {
        "a": {"ratio": 12.3, "tolerance": 0.5},
        "b": {"ratio": 2.0, "tolerance": ratios.TOLERANCE},
    }


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_help_of_a_script_names_it_and_its_defaults(script: str) -> None:
    said = subprocess.run(
        [sys.executable, BENCHMARKS / f"{script}.py", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert script in said.stdout
    assert "default" in said.stdout
