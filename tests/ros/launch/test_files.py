"""The file route: manifests, packages and, with roslaunch, faults in trials."""

import gc
import math
import os
import re
import runpy
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.repository import REPOSITORY
from tests.ros.launch import rough_package
from zswarm import evaluate
from zswarm.errors import ConfigError, EvaluationError, UnknownPlugin
from zswarm.evaluate import TrialOutcomes
from zswarm.kernels.random import Stream
from zswarm.plugins import registry as plugins
from zswarm.ros.launch import packages, roslaunch
from zswarm.ros.launch.files import RosFiles

EXAMPLE = REPOSITORY / "examples" / "ros" / "files"
ROSLAUNCH = pytest.mark.skipif(
    shutil.which("roslaunch") is None,
    reason="roslaunch is not installed: apt install ros-core",
)


@pytest.fixture
def rough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of manifests, with that of the rough package; temporary files are there, too."""
    (tmp_path / "manifests").mkdir()
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("ZSWARM_SIMULATORS", str(tmp_path / "manifests"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    yield tmp_path / "manifests"
    gc.collect()  # what raised is remembered with all that was there
    left = [path.name for path in (tmp_path / "temporary").iterdir()]
    assert left == [], "folders of slots are deleted with them"


def play(
    name: str, settings: dict[str, Any], *seeds: int, network: str = "fully-meshed"
) -> TrialOutcomes:
    simulator, built = evaluate.build(name, settings, network, {})
    genomes = built.random(1, Stream(1))
    return evaluate.evaluate(
        simulator,
        built,
        genomes,
        np.zeros((len(seeds), 1), np.int64),
        np.array(seeds, np.uint64),
    )


# ---- without ROS


def test_a_manifest_offers_settings_and_the_fitness_rules(rough: Path) -> None:
    rough_package.write(rough)
    loaded = plugins.load("simulator", "rough")
    assert (
        repr(loaded.settings_type())
        == "Settings(how='fine', robots=2, epsilon=0.5, count=1, fitness='last-distance')"
    )
    built = loaded(loaded.settings_type(robots=3))
    assert (built.inputs, built.outputs, built.owners, built.metrics) == (
        1,
        1,
        (0, 0, 0),
        ("distance", "steps"),
    )
    assert built.repeatable


ROBOTS = 'robots = "robots"'
ROBOT = (
    "robot = { rays = 36, view = 270.0, range = 4.0, targets = [[1.0, 2.0]], arrived = 0.2, "
    "speed = 0.65, turn = 3.14, step_s = 0.2, radius = 0.2 }"
)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("inputs = 1\n", ""), r"rough\.toml: key inputs is missing$"),
        (
            ('launch = "rough.launch"', 'launch = "other.launch"'),
            r"launch: package 'rough' has no file other\.launch$",
        ),
        (
            ('package = "rough"', 'package = "none"'),
            r"package 'none' is not found: neither a folder .*none with a package\.xml",
        ),
        (
            ('"rough/node.sh"]', '"rough/node.py"]'),
            r"files: .*rough/node\.py is missing, or not a file$",
        ),
        (
            ('form = "yaml"', 'form = "xml"'),
            r"rough\.toml: controller\.form: expected yaml, json or c99, not 'xml'$",
        ),
        (
            ('form = "yaml"', 'form = "c99"'),
            r"controller: c99: expected the key rebuild, a program with its arguments$",
        ),
        (
            (ROBOTS, 'robots = "agents"'),
            r"robots: expected a number, or the name of a setting",
        ),
        ((ROBOTS, "robots = 0"), r"rough\.toml: robots: expected int >= 1$"),
        (
            (ROBOTS, 'robots = 1\nfitness = "command"'),
            r"fitness: command: expected the key command, a program",
        ),
        (
            (ROBOTS, f"robots = 1\n{ROBOT}"),
            r"robot: it has a number for each sector .* inputs = 3 or more and outputs = 2, "
            "not 1 and 1$",
        ),
        (
            (ROBOTS, f"robots = 1\n{ROBOT}".replace("4.0", "nan")),
            r"rough\.toml: robot\.range: expected float > 0\.0",
        ),
        (
            (ROBOTS, 'robots = 1\nlogs = "."'),
            r"logs: expected a folder in the package, which is emptied before",
        ),
        (
            (ROBOTS, 'robots = 1\nlogs = "../log"'),
            r"rough\.toml: logs: expected str matching regex ",
        ),
        (
            (ROBOTS, 'robots = 1\nsensors = ["a", "b"]'),
            r"sensors: expected 1 names or none, not 2$",
        ),
        (
            ('argument = "how"', 'file = "a.yaml"'),
            r"rough\.toml: settings\[\.\.\.\]: expected argument, or file and key$",
        ),
        (
            ('argument = "seed"', 'key = "seed"'),
            r"rough\.toml: seed: expected argument, or file and key$",
        ),
        (
            ("default = 2", 'default = 0.5\nchoices = ["a"]'),
            r"robots: expected a number, or the name of",
        ),
        (
            ("default = 0.5", "default = 0.5\nmaximum = 0.1"),
            r"settings: 'epsilon': default: Expected `float` <= 0\.1$",
        ),
        (
            (
                "[settings.how]",
                '[settings.fitness]\ndefault = 1\nargument = "a"\n[settings.how]',
            ),
            r"'fitness': a keyword",
        ),
        (
            ("log_path = ", "late = 1979-05-27\nlog_path = "),
            r"parameters: config/frevo\.yaml: late: a date cannot be a",
        ),
        (
            ("log_path = ", "big = 3000000000\nlog_path = "),
            r"big: 3000000000 is not among the integers of ROS parameters",
        ),
    ],
)
def test_a_wrong_manifest_is_reported_in_one_line(
    change: tuple[str, str], told: str, rough: Path
) -> None:
    """It is listed and hashed all the same."""
    manifest = rough_package.write(rough)
    assert change[0] in manifest.read_text()
    manifest.write_text(manifest.read_text().replace(*change, 1))
    assert manifest in plugins.source_files("simulator", "rough")
    with pytest.raises(UnknownPlugin, match=f"^simulator 'rough': .*{told}") as raised:
        plugins.load("simulator", "rough")
    assert "\n" not in str(raised.value)


def test_a_launch_file_that_would_not_end_is_refused(rough: Path) -> None:
    """roslaunch runs as long as its master, even after all nodes of the file have ended."""
    rough_package.write(rough)
    launch = rough / "rough" / "rough.launch"
    launch.write_text(launch.read_text().replace('required="true"', ""))
    with pytest.raises(
        UnknownPlugin,
        match=r"launch: rough\.launch has no node with required=\"true\"; expected one that ends",
    ):
        plugins.load("simulator", "rough")


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (
            {"robots": 0},
            r"^simulator 'rough': robots: expected 1 to 100000 robots, not 0$",
        ),
        (
            {"robots": 2**40},
            r"^simulator 'rough': robots: expected 1 to 100000 robots, not 1099511627776$",
        ),
        (
            {"count": 2**40},
            r"^simulator 'rough': count: count: 1099511627776 is not among the integers of ROS",
        ),
        (
            {"how": "$(eval 1)"},
            r"^simulator 'rough': how: expected a text without \$\( and .*, not '\$\(eval",
        ),
        (
            {"how": "a\nb"},
            r"^simulator 'rough': how: expected a text without \$\( and .*, not 'a\\nb'$",
        ),
        (
            {"fitness": "command"},
            r"^problem\.settings: fitness: expected last-distance or cpswarm-log, not 'command'",
        ),
        (
            {"speed": 1},
            r"^problem\.settings: unknown key 'speed'; known are: how, robots, epsilon,",
        ),
    ],
)
def test_settings_that_cannot_be_ros_parameters_are_refused(
    settings: dict[str, Any], told: str, rough: Path
) -> None:
    """An experiment's texts come over the network; roslaunch evaluates $(...)."""
    rough_package.write(rough)
    with pytest.raises(ConfigError, match=told):
        evaluate.build("rough", settings, "fully-meshed", {})


def test_a_network_that_is_no_list_of_numbers_is_refused_as_yaml(rough: Path) -> None:
    rough_package.write(rough)
    with pytest.raises(
        ConfigError,
        match=r"^genomes of neat are not lists of numbers, which a controller in yaml needs",
    ):
        evaluate.build("rough", {}, "neat", {})


def test_trials_cannot_be_followed_in_turns(rough: Path) -> None:
    rough_package.write(rough)
    simulator, _ = evaluate.build("rough", {}, "fully-meshed", {})
    with pytest.raises(
        EvaluationError,
        match=r"^simulator 'rough' plays whole trials, by roslaunch: they cannot be followed",
    ):
        simulator.reset(1)


@pytest.mark.parametrize(
    ("change", "repeatable"), [('[seed]\nargument = "seed"\n', False), ("", True)]
)
def test_a_world_that_ignores_the_seed_is_not_repeatable(
    change: str, repeatable: bool, rough: Path
) -> None:
    manifest = rough_package.write(rough)
    manifest.write_text(
        manifest.read_text().replace(change, "") if change else manifest.read_text()
    )
    assert evaluate.build("rough", {}, "fully-meshed", {})[0].repeatable == repeatable


def test_the_version_hash_covers_manifest_package_and_launch_code(
    rough: Path,
) -> None:
    rough_package.write(rough)
    names = {path.name for path in plugins.source_files("simulator", "rough")}
    assert {
        "rough.toml",
        "rough.launch",
        "node.sh",
        "files.py",
        "roslaunch.py",
        "logs.py",
        "exit_fitness.py",
    } <= names
    assert {
        "parameters.py",
        "controller_files.py",
        "packages.py",
        "json_file.py",
    } <= names


def test_a_package_is_found_by_its_name_below_the_path_of_ros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The manifest gives the name, whatever the folder is called."""
    rough_package.write(tmp_path)
    (tmp_path / "rough").rename(tmp_path / "somewhere")
    monkeypatch.setenv(
        "ROS_PACKAGE_PATH", f"{tmp_path / 'nowhere'}{os.pathsep}{tmp_path}"
    )
    assert packages.find("rough", tmp_path / "manifests") == tmp_path / "somewhere"


def test_the_examples_numbers_are_those_of_the_network() -> None:
    """The example's network in plain Python has the bits of the kernel."""
    example = runpy.run_path(str(EXAMPLE / "exit_world" / "scripts" / "controllers.py"))
    for settings in ({}, {"hidden": 5, "iterations": 3}, {"hidden": 0, "iterations": 1}):
        network = plugins.load("representation", "fully-meshed")
        built = network(network.settings_type(**settings), 10, 2)
        (genome,) = built.random(1, Stream(5))
        complete = {
            "hidden": built.settings.hidden,
            "iterations": built.settings.iterations,
        }
        copy = example["FullyMeshed"](
            np.frombuffer(genome, "<f4").tolist(), 10, 2, complete
        )
        parameters, state, action = (
            built.parameters([genome])[0],
            np.zeros(built.state_size, np.float32),
            np.zeros(2, "f4"),
        )
        for observation in (
            Stream(6).uniform(-3, 3, 500).reshape(50, 10).astype(np.float32)
        ):
            built.step(parameters, state, observation, action)
            assert (
                np.array(copy.act(observation.tolist()), np.float32).tobytes()
                == action.tobytes()
            )


# ---- with roslaunch


@pytest.mark.robots
@ROSLAUNCH
def test_a_trial_is_played_by_roslaunch_with_its_seed(rough: Path) -> None:
    """Two robots end at 3.5 m with seed 3; seeds are reduced to ROS integers."""
    rough_package.write(rough)
    before = {path.relative_to(rough) for path in rough.rglob("*")}
    outcomes = play("rough", {}, 3, 2**31 + 4)
    assert outcomes.error == ""
    assert outcomes.fitness.tolist() == [[-7.0], [-9.0]]
    assert outcomes.metrics.tolist() == [[3.5, 2.0], [4.5, 2.0]]
    assert {path.relative_to(rough) for path in rough.rglob("*")} == before


FAULTS = {
    "fails": r"node node-\d+ ended with code 7; it wrote: .*cannot load the map"
    r"( / local launch of rough/node\.sh failed)?$",  # of a node that ended before it was looked at
    "is-killed": r"node node-\d+ was killed by signal 9 \(SIGKILL; ",
    "kills-roslaunch": r"roslaunch was killed by signal 9 \(SIGKILL; ",
    "ends-roslaunch": r"roslaunch was told to end before its nodes had ended",
}
SAID = """process[rosout-1]: started with pid [23092]
started core service [/rosout]
cannot load the map
failed to start local process: /tmp/rough/node.sh fails
local launch of rough/node.sh failed
========REQUIRED process [node-2] has died!
process has died {how}, cmd /tmp/rough/node.sh fails].
log file: /tmp/log/node-2*.log
Initiating shutdown!
========
[node-2] killing on exit
"""


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ("[pid 71, exit code 7", "ended with code 7"),
        ("[pid -1, exit code 7", "ended with code 7"),
        ("[pid None, exit code 7", "ended with code 7"),
        ("[pid -1, exit code -9", r"was killed by signal 9 \(SIGKILL; .*\)"),
        ("without exit code [pid 71", "ended without an exit code"),
    ],
)
def test_a_failed_node_is_found_in_the_output_of_roslaunch(how: str, why: str) -> None:
    """A node that ends before roslaunch looks at it has no process id there."""
    found = roslaunch.fault(SAID.format(how=how))
    assert re.fullmatch(rf"node node-2 {why}; it wrote: .*cannot load the map.*", found)
    ended = "[node-2] process has finished cleanly\n"
    everyone = "all processes on machine have died, roslaunch will exit\n"
    assert roslaunch.fault(ended + everyone) == ""


DECIDED = {
    "no-logs": r"LogError: log/ has 0 logs; expected 2, one of each robot$",
    "one-log-less": r"LogError: log/ has 1 logs \(robot_1\.log\); expected 2, one of each robot$",
    "malformed": r"LogError: log/ has 1 logs",
}


@pytest.mark.robots
@ROSLAUNCH
@pytest.mark.parametrize("how", FAULTS)
def test_a_node_or_roslaunch_that_fails_is_a_fault(rough: Path, how: str) -> None:
    """Logs do not make it an outcome. The error names simulator and seed."""
    rough_package.write(rough)
    with pytest.raises(
        EvaluationError, match=f"^simulator 'rough', trial seed 1: {FAULTS[how]}"
    ):
        play("rough", {"how": how}, 1)


@pytest.mark.robots
@ROSLAUNCH
@pytest.mark.parametrize("how", DECIDED)
def test_missing_logs_are_an_outcome_and_the_next_trial_is_played(
    rough: Path, how: str
) -> None:
    rough_package.write(rough)
    outcomes = play("rough", {"how": how}, 1)
    assert np.isnan(outcomes.fitness).all()
    assert outcomes.error.startswith("rough, trial seed 1: LogError: log/ has ")


@pytest.mark.robots
@ROSLAUNCH
def test_processes_that_a_trial_leaves_behind_are_ended(rough: Path) -> None:
    """Nodes have sessions of their own, and what they start may have another one."""
    rough_package.write(rough)
    before = running("sleep 1000")
    assert play("rough", {"how": "stays-behind"}, 1).error == ""
    assert running("sleep 1000") == before


@pytest.mark.robots
@ROSLAUNCH
@pytest.mark.parametrize(
    ("command", "fitness", "told"),
    [
        (["sh", "-c", 'ls "$0"; echo "fitness = $(cat "$0"/*.log | wc -l)"'], 6.0, ""),
        (["./score.sh"], 11.0, ""),
        (
            ["echo", "nothing"],
            math.nan,
            "LogError: its output has no line fitness=<number>",
        ),
    ],
)
def test_the_users_command_computes_the_fitness(
    rough: Path, command: list[str], fitness: float, told: str
) -> None:
    """Its last argument is the folder of the logs; it runs in the package."""
    rough_package.write(rough, more=f"command = {command}")
    (rough / "rough" / "score.sh").write_text(
        '#!/bin/sh\ntest -e package.xml && test -d "$1" && echo fitness=11\n'
    )
    (rough / "rough" / "score.sh").chmod(0o755)
    outcomes = play("rough", {"fitness": "command"}, 3)
    assert outcomes.fitness.tolist() == pytest.approx(np.array([[fitness]]), nan_ok=True)
    assert told in outcomes.error


@pytest.mark.robots
@ROSLAUNCH
@pytest.mark.parametrize(
    ("command", "told"),
    [
        (
            ["sh", "-c", "echo no bags >&2; exit 2"],
            r"the command ended with code 2; it wrote: no bags$",
        ),
        (
            ["sh", "-c", "sleep 1000"],
            r"the command took longer than its limit and was ended$",
        ),
        (["./nowhere"], r"\./nowhere cannot be started: No such file or directory$"),
    ],
)
def test_a_command_that_fails_is_a_fault(
    rough: Path, command: list[str], told: str
) -> None:
    rough_package.write(rough, more=f"command = {command}\ncommand_limit_s = 1.0")
    with pytest.raises(
        EvaluationError, match=f"^simulator 'rough', trial seed 3: {told}"
    ):
        play("rough", {"fitness": "command"}, 3)


@pytest.mark.robots
@ROSLAUNCH
def test_a_rebuild_that_fails_is_a_fault(rough: Path) -> None:
    rough_package.write(
        rough, controller='rebuild = ["sh", "-c", "echo no compiler; exit 1"]'
    )
    with pytest.raises(
        EvaluationError,
        match=r"^simulator 'rough', trial seed 3: the rebuild ended with code 1; it wrote: no",
    ):
        play("rough", {}, 3)


def running(words: str) -> set[int]:
    """Return the processes whose command line has these words."""
    found = set()
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if words in file.read_text().replace("\0", " "):
                found.add(int(file.parent.name))
        except OSError:
            continue
    return found


def test_a_launch_manifest_gives_a_launch_simulator(rough: Path) -> None:
    rough_package.write(rough)
    assert issubclass(plugins.load("simulator", "rough"), RosFiles)


@pytest.mark.robots
@ROSLAUNCH
def test_the_three_forms_of_a_controller_have_the_same_fitness(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Controllers in yaml, JSON and compiled C99 are compared bit by bit for two candidates."""
    if shutil.which("make") is None or shutil.which("cc") is None:
        pytest.skip("no C compiler, or no make")
    monkeypatch.setenv("ZSWARM_SIMULATORS", str(EXAMPLE))
    found = []
    for form in ("yaml", "json", "c99"):
        simulator, network = evaluate.build(
            f"exit-{form}", {"robots": 3, "steps": 15}, "fully-meshed", {}
        )
        genomes = network.random(2, Stream(8))
        outcomes = evaluate.evaluate(
            simulator, network, genomes, np.array([[0], [1]]), np.array([5, 6], np.uint64)
        )
        assert outcomes.error == ""
        found.append(outcomes.fitness.tolist())
    assert found[0][0] != found[0][1]
    assert found == [found[0]] * 3
