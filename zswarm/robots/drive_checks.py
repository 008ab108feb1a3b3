"""Steps by which a packed robot checks itself at each start: messages in, velocities out, to the bit."""

from typing import NamedTuple

import numpy as np

from zswarm.controller import Controller
from zswarm.draws import Stream, derive_seed
from zswarm.robots import fitting
from zswarm.sims import robot_interface
from zswarm.sims.simulator import RobotInterface

STEPS = 4
FARTHER = 1.25  # than the scanner reaches, some readings say
AROUND_M = 3.0  # where the robot is in them


class DriveSteps(NamedTuple):
    """What a robot decides, step after step from the start of a trial.

    Attributes:
        ranges: (steps, rays) float32 m.
        poses: (steps, 4) float64: x, y, and z, w of the quaternion.
        decisions: (steps, 3) float64: m/s ahead, rad/s counter-clockwise, m to the nearest target.
    """

    ranges: np.ndarray
    poses: np.ndarray
    decisions: np.ndarray


def drive_steps(controller: Controller, interface: RobotInterface, speed: float, turn: float) -> DriveSteps:
    """Steps of a robot that goes at most so fast; the same controller has the same."""
    stream = Stream(derive_seed(0, "drive steps"))
    ranges = stream.uniform(0.0, FARTHER * interface.range, STEPS * interface.rays).astype(np.float32).reshape(STEPS, -1)
    poses = stream.uniform(-AROUND_M, AROUND_M, STEPS * 4).reshape(STEPS, 4)
    targets = np.array(interface.targets, np.float64).ravel()
    reach, count = np.float32(interface.range), len(interface.targets)
    scan, seen = np.empty(interface.rays, np.float32), np.empty(interface.sectors + 2, np.float32)
    driver, decisions = controller.driver(), []
    for readings, (x, y, z, w) in zip(ranges, poses.tolist(), strict=True):
        first, between = first_and_between(interface)
        robot_interface.fit_scan(readings, len(readings), first, between, interface.rays, interface.view, reach, scan)
        distance = robot_interface.observe(scan, interface.rays, reach, interface.sectors, x, y, z, w, targets, count, seen)
        drive, steer = driver.act(seen)
        linear, angular = robot_interface.velocity(drive, interface.speed), robot_interface.velocity(steer, interface.turn)
        decisions.append((fitting.limited(linear, speed), fitting.limited(angular, turn), distance))
    return DriveSteps(ranges, poses, np.array(decisions, np.float64))


def first_and_between(interface: RobotInterface) -> tuple[float, float]:
    """The angles of the first ray and between two, radians."""
    return -0.5 * interface.view, interface.view / (interface.rays - 1)
