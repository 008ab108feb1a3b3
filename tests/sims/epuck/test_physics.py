"""Compare the motion and the contacts of e-pucks with those of ARGoS."""

import math
from collections.abc import Iterator
from itertools import groupby

import pytest

from tests.sims.epuck.recorded import (
    COLLISIONS,
    WALL,
    Row,
    command,
    error,
    place,
    rows,
    world,
)
from zswarm.kernels.jit import interpreted
from zswarm.sims.epuck import physics

WITHIN = 1e-9  # m and radians
SEVERAL = 1e-4  # where more than two bodies touch: the order of contacts differs
MANY = {
    "corner": [(1.0, 0.2, 0.4)],
    "queue": [(1.1, 0.0, 0.0), (1.0, 0.0, 0.0), (0.9, 0.01, 0.0), (0.8, -0.01, 0.0)],
    "cross": [
        *((0.0, 0.0, 0.0), (0.2, 0.0, math.pi)),
        *((0.1, 0.2, -math.pi / 2), (0.1, -0.2, math.pi / 2)),
    ],
}


@pytest.fixture(autouse=True)
def _plain() -> Iterator[None]:
    with interpreted():
        yield


def cases(name: str) -> list[list[Row]]:
    """Return the rows of a file, case by case."""
    return [list(found) for _, found in groupby(rows(name), lambda row: row.case)]


@pytest.mark.parametrize("case", cases("wheels")[::3], ids=lambda case: case[0].case)
def test_a_free_robot_moves_as_recorded(case: list[Row]) -> None:
    """Also where a motor cannot follow at once, and after the command to stop."""
    made = world()
    place(made, 0, 0.0, 0.0, 0.3)
    left, right = map(float, case[0].parts[1:])
    for row in case[1:]:
        command(made, 0, *((left, right) if row.step <= 30 else (0.0, 0.0)))
        physics.drive(made)
        assert error(made, row) < WITHIN


def test_a_robot_follows_changing_commands_as_recorded() -> None:
    made = world()
    place(made, 0, 0.0, 0.0, 0.0)
    for row in rows("wheels_seq"):
        command(made, 0, *map(float, row.parts[1:]))
        physics.drive(made)
        assert error(made, row) < WITHIN


@pytest.mark.parametrize("case", cases("coll_robots"), ids=lambda case: case[0].case)
def test_two_robots_collide_as_recorded(case: list[Row]) -> None:
    made = world(2)
    for robot in range(2):
        start = COLLISIONS[case[0].case.removeprefix("rr_")][f"robot{robot}"]
        place(made, robot, start["x"], start["y"], start["heading"])
        command(made, robot, start["left"], start["right"])
    for step, found in groupby(case, lambda row: row.step):
        if step > 0:
            physics.drive(made)
        assert max(error(made, row) for row in found) < WITHIN


@pytest.mark.parametrize("case", cases("coll_wall")[::2], ids=lambda case: case[0].case)
def test_a_robot_hits_a_wall_as_recorded(case: list[Row]) -> None:
    """It slides along, at an angle."""
    made = world(walls=[WALL])
    place(made, 0, *case[0].numbers[:3])
    command(made, 0, *map(float, case[0].parts[2:] or (12, 12)))
    for row in case[1:]:
        physics.drive(made)
        assert error(made, row) < WITHIN


@pytest.mark.parametrize("case", cases("coll_many"), ids=lambda case: case[0].case)
def test_several_bodies_touch_nearly_as_recorded(case: list[Row]) -> None:
    starts = MANY[case[0].case]
    made = world(len(starts))
    for robot, start in enumerate(starts):
        place(made, robot, *start)
        command(made, robot, 12.0, 12.0)
    for step, found in groupby(case, lambda row: row.step):
        if step > 30:
            break
        physics.drive(made)
        assert max(error(made, row) for row in found) < SEVERAL
