"""When a robot decides and when it stops: messages and the time in, velocities out. Without ROS."""

from __future__ import annotations

from typing import NamedTuple


class Scan(NamedTuple):
    """A laser scan."""

    stamp_ns: int
    ranges: object  # (rays,) numbers, m
    angle_min: float  # radians from the robot's front, counter-clockwise
    angle_increment: float


class Pose(NamedTuple):
    """The robot's pose, from its odometry or its localisation."""

    stamp_ns: int
    x: float  # m
    y: float
    z: float  # of the quaternion of its heading
    w: float


class Velocity(NamedTuple):
    """A command to the robot."""

    linear: float  # m/s ahead
    angular: float  # rad/s counter-clockwise


class Blind(Exception):
    """The scanner does not cover the view of the evolved robot."""


STOP = Velocity(0.0, 0.0)


class Driving:
    """One robot on its way.

    A robot decides each ``step_s`` by the newest scan and pose (``on_step``). In lock-step, for
    simulations that wait for each decision, it decides whenever scan and pose of one stamp have
    come, and the simulation decides when it stops. Each ``on_`` function returns a velocity to
    send, or None.

    Args:
        robot: decides, see ``robot.py``.
        watchdog_s: so long after the last new scan, pose or decision the robot stops.
        arrived_m: it stops for good nearer than this to a target.

    Attributes:
        arrived: whether it stopped at a target.
        silent: whether its sensors are silent.
    """

    def __init__(self, robot, watchdog_s, arrived_m, lock_step=False):
        self._robot, self._lock_step = robot, lock_step
        self._watchdog_s, self._arrived_m = watchdog_s, arrived_m
        self._decided_s = None
        self._logged = (False, False)
        self._forget()

    def on_message(self, now_s, message):
        """Take a LaserScan or an Odometry of ROS 2."""
        stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if hasattr(message, "ranges"):
            angles = float(message.angle_min), float(message.angle_increment)
            return self.on_scan(now_s, Scan(stamp_ns, message.ranges, *angles))
        place = message.pose.pose.position
        heading = message.pose.pose.orientation
        return self.on_pose(now_s, Pose(stamp_ns, place.x, place.y, heading.z, heading.w))

    def on_scan(self, now_s, scan):
        """Take a scan; decide in lock-step if its pose has come."""
        if self._scan is not None and scan.stamp_ns < self._scan.stamp_ns:
            self._forget()  # a simulation restarted
        # A driver that hangs may repeat its last message.
        if self._scan is None or scan.stamp_ns != self._scan.stamp_ns:
            self._scan, self._scan_s = scan, now_s
        return self._together(now_s)

    def on_pose(self, now_s, pose):
        """Take a pose; decide in lock-step if its scan has come."""
        if self._pose is not None and pose.stamp_ns < self._pose.stamp_ns:
            self._forget()
        if self._pose is None or pose.stamp_ns != self._pose.stamp_ns:
            self._pose, self._pose_s = pose, now_s
        return self._together(now_s)

    def on_step(self, now_s):
        """Decide, once every ``step_s``; not before the first scan and pose."""
        if self._lock_step or self._scan is None or self._pose is None:
            return None
        self.silent = now_s - min(self._scan_s, self._pose_s) > self._watchdog_s
        if self.arrived or self.silent:
            self._decided_s = now_s
            return STOP
        return self._decide(now_s)

    def on_watch(self, now_s):
        """Stop the robot if the watchdog is due."""
        if self._lock_step or self._decided_s is None:
            return None
        # After a restart one of them may not come again.
        both = self._scan is not None and self._pose is not None
        last_s = min(self._scan_s, self._pose_s) if both else self._decided_s
        self.silent = now_s - last_s > self._watchdog_s
        return STOP if self.silent or now_s - self._decided_s > self._watchdog_s else None

    def news(self):
        """Return what to log since the last call."""
        silent, arrived = self._logged
        self._logged = (self.silent, self.arrived)
        if self.silent and not silent:
            return f"stopped: no new scan or odometry for {self._watchdog_s:g} s"
        if silent and not self.silent:
            return "scans and odometry come again: driving"
        if self.arrived and not arrived:
            return f"stopped: nearer than {self._arrived_m:g} m to a target"
        return None

    def _together(self, now_s):
        if not self._lock_step or self._scan is None or self._pose is None:
            return None
        stamp_ns = self._scan.stamp_ns
        if stamp_ns != self._pose.stamp_ns or stamp_ns == self._last_ns:
            return None
        self._last_ns = stamp_ns
        return self._decide(now_s)

    def _decide(self, now_s):
        self._decided_s = now_s
        decision = self._robot.step(self._scan, self._pose)
        if decision is None:
            degrees = f"{self._robot.view_degrees:g} degrees"
            raise Blind(
                f"the scanner does not cover the {degrees} that the controller needs"
            )
        if not self._lock_step and decision.distance < self._arrived_m:
            self.arrived = True
            return STOP
        return Velocity(decision.linear, decision.angular)

    def _forget(self):
        self._robot.reset()
        self._scan = self._pose = self._scan_s = self._pose_s = self._last_ns = None
        self.arrived = self.silent = False
