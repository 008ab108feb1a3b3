"""A robot that decides: compiled where the package was built with a C compiler, else in Python with the same bits, slowly."""

from __future__ import annotations

import ctypes
import os
from typing import NamedTuple

import numpy as np

from . import driving, settings

LIBRARY = os.path.join(os.path.dirname(os.path.abspath(__file__)), "librobot.so")


class Decision(NamedTuple):
    """What a robot decided."""

    linear: float  # m/s ahead
    angular: float  # rad/s counter-clockwise
    distance: float  # m to the nearest target


def build(targets=settings.TARGETS, speed=settings.SPEED, turn=settings.TURN):
    """The robot, and how it computes, for the log.

    Args:
        targets: m: x, y of the first, of the second ...; as many as it was evolved with.
        speed: m/s, at most what is in the settings.
        turn: rad/s, likewise.

    Raises:
        ValueError: what it may not do; or its self-test fails: this machine does not compute what was evolved.
    """
    if len(targets) != len(settings.TARGETS) or not np.isfinite(targets).all():
        raise ValueError(f"targets: expected {len(settings.TARGETS)} numbers: x, y of each target in m")
    for name, value, most in (("speed", speed, settings.SPEED), ("turn", turn, settings.TURN)):
        if not 0 <= value <= most:
            raise ValueError(f"{name}: expected 0 to {most:g}, not {value:g}")
    kind = Compiled if os.path.exists(LIBRARY) else Plain
    robot = kind(np.array(targets, np.float64), float(speed), float(turn))
    wrong = robot.selftest()
    if wrong:
        raise ValueError(f"the self-test of {settings.NAME} fails: this machine computes other numbers than those evolved")
    return robot, kind.how


class Compiled:
    """By the C functions of ``librobot.so``."""

    how = "compiled"
    view_degrees = settings.VIEW_DEGREES

    class _Decision(ctypes.Structure):
        _fields_ = (("linear", ctypes.c_double), ("angular", ctypes.c_double), ("distance", ctypes.c_double))

    def __init__(self, targets, speed, turn):
        self._library = ctypes.CDLL(LIBRARY)
        self._step = self._library.robot_step
        self._step.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, *[ctypes.c_double] * 6, ctypes.c_void_p]

        class State(ctypes.Structure):
            _fields_ = (
                ("network", ctypes.c_float * self._state_size()),
                ("targets", ctypes.c_double * len(targets)),
                ("speed", ctypes.c_double),
                ("turn", ctypes.c_double),
            )

        self._robot, self._decision = State(), self._Decision()
        self._library.robot_init(ctypes.byref(self._robot))
        self._robot.targets[:] = targets
        self._robot.speed, self._robot.turn = speed, turn

    def _state_size(self):
        return settings.STATE

    def selftest(self):
        """Which step of the self-test differs; 0 when all is well."""
        return self._library.robot_selftest()

    def reset(self):
        """The controller forgets all of before."""
        self._library.robot_forget(ctypes.byref(self._robot))

    def step(self, scan, pose):
        """A decision; None when the scanner does not cover what the controller needs."""
        ranges = np.ascontiguousarray(scan.ranges, np.float32)
        blind = self._step(
            ctypes.byref(self._robot), ranges.ctypes.data, len(ranges), scan.angle_min, scan.angle_increment,
            pose.x, pose.y, pose.z, pose.w, ctypes.byref(self._decision),
        )  # fmt: skip
        return None if blind else Decision(self._decision.linear, self._decision.angular, self._decision.distance)


class Plain:
    """By the Python that the C functions were translated from."""

    how = "without a compiler: in Python, slowly"
    view_degrees = settings.VIEW_DEGREES

    def __init__(self, targets, speed, turn):
        from . import kernels, network

        self._kernels, self._network, self._controller = kernels, network, network.Controller()
        self._targets, self._speed, self._turn = targets, speed, turn
        self._scan = np.zeros(settings.RAYS, np.float32)
        self._observation = np.zeros(self._controller.inputs, np.float32)

    def selftest(self):
        """Whether a step of the self-test differs; 0 when all is well."""
        evolved = Plain(np.array(settings.TARGETS, np.float64), settings.SPEED, settings.TURN)
        decided = []
        for ranges, pose in zip(settings.CHECK_RANGES, settings.CHECK_POSES):
            scan = driving.Scan(0, ranges, settings.FIRST, settings.BETWEEN)
            decided.append(evolved.step(scan, driving.Pose(0, *pose)))
        expected = [Decision(*decision) for decision in settings.CHECK_DECISIONS]
        return self._network.selftest() or int(repr(decided) != repr(expected))

    def reset(self):
        """The controller forgets all of before."""
        self._controller.reset()

    def step(self, scan, pose):
        """A decision; None when the scanner does not cover what the controller needs."""
        ranges, kernels, reach = np.asarray(scan.ranges, np.float32), self._kernels, np.float32(settings.RANGE)
        if not kernels.covers(len(ranges), scan.angle_min, scan.angle_increment, settings.VIEW):
            return None
        kernels.fit_scan(
            ranges, len(ranges), scan.angle_min, scan.angle_increment, settings.RAYS, settings.VIEW, reach, self._scan
        )
        distance = kernels.observe(
            self._scan, settings.RAYS, reach, settings.SECTORS, pose.x, pose.y, pose.z, pose.w,
            self._targets, len(self._targets) // 2, self._observation,
        )  # fmt: skip
        drive, turn = self._controller.act(self._observation)
        return Decision(
            kernels.limited(float(kernels.velocity(drive, settings.EVOLVED_SPEED)), self._speed),
            kernels.limited(float(kernels.velocity(turn, settings.EVOLVED_TURN)), self._turn),
            float(distance),
        )
