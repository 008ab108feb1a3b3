"""Eight angles at once have the cosines and sines of each alone, bit for bit."""

import math

import numpy as np
import pytest

from zswarm.kernels.angles import are_near, turned
from zswarm.kernels.jit import interpreted
from zswarm.kernels.portable import FAR, cos, sin
from zswarm.kernels.random import Stream


@pytest.mark.parametrize("most", [1.0, 8.0, 1000.0, FAR])
def test_lanes_of_angles_turn_with_the_bits_of_sin_and_cos(most: float) -> None:
    with interpreted():
        for lanes in Stream(4).uniform(-most, most, 800).reshape(100, 8):
            assert are_near(lanes)
            cosines, sines = turned(lanes)
            assert cosines.tolist() == [cos(angle) for angle in lanes.tolist()]
            assert sines.tolist() == [sin(angle) for angle in lanes.tolist()]
        for far in (math.nan, math.inf, -2 * FAR):
            assert not are_near(np.array([0.0] * 7 + [far]))
