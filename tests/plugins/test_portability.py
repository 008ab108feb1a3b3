"""The source of a simulator is searched for what has other bits on other machines."""

import importlib
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from zswarm.plugins import registry
from zswarm.plugins.portability import findings
from zswarm.testing import PortabilityWarning, check_simulator

Write = Callable[..., Any]
HEAD = "import math, random\nimport numpy as np\nfrom numpy import linalg\n"


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Write]:
    """Write modules of a package ``flock``; return the class ``Flock`` of the first."""
    monkeypatch.syspath_prepend(tmp_path)

    def written(**modules: str) -> Any:
        folder = tmp_path / "flock"
        folder.mkdir()
        folder.joinpath("__init__.py").touch()
        for name, text in modules.items():
            folder.joinpath(f"{name}.py").write_text(text)
        return importlib.import_module(f"flock.{next(iter(modules))}").Flock

    yield written
    for name in [name for name in sys.modules if name.partition(".")[0] == "flock"]:
        del sys.modules[name]


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        (
            "way = np.sum(moves)",
            "np.sum adds floats in no fixed order; use ordered_sum or mean",
        ),
        ("way = moves.mean()", ".mean() adds floats"),
        ("way = (moves * moves).sum(axis=1)", ".sum() adds floats"),
        ("way = list(map(np.mean, moves))", "np.mean adds floats"),
        ("way = sum(moves)", "sum adds floats differently from Python 3.12 on"),
        (
            "way = moves @ moves",
            "@ adds floats in no fixed order; write the sum of products",
        ),
        ("moves @= moves", "@ adds floats"),
        ("way = moves.dot(moves)", ".dot() adds floats"),
        (
            "way = np.linalg.norm(moves)",
            "np.linalg.norm adds floats in no fixed order; use norm",
        ),
        ("way = linalg.solve(moves, moves)", "np.linalg.solve has other bits"),
        (
            "way = np.random.default_rng(1)",
            "np.random.default_rng may change with its version",
        ),
        (
            "way = random.gauss(0, 1)",
            "random.gauss is not seeded by the trial, and may change with its version; draw",
        ),
        (
            "way = np.sin(moves)",
            "np.sin has other last bits on other machines; use sin of",
        ),
        (
            "way = math.hypot(1, 2)",
            "math.hypot has other last bits on other machines; use norm",
        ),
        (
            "way = np.tan(moves)",
            "np.tan has other last bits on other machines; use functions of",
        ),
        ("way = moves ** 0.5", "** 0.5 has other last bits"),
        ("way = np.sqrt(moves) + np.abs(moves) / math.pi", ""),
        ("way = int(np.sum(moves))", ""),
        ("way = (moves < 2).sum() + np.sum((moves < 2) & (moves > 1))", ""),
        ("way = sum(1 for move in moves) + sum(move < 2 for move in moves)", ""),
        ("way = np.sum(moves)  # portable: these are whole numbers", ""),
        ("way = np.cumsum(moves)[-1]", ""),
        ("way = moves ** 2", ""),
        ("np.random.seed(moves)", ""),
    ],
)
def test_a_line_is_found_with_what_to_use_instead(
    line: str, wrong: str, write: Write
) -> None:
    text = f"{HEAD}class Flock:\n    def step(self, moves):\n        {line}\n"
    found = findings(write(flock=text))
    assert [each.line for each in found] == ([6] if wrong else [])
    assert all(each.text.startswith(wrong) for each in found)
    assert all(each.file.name == "flock.py" for each in found)


def test_what_the_class_reaches_is_read_and_nothing_else(write: Write) -> None:
    """Functions, base classes and constants of other modules count; tests and pictures do not."""
    first = (
        "import numpy as np\nfrom . import rules\nfrom flock.table import TABLE as T, Base\n"
        "class Flock(Base):\n    def step(self, moves):\n        return rules.act(moves) + T\n"
        "    def frame(self):\n        return np.sin(1.0)\n"
        "def analyse(moves):\n    return np.mean(moves)\n"
    )
    rules = (
        "import numpy as np\ndef act(moves):\n    return far(moves)\n"
        "def far(moves):\n    return moves @ moves\ndef other(moves):\n    return np.std(moves)\n"
    )
    table = (
        "import numpy as np\nTABLE = np.exp(np.arange(3.0))\nclass Base:\n    def far(self):\n"
        "        return np.cos(1.0)\nrest = np.sum(TABLE)\n"
    )
    found = findings(write(first=first, rules=rules, table=table))
    assert [(each.file.name, each.line) for each in found] == [
        ("rules.py", 5),
        ("table.py", 2),
        ("table.py", 5),
    ]


@pytest.mark.parametrize("name", sorted(registry.BUNDLED["simulator"]))
def test_bundled_simulators_raise_no_false_alarm(name: str) -> None:
    assert findings(registry.load("simulator", name)) == []


def test_the_example_raises_no_false_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    folder = Path(__file__).parents[2] / "examples" / "my_simulator"
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setitem(sys.modules, "my_simulator", None)  # gone again after this test
    del sys.modules["my_simulator"]
    assert findings(importlib.import_module("my_simulator").MySimulator) == []


GATHER = """
import msgspec
import numpy as np
from zswarm.kernels.random import Stream
from zswarm.sims.simulator import Outcome, Simulator, Turn

class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    steps: int = 5

class Flock(Simulator):
    settings_type = Settings
    inputs, outputs, owners = 1, 1, (0, 0, 0)

    def reset(self, seed):
        self.x, self.left = Stream(seed).uniform(0.0, 10.0, 3), self.settings.steps
        return self.turn()

    def step(self, actions):
        self.x, self.left = self.x + actions[:, 0] - 0.5, self.left - 1
        return self.turn() if self.left > 0 else None

    def outcome(self):
        return Outcome([-float(np.abs(self.x - np.mean(self.x)).max())], [])

    def turn(self):
        return Turn(range(3), self.x[:, None].astype(np.float32))
"""


def test_check_simulator_warns_at_the_line_unless_no_bits_are_promised(
    write: Write,
) -> None:
    flock = write(flock=GATHER)
    with pytest.warns(PortabilityWarning, match=r"np\.mean adds floats") as caught:
        check_simulator(flock)
    (warning,) = caught
    assert Path(warning.filename).name == "flock.py"
    assert GATHER.splitlines()[warning.lineno - 1].endswith(
        "np.mean(self.x)).max())], [])"
    )
    flock.repeatable = False
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_simulator(flock)
