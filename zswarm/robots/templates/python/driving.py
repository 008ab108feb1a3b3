"""When a robot decides and when it stops: messages and the time in, velocities out.

Nothing of ROS is here, so it can be tried without a robot.
"""

from __future__ import annotations

from typing import NamedTuple


class Scan(NamedTuple):
    """A laser scan."""

    stamp_ns: int
    ranges: object  # (rays,) float32, m
    angle_min: float  # radians from the robot's front, counter-clockwise
    angle_increment: float


class Pose(NamedTuple):
    """Where the robot is, from its odometry or from what localises it."""

    stamp_ns: int
    x: float  # m
    y: float
    z: float  # of the quaternion of its heading
    w: float


class Velocity(NamedTuple):
    """What the robot is to do."""

    linear: float  # m/s ahead
    angular: float  # rad/s counter-clockwise


class Blind(Exception):
    """The scanner does not look where the evolved robot's did."""


STOP = Velocity(0.0, 0.0)


class Driving:
    """One robot on its way.

    A robot decides each ``step_s`` by the newest scan and pose (``on_step``). In lock-step, for simulations that wait for each
    decision, it decides whenever scan and pose of one stamp have come, and the simulation says what stops.

    Args:
        robot: what decides, see ``robot.py``.
        watchdog_s: so long after the last new scan, pose or decision the robot stops.
        arrived_m: it stops for good nearer than this to a target.

    Attributes:
        arrived: whether it did.
        silent: whether its sensors are.
    """

    def __init__(self, robot, watchdog_s, arrived_m, lock_step=False):
        self._robot, self._watchdog_s, self._arrived_m, self._lock_step = robot, watchdog_s, arrived_m, lock_step
        self._decided_s = None
        self._forget()

    def on_scan(self, now_s, scan):
        """A scan came; gives a velocity in lock-step when its pose was there before."""
        if self._scan is not None and scan.stamp_ns < self._scan.stamp_ns:
            self._forget()  # a simulation began anew
        if self._scan is None or scan.stamp_ns != self._scan.stamp_ns:  # a driver that hangs may repeat its last
            self._scan, self._scan_s = scan, now_s
        return self._together(now_s)

    def on_pose(self, now_s, pose):
        """A pose came; gives a velocity in lock-step when its scan was there before."""
        if self._pose is not None and pose.stamp_ns < self._pose.stamp_ns:
            self._forget()
        if self._pose is None or pose.stamp_ns != self._pose.stamp_ns:
            self._pose, self._pose_s = pose, now_s
        return self._together(now_s)

    def on_step(self, now_s):
        """Another ``step_s`` passed; gives a velocity, or None before the first scan and pose."""
        if self._lock_step or self._scan is None or self._pose is None:
            return None
        self.silent = now_s - min(self._scan_s, self._pose_s) > self._watchdog_s
        if self.arrived or self.silent:
            self._decided_s = now_s
            return STOP
        return self._decide(now_s)

    def on_watch(self, now_s):
        """The watchdog looks: gives a velocity when the robot must stop now, else None."""
        if self._lock_step or self._decided_s is None:
            return None
        both = self._scan is not None and self._pose is not None  # or they began anew, and one of them does not come
        self.silent = now_s - (min(self._scan_s, self._pose_s) if both else self._decided_s) > self._watchdog_s
        return STOP if self.silent or now_s - self._decided_s > self._watchdog_s else None

    def _together(self, now_s):
        both = self._lock_step and self._scan is not None and self._pose is not None
        if not both or self._scan.stamp_ns != self._pose.stamp_ns or self._scan.stamp_ns == self._last_ns:
            return None
        self._last_ns = self._scan.stamp_ns
        return self._decide(now_s)

    def _decide(self, now_s):
        self._decided_s = now_s
        decision = self._robot.step(self._scan, self._pose)
        if decision is None:
            raise Blind(f"the scanner does not cover the {self._robot.view_degrees:g} degrees that the controller needs")
        if not self._lock_step and decision.distance < self._arrived_m:
            self.arrived = True
            return STOP
        return Velocity(decision.linear, decision.angular)

    def _forget(self):
        self._robot.reset()
        self._scan = self._pose = self._scan_s = self._pose_s = self._last_ns = None
        self.arrived = self.silent = False
