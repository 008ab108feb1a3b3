"""Profiles: what topics of robots are called, and what is wrong in a file is told with its line."""

from pathlib import Path

import msgspec
import pytest

from tests.repository import REPOSITORY
from zswarm.errors import ConfigError
from zswarm.robots.profiles import profile as profiles

OWN = """\
description = "Our rovers"
ros = 2
distribution = "jazzy"
namespace = "rover_{i}"
speed = 0.5
turn = 1.5

[velocity]
name = "cmd_vel"

[scan]
name = "front/scan"
reliable = false

[odometry]
name = "odom"
"""


@pytest.mark.parametrize("name", profiles.names())
def test_every_bundled_profile_can_be_read(name: str) -> None:
    profile = profiles.read(name)
    assert profile.source
    assert profile.tested
    assert (profile.ros == 1) == (profile.distribution == "noetic")
    assert {"velocity", "scan", "odometry", "reset"} <= set(profile.channels)
    topics = [
        profile.topic(channel, robot, 2)
        for channel in profile.channels
        for robot in (0, 1)
    ]
    assert len(set(topics)) == len(
        [c for c in profile.channels if c not in profiles.SHARED]
    ) * 2 + len([c for c in profile.channels if c in profiles.SHARED])


def test_one_robot_alone_has_no_namespace() -> None:
    profile = profiles.read("stageros")
    assert profile.topic("velocity", 0, 1) == "/cmd_vel"
    assert profile.topic("velocity", 3, 10) == "/robot_3/cmd_vel"
    assert profile.topic("clock", 0, 10) == "/clock"
    assert profile.frame("base_laser_link", 0, 1) == "base_laser_link"
    assert profile.frame("base_laser_link", 3, 10) == "/robot_3/base_laser_link"


def test_newer_turtlebots_take_stamped_velocities() -> None:
    stamped = {name for name in profiles.names() if profiles.read(name).velocity.stamped}
    assert stamped == {"turtlebot3-jazzy", "turtlebot4"}


def test_a_users_profile_is_read_from_its_path(tmp_path: Path) -> None:
    path = tmp_path / "rover.toml"
    path.write_text(OWN)
    profile = profiles.read(str(path))
    assert profile.topic("scan", 1, 2) == "/rover_1/front/scan"
    assert profile.channels == ("velocity", "scan", "odometry", "reset")
    with pytest.raises(ValueError, match="the profile has no clock"):
        profile.topic("clock", 0, 1)


@pytest.mark.parametrize(
    ("line", "changed", "said"),
    [
        (
            "speed = 0.5",
            "sped = 0.5",
            "line 5: unknown key 'sped' (did you mean 'speed'?); known are: description, ros,",
        ),
        ("speed = 0.5", "speed = -1.0", "line 5: speed: expected float > 0.0"),
        ("speed = 0.5", 'speed = "fast"', "line 5: speed: expected float, got str"),
        ("speed = 0.5\n", "", ": key speed is missing"),
        ("ros = 2", "ros = 3", "line 2: ros: "),
        (
            'name = "front/scan"',
            'name = "front scan"',
            "line 12: scan.name: expected str matching regex",
        ),
        (
            'name = "front/scan"',
            'name = "/../../etc"',
            "line 12: scan.name: expected str matching regex",
        ),
        (
            "reliable = false",
            "reliable = 0",
            "line 13: scan.reliable: expected bool, got int",
        ),
        (
            "reliable = false",
            "stamped = true",
            "scan: unknown key 'stamped'; known are: name, reliable, frame, child_frame",
        ),
        (
            "[odometry]",
            "[odometri]",
            "line 15: unknown key 'odometri' (did you mean 'odometry'?)",
        ),
        ("[odometry]", "[odometry", "not TOML"),
    ],
)
def test_mistakes_are_reported_in_one_line(
    line: str, changed: str, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "rover.toml"
    path.write_text(OWN.replace(line, changed))
    with pytest.raises(ConfigError) as error:
        profiles.read(str(path))
    assert str(error.value).startswith(str(path))
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_unknown_names_and_missing_files_are_reported() -> None:
    with pytest.raises(
        ConfigError,
        match=r"no profile 'turtlebot5' \(did you mean 'turtlebot[0-9]'\?\); "
        r"there are stage, stage-lockstep, stage_ros2, .*FILE.toml",
    ):
        profiles.read("turtlebot5")
    with pytest.raises(ConfigError, match=r"nowhere.toml: cannot be read: No such file"):
        profiles.read("nowhere.toml")


def test_the_document_says_where_each_profile_was_tested() -> None:
    text = (REPOSITORY / "docs" / "profiles.md").read_text()
    for name in profiles.names():
        assert f"`{name}`" in text


def test_profiles_round_trip() -> None:
    profile = profiles.read("turtlebot4")
    assert msgspec.convert(msgspec.to_builtins(profile), profiles.Profile) == profile
