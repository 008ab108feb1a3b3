"""``zswarm-ot new simulator``: a package that works as it is, from the example."""

import importlib
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zswarm import experiment
from zswarm.evaluate import evaluate
from zswarm.kernels.jit import interpreted
from zswarm.kernels.random import Stream
from zswarm.ot import cli
from zswarm.ot.commands.new import COMPILED, EXAMPLE, FILES, skeleton
from zswarm.testing.rules import fully_meshed

FOLDER = experiment.examples_folder() / "my_simulator"


def say(monkeypatch: pytest.MonkeyPatch, folder: Path, *arguments: str) -> int:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["zswarm-ot", *arguments])
    try:
        cli._run()  # ``main`` ends the process
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def imported(monkeypatch: pytest.MonkeyPatch, folder: Path, *modules: str) -> list[Any]:
    """Import modules from a folder; after the test they are gone again."""
    monkeypatch.syspath_prepend(str(folder))
    for module in modules:
        monkeypatch.setitem(sys.modules, module, None)
        del sys.modules[module]
    return [importlib.import_module(module) for module in modules]


def test_the_example_is_the_skeleton_of_its_own_name() -> None:
    """The compiled one shares all but its module and a test."""
    plain = {
        path.name: path.read_text() for path in FOLDER.iterdir() if path.suffix in FILES
    }
    compiled = {path.name: path.read_text() for path in (FOLDER / COMPILED).glob("*.py")}
    assert skeleton(EXAMPLE) == plain
    assert skeleton(EXAMPLE, compiled=True) == plain | compiled
    assert set(compiled) == {"my_simulator.py", "test_my_simulator_kernel.py"}


@pytest.mark.parametrize("option", [[], ["--compiled"]], ids=["plain", "compiled"])
def test_a_new_simulator_is_the_example_with_another_name(
    option: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Its experiment is one, and the steps that it names are for its files."""
    assert say(monkeypatch, tmp_path, "new", "simulator", "lost-robots", *option) == 0
    made = tmp_path / "lost-robots"
    tests = ["test_lost_robots", *(["test_lost_robots_kernel"] if option else [])]
    files = {"README.md", "pyproject.toml", "lost_robots.py", "lost-robots.toml"}
    assert {path.name for path in made.iterdir()} == files | {f"{t}.py" for t in tests}
    for path in made.iterdir():
        assert not re.search("my.?simulator", path.read_text(), re.I), path.name
    said, page = capsys.readouterr().out, (made / "README.md").read_text()
    assert "cd lost-robots" in said
    for step in (
        "pip install -e . pytest",
        "python -m pytest",
        "zswarm-ot check lost-robots.toml",
        "zswarm-ot run lost-robots.toml",
        "zswarm-ot replay runs/lost-robots",
    ):
        assert step in said
        assert step in page
    project = tomllib.loads((made / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["zswarm.simulators"] == {
        "lost-robots": "lost_robots:LostRobots"
    }
    assert experiment.load(made / "lost-robots.toml").problem.simulator == "lost-robots"


def test_its_own_tests_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of a compiled one run in tests/integration/test_own_simulator.py."""
    assert say(monkeypatch, tmp_path, "new", "simulator", "lost-robots") == 0
    _, tests = imported(
        monkeypatch, tmp_path / "lost-robots", "lost_robots", "test_lost_robots"
    )
    for name in dir(tests):
        if name.startswith("test_"):
            getattr(tests, name)()


def test_both_skeletons_are_the_same_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same networks and seeds have the same outcomes, bit for bit, and so have pictures."""
    for name, compiled in (("plain_one", False), ("compiled_one", True)):
        text = skeleton(name.replace("_", "-"), compiled=compiled)[f"{name}.py"]
        (tmp_path / f"{name}.py").write_text(text)
    plain, compiled_one = imported(monkeypatch, tmp_path, "plain_one", "compiled_one")
    network = fully_meshed(2, 1)
    participants, seeds = np.arange(4)[:, None], np.arange(4, dtype=np.uint64)
    found = []
    with interpreted():
        for kind in (plain.PlainOne, compiled_one.CompiledOne):
            simulator = kind(kind.settings_type(robots=9, steps=20))
            genomes = network.random(4, Stream(1))
            played = evaluate(simulator, network, genomes, participants, seeds)
            assert not played.error
            simulator.reset(7)
            found.append(
                (played.fitness.tobytes(), played.metrics.tobytes(), simulator.frame())
            )
            assert len(np.unique(played.fitness)) == 4
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("minisim", "there is a simulator of that name"),
        ("json", "Python already has a module json"),
        ("lambda", "Python already has a module lambda"),
        ("numpy", "Python already has a module numpy"),
        ("turn", "its class would be Turn"),
        ("Lost", "expected a name of small letters"),
        ("lost_robots", "expected a name of small letters"),
        ("../lost", "expected a name of small letters"),
        ("", "expected a name of small letters"),
        ("2d", "expected a name of small letters"),
        ("lost-", "expected a name of small letters"),
        ("x" * 64, "expected a name of small letters"),
        ("there", "there: exists already"),
    ],
)
def test_an_impossible_name_is_refused_in_one_line(
    name: str,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "there").mkdir()
    assert say(monkeypatch, tmp_path, "new", "simulator", name) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
    assert not list((tmp_path / "there").iterdir())
