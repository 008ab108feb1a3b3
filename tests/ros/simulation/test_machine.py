"""Where a ROS simulation is stands in a file of the machine, and only slots drive it."""

import socket
from pathlib import Path
from typing import Any

import pytest

from tests.robots.trials import built
from zswarm import evaluate, experiment
from zswarm.config.decode import convert
from zswarm.errors import ConfigError, EvaluationError
from zswarm.ros.simulation import machine
from zswarm.ros.simulation.settings import RosSettings

NAME = "turtlebot-exit-ros"
FILE = 'link = "zenoh"\nprofile = "stage_ros2"\n'
ROBOTS = """
description = "robots"
ros = 2
distribution = "jazzy"
speed = 0.2
turn = 1.0
velocity = { name = "cmd_vel" }
scan = { name = "scan" }
odometry = { name = "odom" }
"""


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ZSWARM_ROS", str(tmp_path))
    return tmp_path


def in_slot(**settings: Any) -> Any:
    return evaluate.build(NAME, settings, "fully-meshed", {}, in_slot=True)[0]


def test_a_file_says_where_a_simulation_is(files: Path) -> None:
    more = 'connect = ["tcp/127.0.0.1:7447"]\ndomain = 3\n'
    (files / "stage.toml").write_text(FILE + more)
    found, profile, _ = machine.find("stage")
    graph = found.graph()
    assert (graph.link, graph.connect, graph.domain) == (
        "zenoh",
        ["tcp/127.0.0.1:7447"],
        3,
    )
    assert not graph.local
    assert profile.description.startswith("Stage")


def test_its_profile_may_be_a_file_beside_it(files: Path) -> None:
    (files / "lab").mkdir()
    text = FILE.replace("stage_ros2", "lab/ours.toml") + "real_robots = true\n"
    (files / "arena.toml").write_text(text)
    (files / "lab" / "ours.toml").write_text(ROBOTS)
    assert machine.find("arena")[1].speed == 0.2


def test_robots_that_may_be_real_need_a_word_of_the_administrator(files: Path) -> None:
    """What is not simulated publishes no clock."""
    (files / "ours.toml").write_text(ROBOTS)
    (files / "arena.toml").write_text(FILE.replace("stage_ros2", "ours.toml"))
    with pytest.raises(ConfigError, match=r"has no clock.*expected.*real_robots = true"):
        machine.read(files / "arena.toml")


def test_the_example_of_stage_is_a_file_for_a_server_and_an_experiment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = experiment.examples_folder() / "ros" / "stage"
    monkeypatch.setenv("ZSWARM_ROS", str(folder))
    file = folder / "run" / "exit.toml"
    loaded = experiment.complete(experiment.load(file), str(file))
    found = machine.find(loaded.problem.settings["simulation"])
    assert found.folder == folder
    assert found.simulation.command[-2:] == ["room.world", "_base_watchdog_timeout:=0"]
    assert found.profile.reset.name == "/lockstep/reset"


def test_an_unknown_name_is_refused_in_a_slot_before_anything_is_dialled(
    files: Path,
) -> None:
    (files / "stage.toml").write_text(FILE)
    with pytest.raises(
        ConfigError, match=r"'stages'.*did you mean 'stage'.*it has stage"
    ):
        in_slot(simulation="stages")


def test_a_file_that_is_not_valid_is_told_to_its_machine_only(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (files / "stage.toml").write_text(FILE + 'password = "x"\n')
    with pytest.raises(ConfigError) as caught:
        in_slot(simulation="stage")
    assert "password" not in str(caught.value)
    assert str(files) not in str(caught.value)
    assert "password" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ('launch = "stageros \'room.world"', "launch: No closing quotation"),
        ('launch = " "', "launch: expected a command"),
        (
            'link = "zenoh"\nlaunch = "stage"',
            'launch: expected link = "rospy" or "rclpy"',
        ),
        ('launch = "stage"\nmaster = "http://lab:11311"', "expected no master"),
        ('launch = "stage"\nreal_robots = true', "expected no master, domain or real_"),
    ],
)
def test_what_does_not_go_with_launch_is_refused(
    files: Path, lines: str, said: str
) -> None:
    link = "" if "link" in lines else 'link = "rospy"\n'
    profile = "stage_ros2" if "zenoh" in lines else "stage"
    (files / "stage.toml").write_text(f'{link}profile = "{profile}"\n{lines}\n')
    with pytest.raises(ConfigError, match=said):
        machine.read(files / "stage.toml")


@pytest.mark.parametrize(
    "settings",
    [
        {"launch": "running"},
        {"connect": ["tcp/127.0.0.1:1"]},
        {"master": "http://127.0.0.1:1"},
        {"domain": 3},
        {"profile": "/etc/passwd.toml"},
        {"profile": "../ours.toml"},
        {"simulation": "../stage"},
        {"simulation": "/etc/zswarm/ros/stage"},
        {"simulation": "stage\n"},
        {"simulation": "stage", "profile": "stageros"},
        {"simulation": "stage", "link": "rospy"},
        {"repeatable": True},
        {"simulation": "stage", "mode": "free-running", "repeatable": True},
    ],
)
def test_settings_hold_no_address_and_no_path(
    settings: dict[str, Any], files: Path
) -> None:
    (files / "stage.toml").write_text(FILE)
    with pytest.raises(ConfigError):
        in_slot(**settings)


def test_outside_of_a_slot_nothing_is_dialled(files: Path) -> None:
    """As by ``report``, ``evaluate``, ``replay`` and the dashboard."""
    with socket.create_server(("127.0.0.1", 0)) as robot:
        robot.settimeout(0.0)
        port = robot.getsockname()[1]
        dial = f'connect = ["tcp/127.0.0.1:{port}"]\n'
        (files / "stage.toml").write_text(FILE + dial)
        simulator = built(NAME, robots=1, simulation="stage")
        assert not simulator.repeatable
        assert built(NAME, robots=1, simulation="stage", repeatable=True).repeatable
        with pytest.raises(EvaluationError, match="driven by slots of servers only"):
            simulator.reset(1)
        with pytest.raises(BlockingIOError):
            robot.accept()


def test_settings_of_an_own_simulation_are_checked_as_before() -> None:
    settings = convert({"link": "rospy"}, RosSettings, "problem.settings")
    assert settings.profile_or_default == "stageros"
    with pytest.raises(ConfigError, match="free-running needs a profile with a clock"):
        built(NAME, mode="free-running", profile="turtlebot2", link="rospy")
