"""The newest scan and pose of each robot, paired; and the simulation's time."""

from collections.abc import Iterable

import numpy as np

from zswarm.ros.link.messages import Clock, Message, Odometry, Scan
from zswarm.sims.robot_interface import fit
from zswarm.sims.simulator import RobotInterface


class Readings:
    """The newest messages of each robot.

    Attributes:
        clock_ns: the latest time in a clock message or scan; 0 before the first.
    """

    def __init__(self, interface: RobotInterface, *, truth: bool) -> None:
        """Start empty; poses are from ground truth, or from odometry."""
        self._interface, self._truth = interface, truth
        self.forget()

    def forget(self) -> None:
        """Drop all messages: a trial begins."""
        self._scans: dict[int, Scan] = {}
        self._poses: dict[int, Odometry] = {}
        self.clock_ns = 0

    def take(self, message: Message) -> None:
        """Store a message."""
        match message:
            case Clock():  # messages of different topics come in any order
                self.clock_ns = max(self.clock_ns, message.stamp_ns)
            case Scan():
                self._scans[message.robot] = message
                self.clock_ns = max(self.clock_ns, message.stamp_ns)
            case Odometry() if message.truth == self._truth:
                self._poses[message.robot] = message

    def missing(self, robots: Iterable[int], due_ns: int) -> list[int]:
        """Return robots without a scan, or a pose, from that time on."""
        return [robot for robot in robots if not self._has_both(robot, due_ns)]

    def _has_both(self, robot: int, due_ns: int) -> bool:
        both = (self._scans.get(robot), self._poses.get(robot))
        return all(each is not None and each.stamp_ns >= due_ns for each in both)

    def fill(self, robots: Iterable[int], scans: np.ndarray, poses: np.ndarray) -> int:
        """Write scans and poses of robots that are not missing; return the latest stamp, ns.

        Args:
            scans: (all robots, rays) float32, m; as the controllers' own scanner would read.
            poses: (all robots, 4) float64: x, y, z, w.
        """
        latest, view = 0, self._interface.view
        reach = np.float32(self._interface.range)
        for robot in robots:
            scan, pose = self._scans[robot], self._poses[robot]
            fit(
                scan.ranges,
                scan.angle_min,
                scan.angle_increment,
                view,
                reach,
                scans[robot],
            )
            poses[robot] = pose.x, pose.y, pose.z, pose.w
            latest = max(latest, scan.stamp_ns)
        return latest
