"""Convert a robot's messages to a controller's observation, and its action to a velocity.

Messages are those of ROS: a laser scan (float32 ranges, the first at ``angle_min``, then one every
``angle_increment`` radians counter-clockwise), a pose (x, y in m, and z, w of the quaternion of a
robot on a floor, float64), and a velocity (m/s ahead, rad/s counter-clockwise, float64). Simulators
whose controllers drive such robots observe through these functions, and robots run the same ones,
translated to C: so they take arrays, numbers and all sizes as arguments, and allocate nothing.
``RobotInterface`` holds the numbers.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

import numpy as np

from zswarm.kernels.jit import array, float32, float64, inline, kernel, sqrt, void
from zswarm.kernels.portable import PI

ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)
# Radians; a scan whose rays are closer than this is not usable.
FINEST = 1e-6
MOST_PLACES = 1e7
# Readings below are ROS's minus infinity (REP 117): nearer than the scanner can measure.
TOO_CLOSE = np.float32(-3e38)


@inline
def fit_scan(ranges, readings, angle_min, angle_increment, rays, view, reach, fitted):
    """Convert any scanner's readings to the controller's: in each ray the shortest that fall in it.

    0 and below, NaN, and what is farther than ``reach`` are nothing there, which is ``reach``, as
    is where no ray looks; minus infinity is 0. A scan of the controller's own scanner stays as it
    is.

    Args:
        ranges: (readings,) float32, m.
        angle_min, angle_increment: float64, radians; the increment is below 0 for a scanner that is
        mounted upside down.
        rays, view: of the controller's scanner: its rays, and radians from the first to the last,
        half of them to each side.
        reach: float32, m.
        fitted: (rays,) float32, filled.
    """
    spread = view / (rays - 1)
    for ray in range(rays):
        fitted[ray] = shortest_around(
            ranges,
            readings,
            angle_min,
            angle_increment,
            ray * spread - 0.5 * view,
            0.5 * spread,
            reach,
        )


@inline
def shortest_around(ranges, readings, angle_min, angle_increment, angle, half, reach):
    """Return the shortest range within ``half`` radians of an angle; ``reach`` without an obstacle.

    If no ray is that near, use the nearest one.
    """
    shortest = reach
    spacing = abs(angle_increment)
    if not spacing > FINEST:
        return shortest
    place, near = (angle - angle_min) / angle_increment, half / spacing
    if near < 0.5:
        near = 0.5
    if not abs(place) + near < MOST_PLACES:
        return shortest
    # Readings in a full turn: some scanners begin ahead, others behind.
    around = int(2.0 * PI / spacing + 0.5)
    for step in range(int(place - near) - 1, int(place + near) + 2):
        if abs(step - place) <= near:
            which = step
            if which < 0:
                which = step + around
            elif which >= readings:
                which = step - around
            if 0 <= which < readings:
                if ranges[which] < TOO_CLOSE:
                    shortest = ZERO
                elif ZERO < ranges[which] < shortest:
                    shortest = ranges[which]
    return shortest


@kernel(void(array(float32), float64, float64, float64, float32, array(float32)))
def fit(ranges, angle_min, angle_increment, view, reach, fitted):
    """Call ``fit_scan`` from Python."""
    fit_scan(
        ranges,
        ranges.shape[0],
        angle_min,
        angle_increment,
        fitted.shape[0],
        view,
        reach,
        fitted,
    )


@inline
def observe(scan, rays, reach, sectors, x, y, z, w, targets, count, observation):
    """Write a controller's observation; return the distance to the nearest target, float64, m.

    First, from the right to the left, how near something is in each part of the scan: 1 - shortest
    range / ``reach``. Then the direction of the nearest target (the first of equals), a unit
    vector: ahead, to the left; zeros on the target itself.

    Args:
        scan: (rays,) float32 m, at most ``reach``; see ``fit_scan``.
        reach: float32, m.
        x, y, z, w: float64, the pose.
        targets: (2 count,) float64: x, y of the first, of the second ...; there is one at least.
        observation: (sectors + 2,) float32, filled.
    """
    for sector in range(sectors):
        nearest = reach
        for ray in range(sector * rays // sectors, (sector + 1) * rays // sectors):
            if scan[ray] < nearest:
                nearest = scan[ray]
        observation[sector] = ONE - nearest / reach
    to_x, to_y = targets[0] - x, targets[1] - y
    square = to_x * to_x + to_y * to_y
    for target in range(1, count):
        dx, dy = targets[2 * target] - x, targets[2 * target + 1] - y
        if dx * dx + dy * dy < square:
            to_x, to_y, square = dx, dy, dx * dx + dy * dy
    distance = sqrt(square)
    # Of a robot that is tilted a little, z and w are not quite a unit vector.
    ahead, left = w * w - z * z, 2.0 * w * z
    size = sqrt(ahead * ahead + left * left)
    if distance > 0.0 and size > 0.0:
        observation[sectors] = np.float32(
            (to_x * ahead + to_y * left) / (size * distance)
        )
        observation[sectors + 1] = np.float32(
            (to_y * ahead - to_x * left) / (size * distance)
        )
    else:
        observation[sectors] = ZERO
        observation[sectors + 1] = ZERO
    return distance


@inline
def velocity(share, most):
    """Convert an action: 0 is full speed back or right, .5 none, 1 ahead or left; NaN is .5.

    Args:
        share: float32, an action's number.
        most: float64, m/s or rad/s.

    Returns:
        float64, m/s or rad/s.
    """
    if share != share:
        return 0.0
    cut = share
    if share < ZERO:
        cut = ZERO
    elif share > ONE:
        cut = ONE
    return np.float64(TWO * cut - ONE) * most
