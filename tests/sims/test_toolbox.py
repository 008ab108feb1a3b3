"""Bodies and sensors: right, the same compiled and in Python, and on their data sheet."""

import math
import re
from typing import Any

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.kernels.jit import interpreted
from zswarm.kernels.random import Stream
from zswarm.sims import toolbox
from zswarm.sims.toolbox import (
    blurred,
    disturbed,
    drive,
    in_frame,
    neighbours,
    range_and_bearing,
    ray,
)

SHEET = (REPOSITORY / "docs" / "toolbox.md").read_text()
WALLS = np.array([[0.0, -1.0, 10.0, 0.0], [4.0, 2.0, 5.0, 3.0]])
PLACES = np.array([[1.0, 1.0], [3.0, 1.0], [1.0, 4.0], [9.0, 9.0]])


def stream() -> np.ndarray:
    return np.array([7], np.uint64)


def test_a_robot_drives_straight_turns_on_the_spot_and_along_an_arc() -> None:
    assert drive(1.0, 2.0, 0.0, 0.5, 0.5, 0.1, 2.0) == (2.0, 2.0, 0.0)
    assert drive(1.0, 2.0, 0.5, -0.05, 0.05, 0.1, 1.0) == (1.0, 2.0, 1.5)
    x, y, heading = drive(0.0, 0.0, 0.0, 0.9, 1.1, 0.2, 1.0)
    assert heading == pytest.approx(1.0)
    assert (x, y) == (pytest.approx(math.cos(0.5)), pytest.approx(math.sin(0.5)))


def test_offsets_are_seen_in_the_robots_frame() -> None:
    assert in_frame(0.0, 2.0, math.pi / 2) == pytest.approx((2.0, 0.0))
    assert in_frame(-1.0, 0.0, math.pi / 2) == pytest.approx((0.0, 1.0))
    assert range_and_bearing(3.0, 4.0, 0.0) == pytest.approx((5.0, math.atan2(4, 3)))
    assert range_and_bearing(0.0, 0.0, 1.0) == (0.0, 0.0)


def test_neighbours_are_listed_in_order() -> None:
    found = np.full(4, -1)
    assert neighbours(PLACES, 0, 3.5, found) == 2
    assert found.tolist() == [1, 2, -1, -1]
    assert neighbours(PLACES, 0, 2.0, found) == 0, "exactly at the reach is not nearer"


@pytest.mark.parametrize(
    ("angle", "length"),
    [
        (0.0, 1.5),  # a robot, less its radius
        (-math.pi / 2, 1.0),  # a wall
        (math.pi, 5.0),  # nothing
        (math.atan2(1.5, 3.5), math.hypot(3.0, 9 / 7)),  # the side of the box
    ],
)
def test_a_ray_ends_at_what_is_nearest(angle: float, length: float) -> None:
    assert ray(PLACES, 0, angle, 0.5, WALLS, 5.0) == pytest.approx(length)


def test_noise_has_its_size_and_limits() -> None:
    drawn = stream()
    readings = np.array([disturbed(0.98, 0.1, drawn) for _ in range(500)])
    assert 0.88 <= readings.min() < 0.9 < readings.max() == 1.0
    drawn = stream()
    readings = np.array([blurred(3.0, 0.5, drawn) for _ in range(500)])
    assert readings.mean() == pytest.approx(3.0, abs=0.1)
    assert readings.std() == pytest.approx(0.5, abs=0.05)


def example() -> Any:
    """Return the function of the data sheet."""
    (block,) = re.findall(r"^```python\n(.*?)^```", SHEET, re.S | re.M)
    namespace: dict[str, Any] = {}
    exec(compile(block, "toolbox.md", "exec"), namespace)  # noqa: S102  our own text
    return namespace["observe_one"]


def test_the_sensors_of_the_data_sheet_read_the_same_in_python() -> None:
    """The compiled functions are called from Python, then all of it is interpreted."""
    robots = Stream(3).uniform(0.5, 9.5, 30).reshape(10, 3)
    observe = example().py_func
    rows = []
    for number in range(2):
        row, drawn = np.empty(10, np.float32), stream()
        if number:
            with interpreted():
                observe(robots, 2, WALLS, np.zeros(10, np.int64), drawn, row)
        else:
            observe(robots, 2, WALLS, np.zeros(10, np.int64), drawn, row)
        rows.append(row.tobytes() + drawn.tobytes())
    assert rows[0] == rows[1]


def test_the_data_sheet_has_every_function() -> None:
    rows = re.findall(r"^\| `(\w+)\((.*?)\)` \|", SHEET, re.M)
    assert sorted(name for name, _ in rows) == toolbox.__all__
    for name, arguments in rows:
        code = getattr(toolbox, name).py_func.__code__
        assert arguments.split(", ") == list(code.co_varnames[: code.co_argcount])
