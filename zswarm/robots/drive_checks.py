"""The self-test of a packed robot: what it must observe, and how fast it must drive.

The controller's own self-test is separate, so that the robot may get another controller.
"""

from typing import NamedTuple

import numpy as np

from zswarm.kernels.random import Stream, derive_seed
from zswarm.robots.scan_checks import limited
from zswarm.sims.robot_interface import fit_scan, observe, velocity
from zswarm.sims.simulator import RobotInterface

STEPS = 4
BEYOND = 1.25  # some readings exceed the scanner's range, up to this multiple
AROUND_M = 3.0  # poses are within this distance of the origin


class DriveSteps(NamedTuple):
    """Steps of a robot.

    Attributes:
        ranges: (steps, rays) float32 m.
        poses: (steps, 4) float64: x, y, and z, w of the quaternion.
        observations: (steps, sectors + 2) float32, of these.
        actions: (steps, 2) float32.
        decisions: (steps, 3) float64: m/s ahead and rad/s counter-clockwise, of the actions; m to
            the nearest target, of the poses.
    """

    ranges: np.ndarray
    poses: np.ndarray
    observations: np.ndarray
    actions: np.ndarray
    decisions: np.ndarray


def drive_steps(interface: RobotInterface, speed: float, turn: float) -> DriveSteps:
    """Return the steps of a robot with such limits, m/s and rad/s; they never change."""
    rays, sectors, view = interface.rays, interface.sectors, interface.view
    stream = Stream(derive_seed(0, "drive steps"))
    ranges = stream.uniform(0.0, BEYOND * interface.range, STEPS * rays).astype(
        np.float32
    )
    ranges = ranges.reshape(STEPS, -1)
    poses = stream.uniform(-AROUND_M, AROUND_M, STEPS * 4).reshape(STEPS, 4)
    targets = np.array(interface.targets, np.float64).ravel()
    reach, count = np.float32(interface.range), len(interface.targets)
    actions = stream.uniform(-0.25, 1.25, STEPS * 2).astype(np.float32).reshape(STEPS, 2)
    scan, seen = np.empty(rays, np.float32), np.empty((STEPS, sectors + 2), np.float32)
    angles, decisions = first_and_between(interface), []
    for step in range(STEPS):
        readings, pose = ranges[step], poses[step].tolist()
        fit_scan(readings, len(readings), *angles, rays, view, reach, scan)
        distance = observe(scan, rays, reach, sectors, *pose, targets, count, seen[step])
        drive, steer = actions[step]
        linear = limited(velocity(drive, interface.speed), speed)
        angular = limited(velocity(steer, interface.turn), turn)
        decisions.append((linear, angular, distance))
    return DriveSteps(ranges, poses, seen, actions, np.array(decisions, np.float64))


def first_and_between(interface: RobotInterface) -> tuple[float, float]:
    """Return the angles of the first ray and between two, radians."""
    return -0.5 * interface.view, interface.view / (interface.rays - 1)
