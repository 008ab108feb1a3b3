"""Sensors: what robots see of walls and of each other."""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

import numpy as np

from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.portable import atan2, cos, sin

STEEP = 1e12  # in place of 1 / 0


@inline(counts=False)
def in_frame(dx, dy, heading):
    """Return an offset in a robot's frame: ahead, and aside, to where a growing heading turns."""
    cosine = cos(heading)
    sine = sin(heading)
    return dx * cosine + dy * sine, dy * cosine - dx * sine


@inline(counts=False)
def range_and_bearing(dx, dy, heading):
    """Return the distance of an offset, and its angle from a heading, from -pi to pi."""
    ahead, aside = in_frame(dx, dy, heading)
    return sqrt(dx * dx + dy * dy), atan2(aside, ahead)


@inline(counts=False)
def neighbours(places, robot, reach, found):
    """List the robots whose centres are nearer to a robot's centre than ``reach``.

    Args:
        places: (robots, 2 or more) float64: x, y.
        robot: the index of the robot, which is not listed.
        found: (robots,) int64; the first elements are set to indices, in order.

    Returns:
        their number.
    """
    number = 0
    for other in range(places.shape[0]):
        dx = places[other, 0] - places[robot, 0]
        dy = places[other, 1] - places[robot, 1]
        if other != robot and dx * dx + dy * dy < reach * reach:
            found[number] = other
            number += 1
    return number


@inline(counts=False)
def ray(places, robot, angle, radius, walls, reach):
    """Return how far a ray from a robot's centre gets to walls and other robots, at most ``reach``.

    Args:
        places: (robots, 2 or more) float64: x, y.
        robot: the index of the robot from which it starts; its own body is passed.
        angle: of the ray, from the x axis.
        radius: of all robots, which are discs.
        walls: (walls, 4) float64: left, top, right, bottom.
    """
    dx = cos(angle)
    dy = sin(angle)
    per_x = inverse(dx)
    per_y = inverse(dy)
    x = places[robot, 0]
    y = places[robot, 1]
    far = reach
    for wall in range(walls.shape[0]):
        left = walls[wall, 0] - x
        top = walls[wall, 1] - y
        right = walls[wall, 2] - x
        bottom = walls[wall, 3] - y
        far = to_rectangle(left, top, right, bottom, per_x, per_y, far)
    for other in range(places.shape[0]):
        if other != robot:
            far = to_disc(places[other, 0] - x, places[other, 1] - y, dx, dy, radius, far)
    return far


@inline
def to_disc(x, y, dx, dy, radius, most):
    """Return a ray's length to a disc, at most ``most``; its centre is relative to the start."""
    along = x * dx + y * dy
    aside = y * dx - x * dy
    chord = radius * radius - aside * aside
    if along > 0.0 and chord > 0.0:
        return min(most, max(along - np.sqrt(chord), 0.0))
    return most


@inline
def to_rectangle(left, low, right, high, per_x, per_y, most):
    """Return a ray's length to a rectangle, at most ``most``; sides are relative to its start.

    Args:
        per_x, per_y: ``inverse`` of the ray's direction, a unit vector.
    """
    x_1 = left * per_x
    x_2 = right * per_x
    y_1 = low * per_y
    y_2 = high * per_y
    enter = max(min(x_1, x_2), min(y_1, y_2))
    leave = min(max(x_1, x_2), max(y_1, y_2))
    if enter > leave or leave < 0.0 or enter > most:
        return most
    return max(enter, 0.0)


@inline
def to_square(x, y, c, s, size, dx, dy, most):
    """Return a ray's length to a square that is turned, at most ``most``.

    Its centre is relative to the ray's start, ``c`` and ``s`` are cosine and sine of its angle,
    and ``size`` is half its side.
    """
    along = c * x + s * y
    aside = c * y - s * x
    left, right = along - size, along + size
    low, high = aside - size, aside + size
    per_along, per_aside = inverse(c * dx + s * dy), inverse(c * dy - s * dx)
    return to_rectangle(left, low, right, high, per_along, per_aside, most)


@inline
def inverse(x):
    """Return 1 / x, and something large for what is nearly 0."""
    if abs(x) * STEEP < 1.0:
        return -STEEP if x < 0.0 else STEEP
    return 1.0 / x
