"""Light gives what FREVO recorded, by its rules."""

import math
from typing import Any

import numpy as np
import pytest

from tests.sims.naive_emergency_exit import java_below, java_random
from tests.sims.recorded import PROBLEMS, play
from zswarm.sims.light import Light, LightSettings
from zswarm.testing import check_simulator

LIGHT = PROBLEMS["light"]
STOP = np.full((1, 2), 0.5, np.float32)


def begun(seed: int = 1234, **world: float) -> Light:
    """Return a trial that has begun, with other numbers in its world."""
    simulator = Light(LightSettings())
    simulator.reset(seed)
    for number, name in enumerate(("x", "y", "heading", "light_x", "light_y")):
        simulator.world.state[number] = world.get(name, simulator.world.state[number])
    return simulator


def seen(**world: float) -> list[float]:
    return [float(number) for number in begun(**world)._turn().observations[0]]


@pytest.mark.parametrize("net", LIGHT["nets"], ids=range(len(LIGHT["nets"])))
def test_fitness_is_frevos(net: dict[str, Any]) -> None:
    """Over 1 to 20 evaluations; nearer than the 1e-12 that other sines could make of it."""
    fitness = play(
        "light", {}, net, list(Light(LightSettings()).fixed_seeds(20))
    ).fitness[:, 0]
    for count, mean in net["mean_fitness_over_evaluations"].items():
        assert sum(fitness[: int(count)].tolist()) / int(count) == pytest.approx(
            mean, rel=1e-12
        )


@pytest.mark.parametrize("evaluation", range(20))
def test_lights_and_headings_are_frevos(evaluation: int) -> None:
    simulator = Light(LightSettings(heading_seed=LIGHT["generator_seed"]))
    simulator.reset(simulator.fixed_seeds(20)[evaluation])
    assert simulator.world.state[2] == LIGHT["start_direction_deg"][evaluation]
    assert simulator.world.state[3:].tolist() == pytest.approx(
        LIGHT["targets"][evaluation], rel=1e-12, abs=1e-12
    )


@pytest.mark.parametrize(("seed", "heading_seed"), [(1234, 1), (0, 0), (2**48 - 1, 77)])
def test_headings_are_successive_draws_of_javas_generator(
    seed: int, heading_seed: int
) -> None:
    simulator = Light(LightSettings(seed=seed, heading_seed=heading_seed))
    words = java_random(heading_seed)
    for trial in range(50):
        simulator.reset(seed + trial)
        assert simulator.world.state[2] == java_below(360, words)


@pytest.mark.parametrize(
    "settings", [{"steps": 1}, {"steps": 30, "seed": 0, "heading_seed": 2**48 - 1}]
)
def test_light_keeps_the_contract(settings: dict[str, int]) -> None:
    check_simulator(Light, settings)


def test_sensors_without_light_in_view_read_like_a_touched_light() -> None:
    """FREVO's reading, kept: 1 - 0 / 70."""
    assert seen(heading=180.0, light_x=0.0, light_y=-50.0) == [1.0, 1.0]


def test_a_light_ahead_is_seen_by_both_sensors_the_nearer_the_brighter() -> None:
    away = math.hypot(5.0, 50.0)
    assert seen(heading=0.0, light_x=0.0, light_y=-50.0) == pytest.approx(
        [1 - away / 70] * 2, rel=1e-6
    )
    assert seen(heading=-450.0, light_x=-20.0, light_y=0.0) == pytest.approx(
        [1 - math.hypot(5.0, 20.0) / 70] * 2, rel=1e-6
    )
    left, right = seen(heading=0.0, light_x=-10.0, light_y=-40.0)
    assert left > right


@pytest.mark.parametrize(("light_y", "left"), [(-69.9, 1 - 69.9 / 70), (-70.1, 1.0)])
def test_a_sensor_has_a_range_of_seventy(light_y: float, left: float) -> None:
    """The distance is measured from the sensor's place on the robot's left edge."""
    assert seen(heading=0.0, light_x=-5.0, light_y=light_y)[0] == pytest.approx(
        left, abs=1e-6
    )


@pytest.mark.parametrize(
    ("degrees", "is_seen"), [(22.0, True), (-22.0, True), (23.0, False), (-23.0, False)]
)
@pytest.mark.parametrize("heading", [0.0, 359.0, 1.0, 180.0, -10.0])
def test_a_sensor_sees_a_quarter_of_a_right_angle_to_each_side(
    heading: float, degrees: float, is_seen: bool
) -> None:
    turned, towards = math.radians(heading - 90), math.radians(heading + degrees)
    x, y = (
        5 * math.sin(turned) + 30 * math.sin(towards),
        -5 * math.cos(turned) - 30 * math.cos(towards),
    )
    assert (seen(heading=heading, light_x=x, light_y=y)[0] < 1.0) == is_seen


def test_a_wall_stops_the_robot_from_every_direction() -> None:
    """It does not slide along the wall, and continues to turn."""
    simulator = begun(x=95.0, heading=45.0, light_x=0.0, light_y=0.0)
    simulator.step(np.array([[1.0, 1.0]], np.float32))
    assert simulator.world.state[:3].tolist() == [95.0, 0.0, 45.0]
    simulator.step(np.array([[1.0, 0.75]], np.float32))
    assert simulator.world.state[:2].tolist() == [95.0, 0.0]
    assert simulator.world.state[2] > 45.0


def test_an_idle_robot_has_the_fitness_of_the_data_sheet() -> None:
    simulator = begun()
    while simulator.step(STOP) is not None:
        pass
    outcome = simulator.outcome()
    assert outcome.fitness[0] == pytest.approx(0.4 / math.e)
    assert list(outcome.metrics) == [0, 300, math.hypot(*LIGHT["targets"][0]), 0, 0]


def test_a_trial_ends_when_the_light_is_touched_but_not_in_the_first_step() -> None:
    """FREVO does not count the first step."""
    simulator = begun(light_x=6.0, light_y=0.0)
    assert simulator.step(STOP) is not None
    assert simulator.step(STOP) is None
    assert simulator.outcome().fitness[0] == pytest.approx(0.7 + 0.3 * math.exp(-6 / 70))
    assert list(simulator.outcome().metrics) == [1, 0, 6, 0, 0]
    assert simulator.frame().bodies[0].kind == "robot at the light"


def test_a_trial_has_one_step_more_than_the_setting() -> None:
    simulator = Light(LightSettings(steps=3))
    simulator.reset(1)
    assert [simulator.step(STOP) is None for _ in range(4)] == [False, False, False, True]


def test_the_frame_shows_robot_and_light_where_they_are() -> None:
    frame = begun(x=10.0, y=20.0, heading=90.0, light_x=-80.0, light_y=0.0).frame()
    (robot,) = frame.bodies
    light = next(place for place in frame.places if place.kind == "light")
    assert (robot.kind, robot.x, robot.y, robot.radius) == ("robot", 120.0, 130.0, 5.0)
    assert robot.heading == 0.0, "to the right"
    left, right = frame.rays
    assert (left.sensor, left.aside, right.sensor, right.aside) == (0, -5.0, 1, 5.0)
    assert (light.x + light.width / 2, light.y + light.height / 2) == (30.0, 110.0)
