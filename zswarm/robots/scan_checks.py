"""Checks in the packages of real robots, as kernels: they become C and Python there."""

from zswarm.kernels.jit import inline
from zswarm.kernels.portable import PI

FULL_TURN = 2.0 * PI
SLACK = 0.02  # radians; drivers round the angles of their scans


@inline
def covers(readings, angle_min, angle_increment, view):  # type: ignore[no-untyped-def]  # compiled
    """Return whether a scan covers the controller's view: missing directions would count as free.

    Args:
        readings: of a scan, int64.
        angle_min, angle_increment: float64 radians, of the first and between two.
        view: float64 radians, half of them to each side of the robot's front.
    """
    spacing = abs(angle_increment)
    span = spacing * (readings - 1)
    if not (
        readings > 1
        and spacing > 0.0
        and span < 2.0 * FULL_TURN
        and abs(angle_min) < 2.0 * FULL_TURN
    ):
        return False
    if span + spacing + SLACK >= FULL_TURN:
        return True
    first = angle_min
    if angle_increment < 0.0:
        first = angle_min - span
    slack = 0.5 * spacing + SLACK
    for turn in range(-2, 3):
        start = first + turn * FULL_TURN
        if start - slack <= -0.5 * view and start + span + slack >= 0.5 * view:
            return True
    return False


@inline
def limited(velocity, most):  # type: ignore[no-untyped-def]  # compiled
    """Limit a velocity, float64, to ``-most`` to ``most``; 0 for NaN."""
    if velocity != velocity:
        return 0.0
    if velocity > most:
        return most
    if velocity < -most:
        return -most
    return velocity
