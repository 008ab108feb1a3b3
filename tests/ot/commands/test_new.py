"""``zswarm-ot new simulator``: a package that works as it is, from the example."""

import importlib
import re
import sys
import tomllib
from pathlib import Path

import pytest

from zswarm import experiment
from zswarm.ot import cli
from zswarm.ot.commands.new import EXAMPLE, FILES, skeleton

FOLDER = experiment.examples_folder() / "my_simulator"


def say(monkeypatch: pytest.MonkeyPatch, folder: Path, *arguments: str) -> int:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["zswarm-ot", *arguments])
    try:
        cli.main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def test_the_example_is_the_skeleton_of_its_own_name() -> None:
    assert skeleton(EXAMPLE) == {
        path.name: path.read_text() for path in FOLDER.iterdir() if path.suffix in FILES
    }


def test_a_new_simulator_is_the_example_with_another_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its own test passes, its experiment is one, and the steps that it names are for its files."""
    assert say(monkeypatch, tmp_path, "new", "simulator", "lost-robots") == 0
    made = tmp_path / "lost-robots"
    files = {
        "pyproject.toml",
        "lost_robots.py",
        "test_lost_robots.py",
        "lost-robots.toml",
    }
    assert {path.name for path in made.iterdir()} == files
    for path in made.iterdir():
        assert not re.search("my.?simulator", path.read_text(), re.I), path.name
    said = capsys.readouterr().out
    for step in (
        "cd lost-robots",
        "pip install -e .",
        "python -m pytest",
        "zswarm-ot check lost-robots.toml",
    ):
        assert step in said
    project = tomllib.loads((made / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["zswarm.simulators"] == {
        "lost-robots": "lost_robots:LostRobots"
    }
    assert experiment.load(made / "lost-robots.toml").problem.simulator == "lost-robots"
    monkeypatch.syspath_prepend(str(made))
    for module in ("lost_robots", "test_lost_robots"):  # gone again after this test
        monkeypatch.setitem(sys.modules, module, None)
        del sys.modules[module]
    tests = importlib.import_module("test_lost_robots")
    for name in dir(tests):
        if name.startswith("test_"):
            getattr(tests, name)()


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
