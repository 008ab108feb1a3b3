"""``zswarm-ot export``: which controller, which files, and what is refused."""

import json
import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import click
import msgspec
import pytest
from click.testing import CliRunner, Result

from tests.evaluated_record import played
from tests.repository import REPOSITORY
from tests.robots.controllers import controller
from zswarm import experiment
from zswarm.champion.controller import CHAMPION, load_controller
from zswarm.errors import ConfigError
from zswarm.ot import cli
from zswarm.ot.problem import Problem
from zswarm.ot.record import selection
from zswarm.ot.record.reader import Run
from zswarm.robots import folder, targets


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its champion is the best of its last generation."""
    folder = played(tmp_path_factory.mktemp("runs"))
    recorded = Run(folder)
    best = max(recorded.candidates(1), key=lambda row: row["fitness"])
    champion = Problem(recorded.experiment).controller(
        best["genome"], best["fitness"], "minisim-0123abcd"
    )
    (folder / CHAMPION).write_bytes(msgspec.msgpack.encode(champion))
    return folder


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def typed(*arguments: str | Path) -> Result:
    return CliRunner().invoke(
        cli.command, ["export", *map(str, arguments)], catch_exceptions=False
    )


def refused(*arguments: str | Path) -> str:
    """Return the one line that a mistake ends with."""
    with pytest.raises(ConfigError) as raised:
        typed(*arguments)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_the_champion_is_written_and_the_next_command_works(run: Path) -> None:
    done = typed(run, "--to", "python")
    assert done.exit_code == 0
    lines = done.output.replace("\n" + " " * 12, " ")  # what was wrapped
    file, of, parameters, on = lines.splitlines()
    name = f"zs_{run.name}"
    assert file == f"{run.name}-python/{name}.py"
    assert (
        of
        == f"controller  of minisim-0123abcd, fitness {load_controller(run).in_search()}, "
        "fully-meshed"
    )
    assert parameters.split()[-1] in Path(file).read_text()
    command = on.removeprefix("next").strip().replace("python3", sys.executable)
    said = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)  # noqa: S602  what a user types
    assert said.stdout == f"{name}: 16 of 16 steps have the same bits\n"


@pytest.mark.parametrize(
    "target",
    [
        name
        for name, target in targets.TARGETS.items()
        if not target.driving and not target.simulator
    ],
)
def test_every_target_names_its_files_and_the_hash(target: str, run: Path) -> None:
    """The hash is the same in the output and in the files."""
    done = typed(
        run, "--to", target, "--json", "--out", "deep/below", "--name", "My Robot"
    )
    told = json.loads(done.output)
    assert {**told, "files": [], "sha256": ""} == {
        "target": target,
        "name": "zs_my_robot",
        "folder": "deep/below",
        "files": [],
        "run": "minisim-0123abcd",
        "fitness": load_controller(run).fitness,
        "trials": load_controller(run).trials,
        "sha256": "",
    }
    assert sorted(told["files"]) == sorted(
        path.name for path in Path("deep/below").iterdir() if path.name != folder.LIST
    )
    contents = b"".join(Path("deep/below", file).read_bytes() for file in told["files"])
    assert told["sha256"].encode() in contents


def test_help_and_documents_name_every_target() -> None:
    said = CliRunner().invoke(cli.command, ["export", "--help"]).output
    docs = REPOSITORY / "docs"
    for target in targets.TARGETS:
        assert re.search(rf"^ +{target}  ", said, re.M), (
            f"zswarm-ot export --help: {target} is missing"
        )
        for page in ("export.md", "commands.md"):
            assert f"`{target}`" in (docs / page).read_text(encoding="utf-8"), (
                f"docs/{page}: {target} is missing"
            )


def test_another_candidate_is_named_as_in_replay(run: Path) -> None:
    """Its genome and fitness are those of the record, all else is the champion's."""
    rows, champion = (
        [Run(run).candidates(generation) for generation in (0, 1)],
        load_controller(run),
    )
    for given, row in (
        ((1, 2), rows[1][2]),
        ((0, None), max(rows[0], key=lambda row: row["fitness"])),
        ((None, None), max(rows[1], key=lambda row: row["fitness"])),
    ):
        found = selection.controller(run, *given)
        assert found == msgspec.structs.replace(
            champion, genome=row["genome"], fitness=row["fitness"]
        )
    told = json.loads(
        typed(
            run, "--to", "json", "--json", "--generation", "1", "--candidate", "3"
        ).output
    )
    assert told["fitness"] == rows[0][3]["fitness"]


def test_a_champion_file_alone_can_be_exported(run: Path, tmp_path: Path) -> None:
    alone = tmp_path / "mine.zsc"
    alone.write_bytes((run / CHAMPION).read_bytes())
    assert typed(alone, "--to", "json").exit_code == 0
    assert Path("minisim_0123abcd-json/zs_minisim_0123abcd.json").is_file()
    assert "take a run's folder" in refused(alone, "--to", "json", "--candidate", "0")


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (
            ["--to", "pyhton"],
            "--to pyhton: unknown target (did you mean 'python'?); known are: ",
        ),
        (
            ["--to", "json", "--generation", "9"],
            "no generation 9; it has generations 1 to 2",
        ),
        (["--to", "json", "--candidate", "-1"], "it has candidates 0 to 3"),
        (
            ["--to", "json", "--profile", "turtlebot3"],
            "--profile turtlebot3: json drives no robot",
        ),
        (["--to", "json", "--out", "/dev/null/x"], "cannot be written: Not a directory"),
    ],
)
def test_invalid_exports_are_refused_with_the_reason(
    run: Path, arguments: list[str], why: str
) -> None:
    assert why in refused(run, *arguments)


def test_a_missing_or_invalid_champion_is_reported(tmp_path: Path) -> None:
    assert "expected a run that finished a generation" in refused(
        played(tmp_path), "--to", "json"
    )
    assert "cannot be read" in refused(tmp_path / "none", "--to", "json")
    (tmp_path / CHAMPION).write_bytes(b"none")
    assert "damaged, or no controller" in refused(tmp_path, "--to", "json")


def test_a_network_that_is_not_installed_is_named(tmp_path: Path) -> None:
    kept = msgspec.structs.replace(
        controller("fully-meshed"), representation="of-a-plugin"
    )
    (tmp_path / CHAMPION).write_bytes(msgspec.msgpack.encode(kept))
    assert "unknown representation 'of-a-plugin'" in refused(tmp_path, "--to", "python")


@pytest.mark.parametrize(
    "hostile", ["../../etc/passwd", "x\x1b[31m\ny", "*/ #error", "a" * 4000, "\u202e"]
)
def test_hostile_names_stay_in_the_folder_and_off_the_screen(
    hostile: str, tmp_path: Path
) -> None:
    kept = msgspec.structs.replace(
        controller("fully-meshed"), run=hostile, sensors=[hostile] * 4, simulator=hostile
    )
    (tmp_path / "c.zsc").write_bytes(msgspec.msgpack.encode(kept))
    for target in ("json", "python"):
        done = typed(tmp_path / "c.zsc", "--to", target)
        assert done.exit_code == 0
        assert "\x1b" not in done.output
        assert len(done.output.splitlines()) < 40
        file = Path(done.output.splitlines()[0])
        assert file.is_file()
        assert file.resolve().is_relative_to(tmp_path)
        assert len(file.name) < 60


def test_an_unwritable_folder_is_one_line(run: Path) -> None:
    Path("taken").write_text("mine")
    with pytest.raises(click.BadParameter, match="taken"):
        cli.command(
            ["export", str(run), "--to", "json", "--out", "taken"], standalone_mode=False
        )


# ---- the folder


def test_a_later_export_replaces_what_it_wrote_and_leaves_the_rest() -> None:
    folder.write(Path("f"), {"a.c": "one", "deep/b.bin": b"\0"})
    Path("f/own.c").write_text("mine")
    folder.write(Path("f"), {"a.c": "two", "run.sh": "#!/bin/sh\n"})
    assert Path("f/a.c").read_text() == "two"
    assert Path("f/own.c").read_text() == "mine"
    assert Path("f/deep/b.bin").read_bytes() == b"\0"
    assert os.stat("f/run.sh").st_mode & stat.S_IXUSR
    assert not os.stat("f/a.c").st_mode & stat.S_IXUSR
    folder.write(Path("f"), {"deep/b.bin": b"\1"})  # of an export before the last


@pytest.mark.parametrize("file", ["a.c", "own.c", "link.c"])
def test_foreign_and_edited_files_are_not_replaced(file: str) -> None:
    folder.write(Path("f"), {"a.c": "one", "b.c": "one"})
    Path("f/a.c").write_text("changed by hand")
    Path("f/own.c").write_text("mine")
    Path("f/elsewhere").write_text("mine")
    Path("f/link.c").symlink_to("elsewhere")
    before = Path("f", file).read_text()
    with pytest.raises(
        ConfigError,
        match=f"f/{file}: exists and differs from the exported one; name another folder by --out",
    ):
        folder.write(Path("f"), {"b.c": "two", file: "two"})
    assert Path("f", file).read_text() == before
    assert Path("f/b.c").read_text() == "one"
    assert Path("f/elsewhere").read_text() == "mine"


def test_files_of_a_damaged_list_are_not_replaced() -> None:
    Path("f").mkdir()
    Path("f", folder.LIST).write_text("{}")
    with pytest.raises(ConfigError, match="is not a list of exported files"):
        folder.write(Path("f"), {"a": "b"})


def test_an_export_that_was_cut_short_is_repeated() -> None:
    """The list comes last; what is there already is what is to be written."""
    Path("f").mkdir()
    Path("f/a.c").write_text("one")
    assert folder.write(Path("f"), {"a.c": "one", "b.c": "two"}) == [
        Path("f/a.c"),
        Path("f/b.c"),
    ]


@pytest.mark.parametrize("route", ["files/run/exit.toml", "run/exit.toml"])
def test_champions_of_stage_are_exported_where_neither_package_nor_simulation_is(
    route: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The manifest has the robot's interface, or the simulator; the champion's file holds it.

    Both have the same robot, whose self-test is played.
    """
    example = REPOSITORY / "examples" / "ros" / "stage"
    monkeypatch.setenv("ZSWARM_SIMULATORS", str(example / "files"))
    monkeypatch.setenv("ZSWARM_ROS", "nowhere")
    problem = Problem(experiment.load(example / route))
    champion = problem.controller(problem.random(1)[0], -5.5, "stage")
    Path(CHAMPION).write_bytes(msgspec.msgpack.encode(champion))
    monkeypatch.delenv("ZSWARM_SIMULATORS")
    for target in (name for name, one in targets.TARGETS.items() if not one.simulator):
        assert typed(CHAMPION, "--to", target, "--out", target).exit_code == 0
    settings = {"epsilon": 0.6, "robots": 4}
    fields = {"simulator": "turtlebot-exit", "simulator_settings": settings}
    same = msgspec.structs.replace(champion, robot=None, **fields)
    Path("same.zsc").write_bytes(msgspec.msgpack.encode(same))
    typed("same.zsc", "--to", "ros1", "--out", "same", "--name", "stage")
    for file in ("robot.h", "robot.c", "interface.c", "node.cpp"):
        assert Path("ros1/src", file).read_text() == Path("same/src", file).read_text()
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here: apt-get install gcc")
    main = '#include "ros1/src/robot.h"\nint main(void) { return robot_selftest(); }\n'
    Path("main.c").write_text(main)
    sources = [str(path) for path in Path("ros1/src").glob("*.c")]
    flags = ["-std=c99", "-O2", "-Wall", "-Werror", "-o", "selftest"]
    subprocess.run(["cc", *flags, "main.c", *sources, "-lm"], check=True)
    assert subprocess.run(["./selftest"], check=False).returncode == 0
