"""When a packed robot decides and when it stops; its clock is a number."""

import importlib.util
from typing import Any

import pytest

from zswarm.robots.c.templates import TEMPLATES

SPEC = importlib.util.spec_from_file_location("driving", TEMPLATES / "python/driving.py")
assert SPEC is not None
assert SPEC.loader is not None
driving: Any = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(driving)
STOP, WATCHDOG_S, ARRIVED_M = driving.STOP, 1.0, 0.15


class Decided:
    """A robot that says how often it was asked; ``distance`` is to its target."""

    view_degrees = 270.0

    def __init__(self) -> None:
        self.distance, self.asked, self.forgot, self.blind = 1.0, 0, 0, False

    def reset(self) -> None:
        self.forgot += 1

    def step(self, scan: Any, _pose: Any) -> Any:
        self.asked += 1
        return None if self.blind else Answer(self.asked, scan.stamp_ns, self.distance)


class Answer:
    def __init__(self, linear: float, angular: float, distance: float) -> None:
        self.linear, self.angular, self.distance = linear, angular, distance


def scan(stamp: int) -> Any:
    return driving.Scan(stamp, [1.0], 0.0, 0.1)


def pose(stamp: int) -> Any:
    return driving.Pose(stamp, 0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def robot() -> Decided:
    return Decided()


@pytest.fixture
def free(robot: Decided) -> Any:
    return driving.Driving(robot, WATCHDOG_S, ARRIVED_M)


@pytest.fixture
def locked(robot: Decided) -> Any:
    return driving.Driving(robot, WATCHDOG_S, ARRIVED_M, lock_step=True)


def test_nothing_is_sent_before_scan_and_pose_have_come(free: Any) -> None:
    assert free.on_step(0.0) is None
    assert free.on_scan(0.1, scan(1)) is None
    assert free.on_step(0.2) is None
    assert free.on_watch(9.0) is None


def test_a_robot_decides_in_each_step_by_what_is_newest(free: Any) -> None:
    free.on_pose(0.0, pose(1))
    for step in range(1, 4):
        assert free.on_scan(step * 0.2, scan(step)) is None
        free.on_pose(step * 0.2, pose(step + 1))
        assert free.on_step(step * 0.2 + 0.1) == (step, step)


@pytest.mark.parametrize("silent", ["scan", "pose"])
def test_the_robot_stops_when_sensors_fall_silent_and_drives_when_they_return(
    free: Any, silent: str
) -> None:
    free.on_scan(0.0, scan(1))
    free.on_pose(0.0, pose(1))
    assert free.on_step(0.0) == (1, 1)
    (free.on_pose if silent == "scan" else free.on_scan)(
        0.9, pose(2) if silent == "scan" else scan(2)
    )
    assert free.on_step(WATCHDOG_S) != STOP
    assert free.on_step(WATCHDOG_S + 0.01) == STOP
    assert free.silent
    (free.on_scan if silent == "scan" else free.on_pose)(
        2.0, scan(9) if silent == "scan" else pose(9)
    )
    (free.on_pose if silent == "scan" else free.on_scan)(
        2.0, pose(9) if silent == "scan" else scan(9)
    )
    assert free.on_step(2.0) != STOP
    assert not free.silent


def test_the_watchdog_stops_the_robot_when_steps_no_longer_come(free: Any) -> None:
    """Such as in a simulation whose clock stands, which its steps follow."""
    free.on_scan(0.0, scan(1))
    free.on_pose(0.0, pose(1))
    free.on_step(0.0)
    assert free.on_watch(WATCHDOG_S) is None
    free.on_scan(0.9, scan(2))
    free.on_pose(0.9, pose(2))
    assert free.on_watch(WATCHDOG_S + 0.01) == STOP


def test_the_robot_stops_when_stamps_go_back_and_one_sensor_stays_silent(
    free: Any,
) -> None:
    """This happens when a driver is restarted and its odometry dies."""
    free.on_scan(0.0, scan(5))
    free.on_pose(0.0, pose(5))
    assert free.on_step(0.0) == (1, 5)
    free.on_scan(0.5, scan(1))
    assert free.on_step(0.6) is None
    assert free.on_watch(WATCHDOG_S) is None
    free.on_scan(1.0, scan(2))
    assert free.on_watch(WATCHDOG_S + 0.01) == STOP
    assert free.silent
    free.on_pose(1.1, pose(2))
    assert free.on_step(1.2) != STOP
    assert not free.silent


def test_a_driver_that_repeats_its_last_scan_is_silent(free: Any) -> None:
    free.on_scan(0.0, scan(1))
    for tenth in range(20):
        free.on_scan(tenth / 10, scan(1))
        free.on_pose(tenth / 10, pose(tenth))
    assert free.on_step(1.9) == STOP


def test_the_robot_stops_for_good_at_a_target(robot: Decided, free: Any) -> None:
    free.on_scan(0.0, scan(1))
    free.on_pose(0.0, pose(1))
    robot.distance = ARRIVED_M
    assert free.on_step(0.0) == (1, 1)
    robot.distance = ARRIVED_M - 1e-9
    assert free.on_step(0.2) == STOP
    robot.distance = 1.0
    assert free.on_step(0.4) == STOP
    assert free.arrived


def test_a_lock_step_robot_decides_once_per_stamp(locked: Any) -> None:
    assert locked.on_scan(0.0, scan(0)) is None
    assert locked.on_pose(0.0, pose(0)) == (1, 0)
    assert locked.on_pose(0.0, pose(200)) is None
    assert locked.on_pose(0.0, pose(200)) is None
    assert locked.on_scan(50.0, scan(200)) == (2, 200)
    assert locked.on_scan(50.0, scan(200)) is None
    assert locked.on_step(99.0) is None
    assert locked.on_watch(99.0) is None


def test_a_lock_step_simulation_names_the_present_robots(
    robot: Decided, locked: Any
) -> None:
    robot.distance = 0.0
    locked.on_scan(0.0, scan(5))
    assert locked.on_pose(0.0, pose(5)) == (1, 5)


@pytest.mark.parametrize("first", ["scan", "pose"])
def test_stamps_that_go_back_begin_a_trial(
    robot: Decided, locked: Any, first: str
) -> None:
    """The controller forgets; what was heard before is not mixed with what comes."""
    locked.on_scan(0.0, scan(400))
    locked.on_pose(0.0, pose(400))
    before = robot.forgot
    if first == "scan":
        assert locked.on_scan(1.0, scan(0)) is None
        assert locked.on_pose(1.0, pose(0)) == (2, 0)
    else:
        assert locked.on_pose(1.0, pose(0)) is None
        assert locked.on_scan(1.0, scan(0)) == (2, 0)
    assert robot.forgot > before


def test_a_scanner_with_another_orientation_ends_the_drive(
    robot: Decided, free: Any
) -> None:
    robot.blind = True
    free.on_scan(0.0, scan(1))
    free.on_pose(0.0, pose(1))
    with pytest.raises(driving.Blind, match="270 degrees"):
        free.on_step(0.0)
