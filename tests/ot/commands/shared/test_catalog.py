"""``zswarm-ot list`` names the parts; ``describe`` says what each is and which settings it has."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from zswarm.config import settings_docs
from zswarm.errors import UnknownPlugin
from zswarm.ot.cli import command
from zswarm.ot.commands.shared import catalog as parts
from zswarm.plugins import registry as plugins

BUNDLED = [(kind, name) for kind in parts.KINDS for name in plugins.BUNDLED[kind]]
HEAVY = (
    "ribs",
    "cmaes",
    "scipy",
    "numba",
    "zenoh",
    "pettingzoo",
    "gymnasium",
    "vmas",
    "torch",
)
EVIL = """
import msgspec
from zswarm.sims.simulator import Simulator
class Settings(msgspec.Struct):
    length: int = 3
class Evil(Simulator):
    '''Clears \\x1b[2J the screen.

    Metrics: [bold]none[/bold], ``at
    all``.
    '''
    settings_type = Settings
    inputs = outputs = 1
    owners = (0,)
"""
POINTS = """[zswarm.simulators]
absent = swarm_nowhere:X
evil = swarm_evil:Evil
exits = swarm_exits:X
"""


def said(*arguments: str, cwd: Path, **environment: str) -> str:
    """Return what ``zswarm-ot`` prints."""
    environment = {"PYTHONPATH": os.pathsep.join(sys.path), "COLUMNS": "80"} | environment
    program = [sys.executable, "-m", "zswarm.ot", *arguments]
    done = subprocess.run(
        program,
        cwd=cwd,
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | environment,
    )
    return done.stdout


@pytest.fixture
def plugged(tmp_path: Path) -> Path:
    """A folder with plug-ins, of which one only can be imported."""
    information = tmp_path / "swarm_evil-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: swarm-evil\nVersion: 1.0\n"
    )
    (information / "entry_points.txt").write_text(POINTS)
    (tmp_path / "swarm_evil.py").write_text(EVIL)
    (tmp_path / "swarm_exits.py").write_text(
        "raise SystemExit('not on \x1b[31mthis machine')"
    )
    return tmp_path


@pytest.mark.parametrize(("kind", "name"), BUNDLED)
def test_every_bundled_part_has_a_one_line_description(
    kind: plugins.Kind, name: str
) -> None:
    part = parts.entry(kind, name)
    assert part.error == ""
    assert 20 < len(part.about) <= 130
    assert part.about.endswith(".")
    assert "module" not in part.about


def test_list_names_every_bundled_part(tmp_path: Path) -> None:
    shown = said("list", cwd=tmp_path)
    flat = " ".join(shown.split())
    for kind in parts.KINDS:
        assert f"{kind}s {', '.join(plugins.BUNDLED[kind])} " in flat
    assert len(shown.splitlines()) < 30, "it fits a screen"
    found = json.loads(said("list", "--json", cwd=tmp_path))
    assert {(part["kind"], part["name"]) for part in found["parts"]} >= set(BUNDLED)
    assert set(found["rankings"]) >= set(plugins.BUNDLED["ranking"])


def test_a_list_loads_neither_compiler_nor_other_libraries(tmp_path: Path) -> None:
    """Which take seconds: optimizers import theirs when they are used."""
    code = "import sys; sys.argv = ['x', 'list']; from zswarm.ot import cli; "
    code += "cli.command(standalone_mode=False); print(); "
    code += f"print({set(HEAVY)} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == "set()"


def test_a_description_has_the_data_sheet_and_every_setting(tmp_path: Path) -> None:
    shown = " ".join(said("describe", "light", cwd=tmp_path).split())
    assert "light, simulator: A robot on two wheels finds a light" in shown
    assert "Turns: the robot. In a step of" in shown
    assert (
        "exactly as FREVO's Light. FREVO is at github.com/smartgrids-aau/Frevo" in shown
    ), "the module's text, too"
    assert "metrics found, steps, distance, x, y sensors light_left, light_right" in shown
    assert "heading_seed int, 0 to 2^48 - 1 1 seed of the generator" in shown
    assert shown.count("A setting may be a range") == 1
    assert "may be a range" not in said("describe", "nnga", cwd=tmp_path), (
        "settings of the problem alone"
    )
    (described,) = json.loads(said("describe", "nnga", "--json", cwd=tmp_path))["parts"]
    sheet = settings_docs.keys(plugins.load("optimizer", "nnga").settings_type)
    assert [setting["name"] for setting in described["settings"]] == [
        key.name for key in sheet
    ]
    assert described["settings"][0] == {
        "name": "population",
        "type": "int, 2 to 1,000,000",
        "default": 50,
        "required": False,
        "meaning": "individuals of an island",
    }
    assert (described["portable"], described["competes"]) == (True, True)


@pytest.mark.parametrize("columns", [80, 40])
def test_lists_and_descriptions_fit_the_terminal(
    columns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A long default may exceed 40 columns."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", str(columns))
    for arguments in (
        ["list"],
        *(
            ["describe", name]
            for name in ("minisim", "nnga", "xor", "swiss", "fully-meshed")
        ),
    ):
        shown = CliRunner().invoke(command, arguments, catch_exceptions=False).output
        assert shown
        for line in shown.splitlines():
            assert (
                len(line.rstrip()) <= columns
                or len(max(line.split(), key=len)) > columns - 24
            )


def test_plugins_that_cannot_be_imported_are_reported_in_separate_lines(
    plugged: Path,
) -> None:
    """Their messages are shown without escapes, and all other plug-ins are listed."""
    path = os.pathsep.join([str(plugged), *sys.path])
    shown = said("list", cwd=plugged, PYTHONPATH=path)
    flat = " ".join(shown.split())
    assert (
        "absent (simulator) simulator 'absent' cannot be imported: ModuleNotFoundError: "
        "No module named 'swarm_nowhere'" in flat
    )
    assert (
        r"exits (simulator) simulator 'exits' cannot be imported: SystemExit: "
        r"not on \x1b[31mthis machine" in flat
    )
    assert r"evil (simulator) Clears \x1b[2J the screen. settings: length=3" in flat
    assert "turtlebot-exit-ros, vmas, xor" in flat
    assert all(line.isprintable() for line in shown.splitlines())
    described = said("describe", "evil", cwd=plugged, PYTHONPATH=path)
    assert "Metrics: [bold]none[/bold], at all." in described
    assert all(line.isprintable() for line in described.splitlines())


def test_an_unknown_part_is_reported_with_the_nearest_name() -> None:
    with pytest.raises(
        UnknownPlugin,
        match="xor-neat is not a part but an example; zswarm-ot check xor-neat explains it",
    ):
        parts.find("xor-neat")
    with pytest.raises(
        UnknownPlugin, match=r"no part is named 'nng' \(did you mean 'nnga'\?\)"
    ):
        parts.find("nng")


def test_all_parts_of_a_name_are_found() -> None:
    for kind, name in BUNDLED:
        assert kind in [part.kind for part in parts.find(name)]
