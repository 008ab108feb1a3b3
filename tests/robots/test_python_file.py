"""A controller as a Python file: numpy alone, the same bits."""

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.robots.controllers import KINDS, controller, named, observed
from zswarm.champion.controller import Controller
from zswarm.errors import ConfigError
from zswarm.robots.c import kernel_source
from zswarm.robots.python_file import python

DEBIAN = Path("/usr/bin/python3")
STEPS = 60
# Runs observations through every file of a folder, in an interpreter without zswarm.
PLAY = """
import importlib, json, pathlib, sys
numpy, folder = sys.argv[1:]
sys.path += [path for path in (numpy, folder) if path]
sys.modules["zswarm"] = sys.modules["numba"] = None
import numpy as np
played = {}
for file in sorted(pathlib.Path(folder).glob("zs_*.py")):
    module = importlib.import_module(file.stem)
    controller = module.Controller()
    seen = np.frombuffer(file.with_suffix(".seen").read_bytes(), "<f4")
    seen = seen.reshape(-1, controller.inputs)
    acted = [controller.act(one).tobytes().hex() for one in seen]
    controller.reset()
    again = controller.act(seen[0]).tobytes().hex()
    played[file.stem] = [module.selftest(), acted, again == acted[0]]
json.dump(played, sys.stdout)
"""


def exported(folder: Path, steps: int = STEPS) -> dict[str, list[str]]:
    """Files of all kinds of controllers, and what each decides."""
    decided = {}
    for number, kind in enumerate(KINDS):
        evolved = controller(*kind, seed=number)
        for name, text in python(evolved, f"{number:02}").items():
            (folder / name).write_text(text)
        seen, driver = observed(evolved.inputs, steps), evolved.driver()
        (folder / f"zs_{number:02}.seen").write_bytes(seen.tobytes())
        decided[f"zs_{number:02}"] = [driver.act(one).tobytes().hex() for one in seen]
    return decided


def played(interpreter: str | Path, folder: Path, numpy: str = "") -> Any:
    flags = ["-I", *(["-S"] if numpy else []), "-W", "error"]
    command = [interpreter, *flags, "-c", PLAY, numpy, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_files_give_the_same_bits_without_zswarm(tmp_path: Path) -> None:
    decided = exported(tmp_path)
    found = played(sys.executable, tmp_path, str(Path(np.__file__).parents[1]))
    assert found == {name: [0, acted, True] for name, acted in decided.items()}
    assert all(len(set(acted)) > 1 for acted in decided.values())


@pytest.mark.robots
def test_an_older_numpy_decides_the_same_bits(tmp_path: Path) -> None:
    """Debian's, whose numbers of one element become wider beside Python's."""
    if (
        not DEBIAN.exists()
        or subprocess.run(
            [DEBIAN, "-c", "import numpy"], capture_output=True, check=False
        ).returncode
    ):
        pytest.skip(
            "needs the system's own Python with numpy (Debian: apt install python3-numpy)"
        )
    decided = exported(tmp_path, 300)
    assert played(DEBIAN, tmp_path) == {
        name: [0, acted, True] for name, acted in decided.items()
    }


@pytest.mark.parametrize("kind", KINDS, ids=named)
def test_a_file_is_of_old_python_and_always_the_same(
    kind: tuple[str, dict[str, Any]],
) -> None:
    ((name, text),) = python(controller(*kind), "x").items()
    assert name == "zs_x.py"
    ast.parse(text, feature_version=(3, 8))
    assert text == python(controller(*kind), "x")["zs_x.py"]
    assert text.isascii()


def run(file: Path) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-I", file], capture_output=True, text=True, check=False
    )


def test_a_file_checks_itself_and_detects_a_changed_number(tmp_path: Path) -> None:
    """The number is one of the parameters, or one that changes what is decided."""
    text = python(controller("ctrnn"), "mine")["zs_mine.py"]
    file = tmp_path / "zs_mine.py"
    file.write_text(text)
    done = run(file)
    assert (done.returncode, done.stdout, done.stderr) == (
        0,
        "zs_mine: 16 of 16 steps have the same bits\n",
        "",
    )
    for changed in (
        text.replace("PARAMETERS = ", "PARAMETERS = np.float32(1.0000001) * "),
        text.replace("HALF = np.float32(0.5)", "HALF = np.float32(0.50001)"),
    ):
        assert changed != text
        file.write_text(changed)
        done = run(file)
        assert done.returncode == 1
        assert "16 of 16" not in done.stdout


@pytest.mark.parametrize(
    "hostile",
    ['"""; import os; os.abort()  #', "@PARAMETERS@", "\\", "x\n1/0", "größe ☃ \u202e"],
)
def test_hostile_names_stay_texts(hostile: str, tmp_path: Path) -> None:
    texts = {
        "run": hostile,
        "simulator": hostile,
        "sensors": [hostile] * 4,
        "actuators": [hostile] * 3,
    }
    evolved: Controller = msgspec.structs.replace(controller("fully-meshed"), **texts)
    file = tmp_path / "zs_x.py"
    file.write_text(python(evolved, "x")["zs_x.py"])
    assert run(file).returncode == 0
    found: dict[str, Any] = {"__name__": "zs_x"}
    exec(compile(file.read_text(), "zs_x.py", "exec"), found)  # noqa: S102  our own text
    assert {key: found[key.upper()] for key in texts} == texts


def test_a_wrong_observation_is_refused(tmp_path: Path) -> None:
    found: dict[str, Any] = {"__name__": "zs_x"}
    exec(compile(python(controller("ctrnn"), "x")["zs_x.py"], "zs_x.py", "exec"), found)  # noqa: S102  our own text
    with pytest.raises(ValueError, match=r"expected shape \(4,\), not \(5,\)"):
        found["Controller"]().act([0.0] * 5)


# ---- gathering

LIMIT, TABLE, WORD = 2.5, np.array([1.0, np.inf]), "text"


def limited(x):  # type: ignore[no-untyped-def]
    return min(x, LIMIT) + TABLE[0]


def worded(x):  # type: ignore[no-untyped-def]
    return x + WORD


def missing(x):  # type: ignore[no-untyped-def]
    return x + nowhere  # type: ignore[name-defined]  # noqa: F821


def test_collected_functions_include_their_dependencies() -> None:
    text = kernel_source.functions([limited])
    found: dict[str, Any] = {"np": np}
    exec(text, found)  # noqa: S102  our own text
    assert (found["limited"](1.0), found["limited"](7.0)) == (2.0, 3.5)
    assert found["TABLE"][1] == np.inf


@pytest.mark.parametrize(
    ("function", "why"),
    [
        (worded, "worded uses WORD, of type str: only functions, numbers and arrays"),
        (missing, "missing uses nowhere, which is not defined"),
        (lambda x: x, "expected a function on the top level of a module"),
        (len, "its source cannot be read"),
    ],
)
def test_functions_that_cannot_be_collected_are_named(function: Any, why: str) -> None:
    with pytest.raises(ConfigError) as raised:
        kernel_source.functions([function])
    assert why in str(raised.value)
