"""The newest scans and poses of robots, paired by their stamps; and the simulation's time."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import TypeVar

import numpy as np

from zswarm.ros.link.messages import Clock, Message, Odometry, Scan
from zswarm.sims.robot_interface import fit
from zswarm.sims.simulator import RobotInterface

Reading = TypeVar("Reading", Scan, Odometry)
KEPT = 64  # scans, and poses, of each robot
SEEN = 5  # scans after which the simulation's interval is known


class Readings:
    """The newest messages of each robot.

    Attributes:
        clock_ns: the latest time in a clock message or scan; 0 before the first.
    """

    def __init__(self, interface: RobotInterface, *, truth: bool) -> None:
        """Start empty; poses are from ground truth, or from odometry."""
        self._interface, self._truth = interface, truth
        self._intervals: list[int] = []
        self.forget()

    @property
    def interval_ns(self) -> int:
        """The shortest time between two scans of a robot; 0 until enough were seen."""
        return min(self._intervals) if len(self._intervals) >= SEEN else 0

    def forget(self) -> None:
        """Drop all messages: a trial begins."""
        self._scans: dict[int, dict[int, Scan]] = defaultdict(dict)  # by robot, by stamp
        self._poses: dict[int, dict[int, Odometry]] = defaultdict(dict)
        self._previous_ns: dict[int, int] = {}  # of each robot's last scan
        self.clock_ns = 0

    def take(self, message: Message) -> None:
        """Store a message."""
        match message:
            case Clock():  # messages of different topics come in any order
                self.clock_ns = max(self.clock_ns, message.stamp_ns)
            case Scan():
                self._measure(message)
                _store(self._scans[message.robot], message)
                self.clock_ns = max(self.clock_ns, message.stamp_ns)
            case Odometry() if message.truth == self._truth:
                _store(self._poses[message.robot], message)

    def missing(self, robots: Iterable[int], due_ns: int) -> list[int]:
        """Return robots without a scan, or a pose, from that time on."""
        return [robot for robot in robots if not self._has_both(robot, due_ns)]

    def behind_ns(self, robots: Iterable[int]) -> int:
        """Return how much older than the clock robots' newest scans are at most; 0 without any."""
        newest = [max(self._scans[each]) for each in robots if self._scans[each]]
        return max([0, *(self.clock_ns - stamp_ns for stamp_ns in newest)])

    def fill(
        self, robots: Sequence[int], due_ns: int, scans: np.ndarray, poses: np.ndarray
    ) -> int:
        """Write scans and poses of robots that are not missing; return the latest stamp, ns.

        All are of the newest stamp that all of them have. Where there is none, as where scanner
        and odometry have clocks of their own, they are each robot's newest scan and the pose that
        is next to it in time.

        Args:
            robots: those to write.
            due_ns: no older stamp is used.
            scans: (all robots, rays) float32, m; as the controllers' own scanner would read.
            poses: (all robots, 4) float64: x, y, z, w.
        """
        stamps = [self._scans[each].keys() & self._poses[each].keys() for each in robots]
        common_ns = max(set.intersection(*stamps), default=-1)
        latest = 0
        for robot in robots:
            stamp_ns = common_ns if common_ns >= due_ns else max(self._scans[robot])
            own = self._poses[robot]
            pose = own[min(own, key=lambda at: (abs(at - stamp_ns), -at))]
            self._fit(self._scans[robot][stamp_ns], scans[robot])
            poses[robot] = pose.x, pose.y, pose.z, pose.w
            latest = max(latest, stamp_ns)
        return latest

    def _has_both(self, robot: int, due_ns: int) -> bool:
        both = (self._scans[robot], self._poses[robot])
        return all(max(stamps, default=-1) >= due_ns for stamps in both)

    def _measure(self, scan: Scan) -> None:
        """Note the time since the robot's previous scan."""
        passed = scan.stamp_ns - self._previous_ns.get(scan.robot, scan.stamp_ns)
        self._previous_ns[scan.robot] = scan.stamp_ns
        if passed > 0 and len(self._intervals) < KEPT:
            self._intervals.append(passed)

    def _fit(self, scan: Scan, ranges: np.ndarray) -> None:
        reach, view = np.float32(self._interface.range), self._interface.view
        fit(scan.ranges, scan.angle_min, scan.angle_increment, view, reach, ranges)


def _store(messages: dict[int, Reading], message: Reading) -> None:
    """Add a message; one with an earlier stamp than the last shows that the time began again."""
    if messages and message.stamp_ns < next(reversed(messages)):
        messages.clear()
    messages[message.stamp_ns] = message
    if len(messages) > KEPT:
        del messages[next(iter(messages))]
