"""Robots that stall as in Stage, and robots that stay where they are out."""

from typing import Any

import numpy as np
import pytest

from tests.robots.trials import built
from zswarm.sims.physics import RobotSettings
from zswarm.sims.physics_stall import StallWorld
from zswarm.sims.simulator import Turn
from zswarm.sims.turtlebot_exit import TurtlebotExit
from zswarm.testing.simulators import check_simulator

LEAVE = {"map": "open", "robots": 2, "epsilon": 0.6, "contact": "stall"}


def world(*poses: tuple[float, float, float], **settings: Any) -> StallWorld:
    """Return a room of 4 m by 4 m with robots at these (x, y, angle)."""
    given = {"robots": len(poses), "step_s": 0.1, "substeps": 1, **settings}
    made = StallWorld(RobotSettings(**given), (0.0, 0.0, 4.0, 4.0), [])
    made.start(np.array(poses), np.zeros((0, 3)))
    return made


def test_a_robot_is_at_once_as_fast_as_commanded_and_turns_after_it_drove() -> None:
    made = world((1, 1, 0))
    made.drive(np.array([0.5]), np.array([1.0]))
    np.testing.assert_allclose(made.poses, [[1.05, 1, 0.1]], rtol=1e-12)
    made.drive(np.array([0.5]), np.array([1.0]))
    heading = [0.05 * np.cos(0.1), 0.05 * np.sin(0.1)]
    np.testing.assert_allclose(made.poses[0, :2], [1.05 + heading[0], 1 + heading[1]])


def test_a_robot_drives_and_turns_no_faster_than_it_can() -> None:
    made = world((1, 1, 0))
    made.drive(np.array([9.0]), np.array([-9.0]))
    np.testing.assert_allclose(made.poses, [[1.065, 1, -0.314]], rtol=1e-12)


def test_a_move_that_would_touch_a_wall_is_undone_with_its_turn() -> None:
    """So a robot that pushes on sticks; backwards, and turning on the spot, it gets away."""
    made = world((4 - 0.177 - 0.03, 2, 0.5))
    before = made.poses.copy()
    made.drive(np.array([0.6]), np.array([1.0]))
    assert made.poses.tolist() == before.tolist()
    made.drive(np.array([0.0]), np.array([1.0]))
    assert made.poses[0, 2] == 0.5 + 0.1
    made.drive(np.array([-0.6]), np.array([0.0]))
    assert made.poses[0, 0] < before[0, 0]


def test_robots_do_not_push_each_other() -> None:
    """One after the other moves: the first makes room for the second."""
    made = world((1.37, 2, 0), (1, 2, 0), (3, 2, 0), (3.37, 2, 0))
    before = made.poses.copy()
    made.drive(np.full(4, 0.6), np.zeros(4))
    moved = made.poses[:, 0] - before[:, 0]
    np.testing.assert_allclose(moved, [0.06, 0.06, 0, 0.06], atol=1e-12)


def test_a_scan_is_of_before_the_last_substep() -> None:
    made = world((2, 2, 0), rays=9, view=180, substeps=2)
    made.drive(np.array([0.5]), np.zeros(1))
    assert made.poses[0, 0] == pytest.approx(2.05)
    assert made.ranges[0, 4] == pytest.approx(2 - 0.025, abs=1e-6)


def test_a_robot_that_was_taken_out_stands_in_nobodys_way() -> None:
    made = world((1, 2, 0), (1.4, 2, 0), rays=9, view=180)
    made.take_out(1)
    made.drive(np.full(2, 0.6), np.zeros(2))
    np.testing.assert_allclose(made.poses[:, 0], [1.06, 1.4])
    assert made.ranges[0, 4] == 3


@pytest.mark.parametrize("contact", ["slide", "stall"])
def test_a_robot_that_is_out_stands_or_is_gone(contact: str) -> None:
    """Robot 1 drives to where robot 0 left."""
    reached = {}
    for after_exit in ("remove", "stay"):
        room = {**LEAVE, "contact": contact, "after_exit": after_exit}
        simulator = built("turtlebot-exit", **room)
        turn: Turn | None = simulator.reset(1)
        starts = np.array([[-2.0, 0.2, np.pi / 2], [-2.0, -0.6, np.pi / 2]])
        simulator._world.start(starts, np.zeros((0, 3)))
        poses = []
        while turn is not None and len(poses) < 20:
            turn = simulator.step(np.tile(np.float32([1, 0.5]), (len(turn.agents), 1)))
            poses.append(simulator.poses[:, 1].copy())
        reached[after_exit] = poses[-1]
        left = [y for y, _ in poses]
        assert left[-1] == pytest.approx(0.45, abs=0.1), "it keeps the pose where it left"
    assert reached["stay"][1] < reached["remove"][1]


def test_the_contract_is_kept() -> None:
    check_simulator(TurtlebotExit, {**LEAVE, "steps": 8, "after_exit": "stay"})
