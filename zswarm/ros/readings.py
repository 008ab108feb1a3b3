"""What is known of robots by their messages: the newest scan and pose of each, and the time."""

from collections.abc import Iterable

import numpy as np

from zswarm.ros.messages import Clock, Message, Odometry, Scan
from zswarm.sims.robot_interface import fit
from zswarm.sims.simulator import RobotInterface


class Readings:
    """The newest of each robot.

    Attributes:
        clock_ns: the latest time of the simulation that its clock or a scan told; 0 before.
    """

    def __init__(self, interface: RobotInterface, *, truth: bool) -> None:
        """Know nothing yet.

        Args:
            truth: poses are from ground truth, and not from odometry.
        """
        self._interface, self._truth = interface, truth
        self.forget()

    def forget(self) -> None:
        """A trial begins: all that is known is of before."""
        self._scans: dict[int, Scan] = {}
        self._poses: dict[int, Odometry] = {}
        self.clock_ns = 0

    def take(self, message: Message) -> None:
        """Note what a message says."""
        match message:
            case Clock():  # of different topics messages come in any order
                self.clock_ns = max(self.clock_ns, message.stamp_ns)
            case Scan():
                self._scans[message.robot] = message
                self.clock_ns = max(self.clock_ns, message.stamp_ns)
            case Odometry() if message.truth == self._truth:
                self._poses[message.robot] = message

    def missing(self, robots: Iterable[int], due_ns: int) -> list[int]:
        """Those of whom there is no scan, or no pose, from that time on."""
        return [
            robot
            for robot in robots
            if not all(robot in newest and newest[robot].stamp_ns >= due_ns for newest in (self._scans, self._poses))
        ]

    def fill(self, robots: Iterable[int], scans: np.ndarray, poses: np.ndarray) -> int:
        """Write scans and poses of robots that are not missing; gives the latest stamp, ns.

        Args:
            scans: (all robots, rays) float32, m; as the controllers' own scanner would read.
            poses: (all robots, 4) float64: x, y, z, w.
        """
        latest = 0
        for robot in robots:
            scan, pose = self._scans[robot], self._poses[robot]
            fit(
                scan.ranges, scan.angle_min, scan.angle_increment, self._interface.view, np.float32(self._interface.range),
                scans[robot],
            )  # fmt: skip
            poses[robot] = pose.x, pose.y, pose.z, pose.w
            latest = max(latest, scan.stamp_ns)
        return latest
