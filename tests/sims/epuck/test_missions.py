"""Score the published missions, start as published, and compute the same bits in plain Python."""

import math
from typing import Any

import numpy as np
import pytest

from tests.sims.epuck.recorded import place, world
from zswarm.errors import ConfigError
from zswarm.evaluate import build
from zswarm.kernels.jit import interpreted
from zswarm.sims.epuck import missions, trial
from zswarm.sims.epuck.missions import NAMES
from zswarm.sims.epuck.simulator import Epuck, EpuckSettings
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


def test_the_published_coverage_hardly_depends_on_the_robots() -> None:
    near, spread = [(0.0, 0.0)], [(0.0, 0.0), (0.8, 0.0), (0.0, 0.9), (0.0, -0.9)]
    assert 249.97 < scored("cfa", near) <= 250.0
    assert scored("cfa-corrected", spread) > scored("cfa-corrected", near) + 10.0


def test_robots_start_apart_in_the_disc() -> None:
    made = world(20)
    with interpreted():
        for seed in range(5):
            trial.start(made, np.uint64(seed))
            x, y = made.robots[[X, Y]]
            apart = np.sqrt((x - x[:, None]) ** 2 + (y - y[:, None]) ** 2)
            assert (apart[~np.eye(20, dtype=bool)] >= 2 * RADIUS).all()
            assert (np.sqrt(x * x + y * y) <= 1.2).all()
            assert (made.robots[ANGLE] >= 0.0).all()


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
