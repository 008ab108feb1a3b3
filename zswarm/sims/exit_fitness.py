"""Fitness of robots that leave a room: the paper's rule, and that of its authors' scripts."""

from collections.abc import Sequence

FARTHEST, LONGEST, ARRIVED = 50.0, 90, 0.2  # m, lines and m of ``cpswarm_log``


def last_distance(distances: Sequence[float]) -> float:
    """Return minus the sum of the robots' last distances to their nearest exit, in m."""
    total = 0.0
    for distance in distances:  # sum() compensates errors from Python 3.12 on
        total += distance
    return -total


def cpswarm_log(distances: Sequence[float], lines: Sequence[int]) -> float:
    """Return the mean over robots of 100 (50 - d) / 50 + (if d < .2) 100 (90 - t) / 90: 0 to 200.

    Args:
        distances: d, m, in the last line of each log; more than 50 counts as 50.
        lines: t, of each log; more than 90 count as 90.
    """
    total = 0.0
    for distance, count in zip(distances, lines, strict=True):
        far = min(distance, FARTHEST)
        long = min(count, LONGEST)
        total += (FARTHEST - far) / FARTHEST * 100
        if far < ARRIVED:
            total += (LONGEST - long) / LONGEST * 100
    return total / len(distances)
