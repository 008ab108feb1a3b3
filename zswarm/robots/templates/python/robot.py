"""A robot that decides: compiled if the package was built with a C compiler, else in slow Python.

Both have the same bits.
"""

from __future__ import annotations

import ctypes
import os
from ctypes import c_double, c_float, c_int64, c_void_p
from typing import NamedTuple

import numpy as np

from . import driving, settings

LIBRARY = os.path.join(os.path.dirname(os.path.abspath(__file__)), "librobot.so")


class Decision(NamedTuple):
    """The decision of a robot."""

    linear: float  # m/s ahead
    angular: float  # rad/s counter-clockwise
    distance: float  # m to the nearest target


def build(targets=settings.TARGETS, speed=settings.SPEED, turn=settings.TURN):
    """Return the robot, and a line about it for the log.

    Args:
        targets: m: x, y of the first, of the second ...; as many as it was evolved with.
        speed: m/s, at most that in the settings.
        turn: rad/s, likewise.

    Raises:
        ValueError: a limit is too high; or its self-test fails: this machine computes other numbers
            than those evolved.
    """
    count = len(settings.TARGETS)
    if len(targets) != count or not np.isfinite(targets).all():
        raise ValueError(f"targets: expected {count} numbers: x, y of each target in m")
    for name, value, most in (
        ("speed", speed, settings.SPEED),
        ("turn", turn, settings.TURN),
    ):
        if not 0 <= value <= most:
            raise ValueError(f"{name}: expected 0 to {most:g}, not {value:g}")
    kind = Compiled if os.path.exists(LIBRARY) else Plain
    robot = kind(np.array(targets, np.float64), float(speed), float(turn))
    if robot.selftest():
        reason = "this machine computes other numbers than those evolved"
        raise ValueError(f"the self-test of {settings.NAME} fails: {reason}")
    limits = f"at most {speed:g} m/s and {turn:g} rad/s"
    parameters = f"parameters {settings.SHA256[:12]}"
    return robot, f"{settings.NAME} drives: {limits}, {parameters}, {kind.how}"


class _State(ctypes.Structure):
    _fields_ = [
        ("network", c_float * settings.STATE),
        ("targets", c_double * len(settings.TARGETS)),
        ("speed", c_double),
        ("turn", c_double),
    ]


class Compiled:
    """A robot that calls the C functions of ``librobot.so``."""

    how = "compiled"
    view_degrees = settings.VIEW_DEGREES

    def __init__(self, targets, speed, turn):
        self._library = ctypes.CDLL(LIBRARY)
        self._step = self._library.robot_step
        self._step.argtypes = [c_void_p, c_void_p, c_int64, *[c_double] * 6, c_void_p]
        self._robot, self._decision = _State(), (c_double * len(Decision._fields))()
        self._library.robot_init(ctypes.byref(self._robot))
        self._robot.targets[:] = targets
        self._robot.speed, self._robot.turn = speed, turn

    def selftest(self):
        """Return the step of the self-test that differs; 0 for none."""
        return self._library.robot_selftest()

    def reset(self):
        """Clear the controller's memory."""
        self._library.robot_forget(ctypes.byref(self._robot))

    def step(self, scan, pose):
        """Decide; return None if the scanner does not cover what the controller needs."""
        ranges = np.ascontiguousarray(scan.ranges, np.float32)
        angles, place = (
            (scan.angle_min, scan.angle_increment),
            (pose.x, pose.y, pose.z, pose.w),
        )
        robot, decision = ctypes.byref(self._robot), ctypes.byref(self._decision)
        if self._step(robot, ranges.ctypes.data, len(ranges), *angles, *place, decision):
            return None
        return Decision(*self._decision)


class Plain:
    """A robot in Python, with numpy alone."""

    how = "without a compiler: in Python, slowly"
    view_degrees = settings.VIEW_DEGREES

    def __init__(self, targets, speed, turn):
        # Slow to import, and not needed where it is compiled.
        from . import kernels, network

        self._kernels, self._network, self._controller = (
            kernels,
            network,
            network.Controller(),
        )
        self._targets, self._speed, self._turn = targets, speed, turn
        self._scan = np.zeros(settings.RAYS, np.float32)
        self._observation = np.zeros(self._controller.inputs, np.float32)

    def selftest(self):
        """Return whether a step of the self-test differs."""
        evolved = Plain(
            np.array(settings.TARGETS, np.float64), settings.SPEED, settings.TURN
        )
        observed, decided = [], []
        for ranges, pose, action in zip(
            settings.CHECK_RANGES, settings.CHECK_POSES, settings.CHECK_ACTIONS
        ):
            scan = driving.Scan(0, ranges, settings.FIRST, settings.BETWEEN)
            distance = evolved._observe(scan, driving.Pose(0, *pose))
            observed.append(evolved._observation.tolist())
            decided.append([*evolved._drive(np.array(action, np.float32)), distance])
        computed = repr([observed, decided])
        expected = repr([settings.CHECK_OBSERVATIONS, settings.CHECK_DECISIONS])
        return self._network.selftest() or int(computed != expected)

    def reset(self):
        """Clear the controller's memory."""
        self._controller.reset()

    def step(self, scan, pose):
        """Decide; return None if the scanner does not cover what the controller needs."""
        angles = (scan.angle_min, scan.angle_increment)
        if not self._kernels.covers(len(scan.ranges), *angles, settings.VIEW):
            return None
        distance = self._observe(scan, pose)
        action = self._controller.act(self._observation)
        return Decision(*self._drive(action), distance)

    def _observe(self, scan, pose):
        """Fill the observation; return the distance to the nearest target."""
        kernels, seen = self._kernels, self._observation
        rays, view, reach = settings.RAYS, settings.VIEW, np.float32(settings.RANGE)
        ranges = np.asarray(scan.ranges, np.float32)
        angles = (scan.angle_min, scan.angle_increment)
        kernels.fit_scan(ranges, len(ranges), *angles, rays, view, reach, self._scan)
        scanner = (self._scan, rays, reach, settings.SECTORS)
        place, count = (pose.x, pose.y, pose.z, pose.w), len(self._targets) // 2
        return float(kernels.observe(*scanner, *place, self._targets, count, seen))

    def _drive(self, action):
        """Return the velocities of an action."""
        kernels, (drive, turn) = self._kernels, action
        linear = float(kernels.velocity(drive, settings.EVOLVED_SPEED))
        angular = float(kernels.velocity(turn, settings.EVOLVED_TURN))
        return kernels.limited(linear, self._speed), kernels.limited(angular, self._turn)
