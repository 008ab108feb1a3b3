"""Score the published missions, start as published, and compute the same bits in plain Python."""

import math
from typing import Any

import numpy as np
import pytest

from tests.sims.epuck.recorded import place, world
from zswarm.errors import ConfigError
from zswarm.evaluate import build
from zswarm.kernels.jit import interpreted
from zswarm.sims.epuck import generated, missions, trial
from zswarm.sims.epuck.arenas import HEXAGON, THIRD, TRIANGLE, disc
from zswarm.sims.epuck.missions import NAMES
from zswarm.sims.epuck.simulator import Epuck, EpuckSettings
from zswarm.sims.epuck.walls import square_to
from zswarm.sims.epuck.world import ANGLE, RADIUS, TOUCHES, X, Y

FAR = [(0.9, 0.9 - 0.08 * robot) for robot in range(20)]  # where no mission scores


def scored(mission: str, poses: list[tuple[float, float]], steps: int = 1) -> float:
    """Return the score of robots that stand still."""
    made = world(len(poses), mission)
    with interpreted():
        for robot, (x, y) in enumerate(poses):
            place(made, robot, x, y, 0.0)
        for _ in range(steps):
            missions.score(made)
        fitness = np.zeros(1)
        missions.judge(made, fitness, np.zeros(1))
        again = np.zeros(1)
        missions.judge(made, again, np.zeros(1))
    assert fitness[0] == again[0]
    return float(fitness[0])


@pytest.mark.parametrize(
    ("mission", "inside", "score"),
    [
        ("aggregation", [(0.0, 0.6), (0.0, 0.31)], 4.0),
        ("aac", [(0.29, 0.6)], 2.0),
        ("sca", [(0.0, 0.0), (0.2, 0.07)], 4.0),
        ("sca", [(0.31, 0.0)], 0.0),
    ],
)
def test_robots_in_a_place_score_in_each_step(
    mission: str, inside: list[tuple[float, float]], score: float
) -> None:
    assert scored(mission, [*inside, *FAR[:3]], steps=2) == score


def test_an_object_is_delivered_once() -> None:
    made = world(1, "foraging")
    with interpreted():
        for x, y in [(0.0, -0.7), (0.75, 0.1), (0.0, 0.0), (0.0, -0.7), (0.0, -0.8)]:
            place(made, 0, x, y, 0.0)
            missions.score(made)
    assert made.tally[0] == 1.0


def test_cells_count_the_steps_since_a_visit() -> None:
    """One robot: in step t, 99 cells have waited for t - 1 steps."""
    steps = 5
    waited = sum(99 * step for step in range(steps))
    assert scored("grid-exploration", [(0.1, 0.1)], steps) == -waited / 100


def test_one_robot_covers_its_disc() -> None:
    area = scored("lcn", [(0.1, 0.2)])
    assert area == pytest.approx(math.pi * 0.25**2, rel=0.03)
    assert scored("lcn", [(0.1, 0.2), (0.1, 0.4), (-0.9, -0.2)]) > 1.3 * area


def test_robots_on_the_square_and_the_circle_cover_them() -> None:
    spread = [(-0.75 + 0.15 * k, 0.15 * row) for k in range(3) for row in (-1, 0, 1)]
    ring = [
        (0.6 + 0.3 * math.cos(k * math.pi / 5), 0.3 * math.sin(k * math.pi / 5))
        for k in range(10)
    ]
    empty = -(0.85 / 0.08 + 0.6 / 0.06)
    assert scored("spc", FAR[:5]) == pytest.approx(empty)
    assert -3.0 < scored("spc", spread + ring) < 0.0


@pytest.mark.long
def test_the_published_coverage_hardly_depends_on_the_robots() -> None:
    near, spread = [(0.0, 0.0)], [(0.0, 0.0), (0.8, 0.0), (0.0, 0.9), (0.0, -0.9)]
    assert 249.97 < scored("cfa", near) <= 250.0
    assert scored("cfa-corrected", spread) > scored("cfa-corrected", near) + 10.0


def test_robots_start_apart_in_the_disc() -> None:
    made = world(20)
    with interpreted():
        for seed in range(5):
            trial.start(made, np.uint64(seed))
            x, y = made.robots[[X, Y], : made.number]
            apart = np.sqrt((x - x[:, None]) ** 2 + (y - y[:, None]) ** 2)
            assert (apart[~np.eye(20, dtype=bool)] >= 2 * RADIUS).all()
            assert (np.sqrt(x * x + y * y) <= 1.2).all()
            assert (made.robots[ANGLE] >= 0.0).all()


def test_robots_start_before_the_shelter_is_built() -> None:
    """As in ARGoS: some overlap the shelter's walls, none those of the arena."""
    made = world(20, "sca")
    inner = outer = 0
    with interpreted():
        for seed in range(10):
            trial.start(made, np.uint64(seed))
            for index, wall in enumerate(made.walls):
                squares = [
                    square_to(wall, *made.robots[[X, Y], one]) for one in range(20)
                ]
                overlaps = sum(square < RADIUS * RADIUS for square in squares)
                if index < made.outer_walls:
                    outer += overlaps
                else:
                    inner += overlaps
    assert inner > 0
    assert outer == 0


def test_generated_missions_have_the_published_distribution() -> None:
    """Shares are within three deviations of 2,000 draws; a seed always draws the same."""
    drawn = [generated.mission(seed) for seed in range(2_000)]
    assert drawn[:20] == [generated.mission(seed) for seed in range(20)]
    for share, count in [
        (0.2, sum(one.score == "deliveries" for one in drawn)),
        (0.4, sum(one.score == "homing" for one in drawn)),
        (0.5, sum(one.robots == 15 for one in drawn)),
        (0.25, sum(one.seconds == 60.0 for one in drawn)),
        (1 / 3, sum(one.arena is TRIANGLE.arena for one in drawn)),
        (0.1, sum(len(one.walls) == 3 for one in drawn)),
        (0.41, sum(one.lamp[-1] > 0.0 for one in drawn)),
        (0.4, sum(one.at_end for one in drawn)),
    ]:
        deviation = math.sqrt(2_000 * share * (1 - share))
        assert abs(count - 2_000 * share) < 3 * deviation, share


@pytest.mark.parametrize("seed", [0, 1, 3, 7, 9, 13])
def test_robots_of_generated_missions_start_inside_and_apart(seed: int) -> None:
    """Also on one side, or off all spots; the picture has all of them."""
    simulator = Epuck(EpuckSettings(mission="generated", mission_seed=seed))
    made, mission = simulator.world, generated.mission(seed)
    with interpreted():
        trial.start(made, np.uint64(seed))
    x, y = made.robots[[X, Y], : made.number]
    apart = np.sqrt((x - x[:, None]) ** 2 + (y - y[:, None]) ** 2)
    assert (apart[~np.eye(made.number, dtype=bool)] >= 2 * RADIUS).all()
    for wall in mission.arena.outer:
        away = math.hypot(wall[0], wall[1]) - wall[2]
        assert ((x * wall[0] + y * wall[1]) / math.hypot(*wall[:2]) < away).all()
    frame = simulator.frame()
    robots = [body for body in frame.bodies if body.kind.startswith("robot")]
    assert len(robots) == mission.robots
    assert all(0.0 < body.x < frame.width for body in frame.bodies if body.kind != "lamp")


def test_robots_at_home_count_in_each_step_or_at_the_end() -> None:
    home = HEXAGON.arena.around * THIRD
    made = world(3, "homing")
    with interpreted():
        for robot, y in enumerate((home, home - 0.29, 0.0)):
            place(made, robot, 0.0, y, 0.0)
        missions.score(made)
        missions.score(made)
        assert made.tally[0] == 4.0
        missions.score(made._replace(at_end=1))
        assert made.tally[0] == 2.0


def test_the_home_with_most_robots_counts_as_a_share() -> None:
    made = world(4, "homing")
    floor = np.array([disc(0.5, 0.0, 0.3), disc(-0.5, 0.0, 0.3)], np.float64)
    made = made._replace(mission=missions.ONE_SPOT, floor=floor, spots=2)
    with interpreted():
        for robot, x in enumerate((0.5, 0.4, -0.5, 0.0)):
            place(made, robot, x, 0.0, 0.0)
        missions.score(made)
    assert made.tally[0] == 0.5


def test_objects_go_from_any_source_to_any_nest() -> None:
    made = world(1, "homing")
    floor = np.array(
        [disc(0.0, 0.8, 0.3), disc(0.0, -0.8, 0.3), disc(0.0, 0.0, 0.15)], np.float64
    )
    made = made._replace(mission=missions.DELIVERIES, floor=floor, spots=2)
    with interpreted():
        for y in (0.8, 0.0, -0.3, -0.7, 0.7, 0.1, 0.6):
            place(made, 0, 0.0, y, 0.0)
            missions.score(made)
    assert made.tally[0] == 2.0


def turns(settings: dict[str, Any]) -> list[bytes]:
    """Play a trial by actions that follow from observations; return all that came out."""
    simulator = Epuck(EpuckSettings(**settings))
    turn, seen = simulator.reset(3), []
    while turn is not None:
        seen.append(turn.observations.tobytes())
        turn = simulator.step(turn.observations[:, :2] + turn.observations[:, 8:10])
    outcome = simulator.outcome()
    return [*seen, np.array(outcome.fitness).tobytes()]


@pytest.mark.parametrize("mission", NAMES)
def test_plain_python_computes_the_same_bits(mission: str) -> None:
    model = "1.1" if mission == "spc" else "1.2"
    reality = "pseudo" if mission == "sca" else "design"
    settings = {"mission": mission, "reference_model": model, "reality": reality}
    settings |= {"robots": 12, "seconds": 1.5}
    with interpreted():
        plain = turns(settings)
    assert turns(settings) == plain


def test_a_mission_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"expected aggregation, .* not 'dance'"):
        build("epuck", {"mission": "dance"}, "feed-forward", {"hidden": []})


def test_robots_that_touch_are_no_longer_marked_after_a_step() -> None:
    made = world(2)
    with interpreted():
        place(made, 0, 0.0, 0.0, 0.0)
        place(made, 1, 0.06, 0.0, 0.0)
        trial.act(made, np.zeros(4, np.float32))
    assert not made.robots[TOUCHES].any()
