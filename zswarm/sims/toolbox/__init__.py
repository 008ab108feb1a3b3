"""Bodies and sensors for simulators; docs/toolbox.md is the data sheet.

Each function is compiled where a kernel calls it, may also be called from Python, and has the same
bits in both. Lengths are in any one unit, angles in radians, from the x axis towards the y axis;
all numbers are float64.
"""

from zswarm.sims.toolbox.bodies import drive
from zswarm.sims.toolbox.sensor_noise import blurred, disturbed
from zswarm.sims.toolbox.sensors import (
    in_frame,
    inverse,
    neighbours,
    range_and_bearing,
    ray,
    to_disc,
    to_rectangle,
    to_square,
)

__all__ = [
    "blurred",
    "disturbed",
    "drive",
    "in_frame",
    "inverse",
    "neighbours",
    "range_and_bearing",
    "ray",
    "to_disc",
    "to_rectangle",
    "to_square",
]
