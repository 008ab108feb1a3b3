"""Compare the readings of e-pucks, and what their controllers see, with those of ARGoS."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from tests.sims.epuck.recorded import FOLDER, WALL, command, place, rows, world
from zswarm.kernels.jit import interpreted
from zswarm.kernels.lanes import LANES
from zswarm.kernels.portable import PI
from zswarm.sims.epuck import physics, reference_models, sensors
from zswarm.sims.epuck.reference_models import DIRECTIONS, SENSOR_NAMES
from zswarm.sims.epuck.world import (
    GROUND,
    HEARD,
    HEARD_X,
    HEARD_Y,
    LIGHT,
    MIDDLE_GREY,
    PROXIMITY,
    STEP_NUMBER,
    EpuckWorld,
)

WITHIN = 1e-9
INPUTS = len(SENSOR_NAMES[2])
FLOOR = {"0": 0.0, "1": MIDDLE_GREY, "2": 1.0}
FLOORS = ["aac", "foraging", "sca", "spc", "lcn", "cfa"]


@pytest.fixture(autouse=True)
def _plain() -> Iterator[None]:
    with interpreted():
        yield


def readings(made: EpuckWorld, first: int, count: int = 8, robot: int = 0) -> np.ndarray:
    """Return readings of a robot."""
    sensors.sense(made)
    found: np.ndarray = made.robots[first : first + count, robot]
    return found


def inputs(made: EpuckWorld) -> np.ndarray:
    """Return what the controllers see, float64."""
    found = np.zeros(INPUTS * made.number)
    reference_models.interpret(made, found)
    return found


def projected(length: float, angle: float) -> list[float]:
    """Return the inputs that show a vector."""
    return [max(length * math.cos(angle - other), 0.0) for other in DIRECTIONS]


def test_proximity_of_a_robot_is_as_recorded() -> None:
    """Also of robots in contact, whose nearest sensors see nothing."""
    made = world(2)
    for row in rows("prox_robot"):
        distance, bearing = float(row.parts[2]), math.radians(float(row.parts[3]))
        place(made, 0, 0.0, 0.0, 0.0)
        place(made, 1, distance * math.cos(bearing), distance * math.sin(bearing), 0.0)
        assert readings(made, PROXIMITY) == pytest.approx(row.numbers, abs=WITHIN)


def test_proximity_of_a_wall_is_as_recorded() -> None:
    made = world(walls=[WALL])
    for row in rows("prox_wall"):
        distance, heading = map(float, row.parts[2:])
        place(made, 0, 0.495 - distance, 0.0, math.radians(heading))
        assert readings(made, PROXIMITY) == pytest.approx(row.numbers, abs=WITHIN)


def test_light_and_its_vector_are_as_recorded() -> None:
    made = world()
    for row in rows("light"):
        x, y, heading = map(float, row.parts[1:])
        place(made, 0, x, y, math.radians(heading))
        assert readings(made, LIGHT) == pytest.approx(row.numbers[:8], abs=WITHIN)
        proximity, proximity_angle, light, light_angle = row.numbers[8:12]
        seen = inputs(made)
        expected = projected(proximity, proximity_angle)
        assert seen[:4] == pytest.approx(expected, abs=WITHIN)
        assert seen[4:8] == pytest.approx(projected(light, light_angle), abs=WITHIN)


def test_a_robot_hides_the_lamp_as_recorded() -> None:
    made = world(2)
    for row in rows("light_occl"):
        ahead, aside = map(float, row.parts[1:])
        place(made, 0, 0.0, 0.3, -math.pi / 2)
        place(made, 1, aside, 0.3 - ahead, 0.0)
        assert readings(made, LIGHT) == pytest.approx(row.numbers, abs=WITHIN)


def test_a_wall_hides_a_lamp_behind_it_from_robots_close_to_it() -> None:
    """The ray to the lamp is higher than the wall where it comes from farther away."""
    made = world(mission="lcn")
    place(made, 0, 0.0, 1.18, 0.0)
    assert readings(made, LIGHT).max() == 0.0
    place(made, 0, 0.0, 1.1, 0.0)
    assert readings(made, LIGHT).max() > 0.5


def test_ground_readings_are_as_recorded() -> None:
    """Except exactly on the line of a spot, where the last bit decides."""
    made = world()
    for row in rows("ground"):
        if row.case in ("ground_0_0.27_90", "ground_0_-0.27_270"):
            continue
        x, y, heading = map(float, row.parts[1:])
        place(made, 0, x, y, math.radians(heading))
        right_to_left = readings(made, GROUND, 3)
        assert right_to_left[::-1] == pytest.approx(row.numbers, abs=WITHIN)


def test_a_robot_votes_for_the_floor_as_recorded() -> None:
    """White and black take at least four steps."""
    made = world()
    place(made, 0, 0.0, 0.1, PI / 2)
    made.counts[STEP_NUMBER] = 1
    sensors.sense(made)
    inputs(made)
    for row in rows("ground_drive"):
        command(made, 0, 12.0, 12.0)
        physics.drive(made)
        made.counts[STEP_NUMBER] += 1
        found = readings(made, GROUND, 3)
        assert found[::-1] == pytest.approx(row.numbers[3:6], abs=WITHIN)
        seen = inputs(made)[8]
        assert (seen if seen in (0.0, 1.0) else 0.5) == row.numbers[10]


def test_a_robot_hears_others_as_recorded() -> None:
    made = world(2)
    for row in rows("rab"):
        distance, bearing, heading = float(row.parts[1]), *map(float, row.parts[2:])
        place(made, 0, 0.0, 0.0, math.radians(heading))
        angle = math.radians(bearing)
        place(made, 1, distance * math.cos(angle), distance * math.sin(angle), 0.0)
        heard, *vector = readings(made, HEARD, 3)
        packets = int(row.numbers[0])
        assert heard == packets
        if packets:
            reach, seen_at = row.numbers[2:4]
            length = 1 / (1 + reach) if seen_at != 0.0 else 0.0
            expected = [length * math.cos(seen_at), length * math.sin(seen_at)]
            assert vector == pytest.approx(expected, abs=WITHIN)


def test_robots_and_walls_hide_messages_as_recorded() -> None:
    made = world(3)
    for row in rows("rab_occl"):
        for robot, (x, y) in enumerate(
            [(0.0, 0.0), (0.4, 0.0), (0.2, float(row.parts[1]))]
        ):
            place(made, robot, x, y, 0.0)
        sensors.sense(made)
        assert made.robots[HEARD, row.robot] == row.numbers[0]
    made = world(2, walls=[(0.0, *WALL[1:])])
    for row in rows("rab_wall"):
        for robot, x in enumerate([-0.2, 0.2]):
            place(made, robot, x, float(row.parts[1]), 0.0)
        sensors.sense(made)
        assert made.robots[HEARD, row.robot] == row.numbers[0]


@pytest.mark.parametrize("mission", FLOORS)
def test_the_floor_is_as_recorded(mission: str) -> None:
    """Inside of the walls."""
    made = world(mission=mission)
    lines = (FOLDER / f"floor_{mission}.txt").read_text().splitlines()[1:]
    normals = [(math.cos(k * math.pi / 6), math.sin(k * math.pi / 6)) for k in range(12)]
    compared = 0
    for line, greys in enumerate(lines):
        for column, grey in enumerate(greys):
            x, y = -1.25 + 0.025 * column, -1.25 + 0.025 * line
            if max(x * a + y * b for a, b in normals) < 1.22:
                found = sensors.grey_at(made.floor, np.full(LANES, x), np.full(LANES, y))
                assert (found == FLOOR[grey]).all(), (x, y)
                compared += 1
    assert compared > 7_000


def test_messages_are_remembered_for_eleven_steps() -> None:
    made = world(2)
    place(made, 0, 0.0, 0.0, 0.0)
    place(made, 1, 0.0, 0.2, 0.0)
    lengths = []
    for step in range(1, 25):
        made.counts[STEP_NUMBER] = step
        made.robots[[HEARD, HEARD_X, HEARD_Y], 0] = 0.0
        if step == 1:
            sensors.sense(made)
        lengths.append(inputs(made)[10:14].max())
    assert lengths[0] > 0.0
    assert lengths[:11] == [lengths[0]] * 11
    assert lengths[11:] == [0.0] * 13
