"""The maze is what its data sheet says."""

import math
from typing import Any, get_args

import numpy as np
import pytest

from tests.sims.naive_maze import Maze as Naive
from zswarm.kernels.random import Stream
from zswarm.sims.maze import PLANS, WALLS, Maze, MazeSettings
from zswarm.testing import check_simulator

REST = np.full((1, 2), 0.5, np.float32)
AHEAD = np.array([[0.5, 1.0]], np.float32)
RANGES, COMPASS = slice(0, 6), slice(6, 10)


def naive(name: Any, steps: int) -> Naive:
    x, y, _, goal_x, goal_y, width, height = PLANS[name]
    walls = [((left, top), (right, bottom)) for left, top, right, bottom in WALLS[name]]
    return Naive((width, height), walls, (x, y), (goal_x, goal_y), steps)


def begun(**world: float) -> Maze:
    """Return a trial in the hard maze that has begun, with other numbers in its world."""
    simulator = Maze(MazeSettings())
    simulator.reset(1)
    for number, name in enumerate(("x", "y", "heading", "speed", "turning")):
        simulator.world.state[number] = world.get(name, simulator.world.state[number])
    return simulator


def seen(**world: float) -> list[float]:
    return [float(number) for number in begun(**world)._turn().observations[0]]


@pytest.mark.parametrize("settings", [{}, {"map": "medium", "steps": 1}])
def test_trials_of_400_steps_and_of_one_keep_the_contract(
    settings: dict[str, Any],
) -> None:
    """Play the default, 400 steps, and one step."""
    check_simulator(Maze, settings)


@pytest.mark.parametrize("name", ["medium", "hard"])
@pytest.mark.parametrize("seed", range(5))
def test_a_driving_robot_follows_an_independent_implementation(
    name: Any, seed: int
) -> None:
    """Compare sensors, positions and fitness with the naive implementation of the reference.

    The robot also bumps into walls.
    """
    simulator, other = Maze(MazeSettings(map=name)), naive(name, 400)
    turn, stream = simulator.reset(1), Stream(seed)
    going, held, bumps = True, np.zeros(2), 0
    while going:
        assert turn is not None
        assert turn.observations[0].tolist() == pytest.approx(other.observe(), abs=1e-6)
        if other.left % 10 == 0:
            held = stream.uniform(-0.2, 1.2, 2)  # beyond what networks say, too
        action = held.astype(np.float32)
        before = other.place
        turn, going = simulator.step(action[None]), other.act(action)
        bumps += other.place == before and other.speed != 0
        assert simulator.world.state[:3].tolist() == pytest.approx(
            [*other.place, other.heading], abs=1e-9
        )
        assert (turn is not None) == going
    outcome = simulator.outcome()
    assert outcome.fitness[0] == pytest.approx(other.fitness(), rel=1e-9)
    ended = [*other.place, float(other.is_there()), math.dist(other.place, other.goal)]
    assert list(outcome.metrics) == pytest.approx(ended, rel=1e-9)
    assert bumps


def test_the_settings_name_every_maze() -> None:
    assert (
        set(get_args(MazeSettings.__annotations__["map"].__origin__))
        == set(PLANS)
        == set(WALLS)
    )


@pytest.mark.parametrize("name", list(PLANS))
def test_walls_are_given_from_the_left_or_from_above(name: Any) -> None:
    """Range finders and robots rely on this order."""
    for left, top, right, bottom in WALLS[name]:
        assert (left == right and top < bottom) or (top == bottom and left < right)


@pytest.mark.parametrize("name", list(PLANS))
def test_the_goal_can_be_reached_in_time(name: Any) -> None:
    """Flood-fill the maze on a grid of a few centimetres.

    Even without diagonals, the path found is shorter than the robot can drive.
    """
    simulator = naive(name, 400)
    start_x, start_y, _, goal_x, goal_y, _, _ = PLANS[name]
    step = 0.05 if name == "medium" else 0.025
    goal = (round((goal_x - start_x) / step), round((goal_y - start_y) / step))
    ways, reached = {(0, 0): 0.0}, [(0, 0)]
    while reached and goal not in ways:
        ahead = []
        for column, row in reached:
            for there in (
                (column + 1, row),
                (column - 1, row),
                (column, row + 1),
                (column, row - 1),
            ):
                if there not in ways and simulator.is_free(
                    (start_x + step * there[0], start_y + step * there[1])
                ):
                    ways[there] = ways[column, row] + step
                    ahead.append(there)
        reached = ahead
    assert ways[goal] < 0.9 * 400 * 0.03
    assert ways[goal] > 1.5 * math.dist((start_x, start_y), (goal_x, goal_y)), (
        "no direct way"
    )


def test_the_dead_end_of_the_hard_maze_is_nearer_to_the_goal_than_most_of_the_detour() -> (
    None
):
    """A search that rewards nearness to the goal is deceived by this."""
    behind, round_it = begun(x=0.3, y=0.585), begun(x=1.7, y=0.5)
    assert behind.outcome().fitness[0] > 0.88
    assert round_it.outcome().fitness[0] < 0.5


def test_range_finders_look_to_the_left_ahead_to_the_right_and_back() -> None:
    """The robot heads right in the corridor below the goal, with walls at .5 above and .8 below."""
    diagonal = math.sqrt(2)
    expected = [0.1, 0.1 * diagonal, 0.8, 0.2 * diagonal, 0.2, 0.6]
    assert seen(x=1.2, y=0.6)[RANGES] == pytest.approx(expected, abs=1e-6)
    assert seen(x=1.2, y=0.6, heading=180.0)[RANGES] == pytest.approx(
        [0.2, 0.2 * diagonal, 0.6, 0.1 * diagonal, 0.1, 0.8], abs=1e-6
    )


def test_a_range_finder_sees_a_metre_far() -> None:
    assert seen(x=0.3, y=0.25)[2] == 1.0


@pytest.mark.parametrize(
    ("heading", "quarter"),
    [(-90.0, 0), (180.0, 1), (90.0, 2), (0.0, 3), (-50.0, 0), (-40.0, 3), (670.0, 0)],
)
def test_the_compass_tells_the_quarter_in_which_the_goal_is(
    heading: float, quarter: int
) -> None:
    """The robot is straight below the goal."""
    assert seen(x=0.3, y=1.0, heading=heading)[COMPASS] == [
        float(number == quarter) for number in range(4)
    ]


def test_a_robot_turns_before_it_drives_and_speeds_have_limits() -> None:
    simulator = begun(turning=2.75, speed=0.029)
    simulator.step(np.array([[1.0, 1.0]], np.float32))
    x, y, heading, speed, turning = simulator.world.state.tolist()
    assert (heading, speed, turning) == (3.0, 0.03, 3.0)
    assert (x, y) == pytest.approx(
        (0.3 + 0.03 * math.cos(math.radians(3)), 1.75 + 0.03 * math.sin(math.radians(3)))
    )


def test_a_wall_holds_the_robot_which_keeps_its_speeds_and_turns_on() -> None:
    simulator = begun(x=0.09, heading=180.0, speed=0.02, turning=1.0)
    simulator.step(REST)
    assert simulator.world.state.tolist() == [0.09, 1.75, 181.0, 0.02, 1.0]


def test_a_trial_ends_at_the_goal_and_the_time_saved_counts() -> None:
    simulator = begun(x=0.38, y=0.25, heading=180.0, speed=0.025)
    assert simulator.step(REST) is not None
    assert simulator.step(REST) is None
    assert simulator.outcome().fitness == [1 + 398 / 400]
    assert list(simulator.outcome().metrics) == pytest.approx([0.33, 0.25, 1.0, 0.03])
    assert simulator.frame().bodies[0].kind == "robot at the goal"


def test_reaching_the_goal_in_the_last_step_beats_not_reaching_it() -> None:
    simulator = Maze(MazeSettings(steps=1))
    simulator.reset(1)
    simulator.world.state[:] = 0.34, 0.25, 0.0, 0.0, 0.0
    assert simulator.step(REST) is None
    assert simulator.outcome().fitness == [1.0]


def test_a_resting_robot_has_the_documented_fitness() -> None:
    simulator = begun()
    while simulator.step(REST) is not None:
        pass
    assert simulator.outcome().fitness[0] == pytest.approx(1 - 1.5 / math.hypot(2, 2))


def test_a_controller_that_returns_nan_fails_its_trial_without_warnings() -> None:
    simulator = begun()
    while simulator.step(np.full((1, 2), np.nan, np.float32)) is not None:
        pass
    assert math.isnan(simulator.outcome().fitness[0])


def test_the_frame_shows_walls_goal_and_robot_inside_its_rim() -> None:
    frame = begun(heading=90.0).frame()
    (robot,) = frame.bodies
    goal = next(place for place in frame.places if place.kind == "goal")
    walls = [place for place in frame.places if place.kind == "wall"]
    assert (frame.width, frame.height) == (2.1, 2.1)
    assert len(walls) == 4 + len(WALLS["hard"])
    assert all(
        wall.x >= 0
        and wall.y >= 0
        and wall.x + wall.width <= 2.1
        and wall.y + wall.height <= 2.1
        for wall in walls
    )
    assert (robot.kind, robot.x, robot.y, robot.radius) == (
        "robot",
        pytest.approx(0.35),
        pytest.approx(1.8),
        0.08,
    )
    assert robot.heading == pytest.approx(math.pi / 2), "downwards"
    assert (goal.x + goal.width / 2, goal.y + goal.height / 2) == (
        pytest.approx(0.35),
        pytest.approx(0.3),
    )
