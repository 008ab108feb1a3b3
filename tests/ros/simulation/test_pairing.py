"""What is known of robots by their messages."""

import numpy as np
import pytest

from zswarm.ros.link.messages import Clock, Odometry, Scan
from zswarm.ros.simulation.pairing import Readings
from zswarm.sims.turtlebot_exit import ExitTask, TurtlebotExitSettings

INTERFACE = ExitTask(TurtlebotExitSettings(robots=2)).interface


def scan(robot: int, stamp_ns: int, metres: float = 1.0) -> Scan:
    first, spread = (
        np.float32(-INTERFACE.view / 2),
        np.float32(INTERFACE.view / (INTERFACE.rays - 1)),
    )
    return Scan(
        robot=robot,
        stamp_ns=stamp_ns,
        ranges=np.full(INTERFACE.rays, metres, np.float32),
        angle_min=float(first),
        angle_max=-float(first),
        angle_increment=float(spread),
        range_min=0.0,
        range_max=9.0,
    )


def pose(robot: int, stamp_ns: int, *, truth: bool = True, x: float = 1.0) -> Odometry:
    return Odometry(robot=robot, stamp_ns=stamp_ns, x=x, y=2.0, z=0.6, w=0.8, truth=truth)


@pytest.fixture
def readings() -> Readings:
    return Readings(INTERFACE, truth=True)


def test_readings_older_than_a_time_are_missing(readings: Readings) -> None:
    for message in (scan(0, 400), pose(0, 400), scan(1, 400), pose(1, 200)):
        readings.take(message)
    assert readings.missing([0, 1], 400) == [1]
    readings.take(pose(1, 400))
    assert readings.missing([0, 1], 400) == []
    assert readings.missing([0, 1], 401) == [0, 1]


def test_poses_are_from_one_source(readings: Readings) -> None:
    readings.take(scan(0, 400))
    readings.take(pose(0, 400, truth=False))
    assert readings.missing([0], 400) == [0]


def test_the_newest_readings_are_filled_in(readings: Readings) -> None:
    for message in (scan(1, 200, 3.0), scan(1, 400, 2.0), pose(1, 400)):
        readings.take(message)
    scans, poses = np.zeros((2, INTERFACE.rays), np.float32), np.zeros((2, 4))
    assert readings.fill([1], 300, scans, poses) == 400
    assert scans.tolist() == [[0.0] * INTERFACE.rays, [2.0] * INTERFACE.rays]
    assert poses.tolist() == [[0.0] * 4, [1.0, 2.0, 0.6, 0.8]]


def filled(readings: Readings, due_ns: int) -> tuple[int, list[float], list[float]]:
    """Return the stamp, the first range and x of robots 0 and 1."""
    scans, poses = np.zeros((2, INTERFACE.rays), np.float32), np.zeros((2, 4))
    stamp_ns = readings.fill([0, 1], due_ns, scans, poses)
    return stamp_ns, scans[:, 0].tolist(), poses[:, 0].tolist()


def test_scans_and_poses_are_of_one_stamp(readings: Readings) -> None:
    """A scan arrived whose pose did not yet, and robot 1 is a stamp behind."""
    for robot, last_ns in ((0, 600), (1, 400)):
        for stamp_ns in range(200, last_ns + 1, 200):
            readings.take(scan(robot, stamp_ns, stamp_ns / 200))
            readings.take(pose(robot, stamp_ns, x=stamp_ns))
    readings.take(scan(0, 800, 4.0))
    assert filled(readings, 300) == (400, [2.0, 2.0], [400.0, 400.0])


def test_without_a_common_stamp_the_pose_next_to_the_newest_scan_is_used(
    readings: Readings,
) -> None:
    for robot in (0, 1):
        for stamp_ns in (400, 500):
            readings.take(scan(robot, stamp_ns + robot, stamp_ns / 200))
        for stamp_ns in (410, 480, 610):
            readings.take(pose(robot, stamp_ns, x=stamp_ns))
    assert filled(readings, 400) == (501, [2.5, 2.5], [480.0, 480.0])


def test_an_earlier_stamp_shows_that_the_time_began_again(readings: Readings) -> None:
    for stamp_ns in (800, 200):
        for robot in (0, 1):
            readings.take(scan(robot, stamp_ns, stamp_ns / 200))
            readings.take(pose(robot, stamp_ns, x=stamp_ns))
    assert filled(readings, 200) == (200, [1.0, 1.0], [200.0, 200.0])


def test_the_interval_is_the_shortest_time_between_scans_of_a_robot(
    readings: Readings,
) -> None:
    """A lost scan makes one twice as long; a trial does not forget it."""
    for stamp_ns in (100, 200, 400, 500, 600):
        readings.take(scan(0, stamp_ns))
        readings.take(scan(1, stamp_ns + 50))
        assert readings.interval_ns in ((0,) if stamp_ns < 400 else (0, 100))
    readings.forget()
    assert readings.interval_ns == 100


def test_readings_from_before_a_trial_are_forgotten(readings: Readings) -> None:
    for message in (scan(0, 400), pose(0, 400), Clock(stamp_ns=400)):
        readings.take(message)
    readings.forget()
    assert readings.missing([0], 0) == [0]
    assert readings.clock_ns == 0


def test_the_time_is_the_latest_of_clocks_and_scans(readings: Readings) -> None:
    readings.take(Clock(stamp_ns=600))
    readings.take(scan(0, 400))
    assert readings.clock_ns == 600
    readings.take(scan(0, 800))
    assert readings.clock_ns == 800
    readings.take(Clock(stamp_ns=700))
    assert readings.clock_ns == 800, "that clock was late"


def test_scans_that_wait_are_behind_the_clock(readings: Readings) -> None:
    assert readings.behind_ns([0, 1]) == 0, "nothing is known yet"
    for message in (scan(0, 400), scan(1, 200), scan(1, 300), Clock(stamp_ns=900)):
        readings.take(message)
    assert readings.behind_ns([0, 1]) == 600
    assert readings.behind_ns([0]) == 500
