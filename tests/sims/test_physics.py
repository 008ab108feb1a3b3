"""Check motors, contacts, friction and lasers of the world of pushing robots against physics.

Also check that a trial leaves no state for the next one.
"""

from collections.abc import Sequence

import numpy as np
import pytest

from zswarm.sims.physics import GRAVITY, Movable, RobotSettings, RobotWorld
from zswarm.sims.physics_kernels import command
from zswarm.sims.placing import Area

ROOM: Area = (0.0, 0.0, 10.0, 10.0)


def world(
    *poses: tuple[float, float, float],
    walls: Sequence[Area] = (),
    things: Sequence[tuple[Movable, tuple]] = (),
    **settings,
) -> RobotWorld:
    """Return a world with robots at these (x, y, angle)."""
    settings = {"step_s": 0.1, "substeps": 2, **settings}
    built = RobotWorld(
        RobotSettings(robots=len(poses), **settings),
        ROOM,
        walls,
        [thing for thing, _ in things],
    )
    built.start(np.array(poses), np.array([pose for _, pose in things]).reshape(-1, 3))
    return built


def drive(
    built: RobotWorld, linear: Sequence[float], angular: Sequence[float], steps: int
) -> np.ndarray:
    """Drive the robots; return their poses after each step."""
    seen = []
    for _ in range(steps):
        built.drive(np.array(linear, float), np.array(angular, float))
        seen.append(built.poses.copy())
    return np.array(seen)


# ---- motors ----------------------------------------------------------------------------


def test_a_robot_drives_as_commanded() -> None:
    built = world((2, 5, 0.5))
    drive(built, [0.5], [0], 20)  # until it is up to speed
    before = built.poses[0].copy()
    drive(built, [0.5], [0], 20)
    np.testing.assert_allclose(
        built.poses[0, :2] - before[:2], [np.cos(0.5), np.sin(0.5)], rtol=1e-9
    )
    assert built.poses[0, 2] == 0.5


def test_a_robot_drives_in_circles_of_speed_over_turning_speed() -> None:
    built = world((5, 5, 0))
    drive(built, [0.3], [0.5], 30)
    seen = drive(built, [0.3], [0.5], 130)[:, 0, :2]  # more than once around
    centre = (seen.max(axis=0) + seen.min(axis=0)) / 2
    np.testing.assert_allclose(np.hypot(*(seen - centre).T), 0.6, atol=0.01)


def test_motors_speed_up_with_their_force_and_no_more() -> None:
    built = world((2, 5, 0), mass=10.0, force=5.0, speed=1.0, step_s=0.1, substeps=10)
    seen = drive(built, [1.0], [0], 30)[:, 0, 0]
    speeds = np.diff(seen) / 0.1
    np.testing.assert_allclose(np.diff(speeds[:15]) / 0.1, 0.5, rtol=1e-6)  # 5 N on 10 kg
    np.testing.assert_allclose(speeds[-5:], 1.0, rtol=1e-9)


def test_decisions_are_limited_to_the_robots_abilities() -> None:
    actions = np.array(
        [[np.nan, 0.5], [7, -3], [np.inf, -np.inf], [0.5, 0.75]], np.float32
    )
    linear, angular = np.full(5, 9.0), np.full(5, 9.0)
    command(actions, np.array([0, 1, 2, 4]), 0.65, 3.14, linear, angular)
    assert linear.tolist() == [0, 0.65, 0.65, 9, 0]
    assert angular.tolist() == [0, -3.14, -3.14, 9, 1.57]


def test_a_driver_also_limits_commands() -> None:
    built, other = world((2, 5, 0)), world((2, 5, 0))
    assert (
        drive(built, [7], [-50], 9).tobytes()
        == drive(other, [0.65], [-3.14], 9).tobytes()
    )


# ---- contacts --------------------------------------------------------------------------


def test_walls_and_robots_hold_a_robot() -> None:
    built = world((8, 5, 0), (5, 2, 0), (6, 2, np.pi), walls=[(9, 0, 9.2, 10)])
    drive(built, [0.65, 0.65, 0.65], [0, 0, 0], 60)
    assert built.poses[0, 0] == pytest.approx(9 - 0.177, abs=0.005)
    assert built.poses[2, 0] - built.poses[1, 0] == pytest.approx(2 * 0.177, abs=0.005)
    assert built.poses[1, 0] == pytest.approx(5.5 - 0.177, abs=0.01), (
        "of two that push equally, none wins"
    )


def test_restitution_is_the_share_of_speed_after_a_bump() -> None:
    for restitution in (0.0, 0.64):
        puck = Movable("puck", 0.1, 1.0, 0.0, is_box=False)
        built = world(
            (1, 1, 0),
            things=[(puck, (9.0, 5.0, 0.0))],
            restitution=restitution,
            substeps=10,
        )
        built._bodies[1].velocity = 0.02, 0.0  # m in a step of the physics, .01 s
        drive(built, [0], [0], 10)
        assert built._bodies[1].velocity.x == pytest.approx(-0.02 * restitution, abs=1e-8)


@pytest.mark.parametrize(("robots", "moves"), [(1, False), (2, True)])
@pytest.mark.parametrize("is_box", [True, False])
def test_friction_holds_a_heavy_box_against_one_robot_but_not_two(
    robots: int, moves: bool, is_box: bool
) -> None:
    """Each robot pushes with 15 N against 24.5 N of friction.

    A movable yields by less than the overlap that bodies may have.
    """
    thing = Movable("it", 0.4, 10.0, 0.25, is_box)
    # They touch it.
    poses = [(4.42, 5 + 0.19 * (2 * robot - robots + 1), 0.0) for robot in range(robots)]
    built = world(*poses, things=[(thing, (5.0, 5.0, 0.0))], friction=0.0)
    drive(built, [0.65] * robots, [0] * robots, 50)
    moved = built.things[0, 0] - 5
    assert (moved > 0.3) == moves
    assert moves or abs(moved) < 0.003


def test_friction_stops_sliding_bodies() -> None:
    """After speed squared / (2 g times the coefficient)."""
    puck = Movable("puck", 0.1, 0.5, 0.4, is_box=False)
    built = world((1, 1, 0), things=[(puck, (3.0, 5.0, 0.0))], step_s=0.01, substeps=1)
    built._bodies[1].velocity = 0.02, 0.0  # m in a step of the physics, .01 s
    drive(built, [0], [0], 100)
    assert built.things[0, 0] - 3 == pytest.approx(2.0**2 / (2 * GRAVITY * 0.4), rel=0.02)


def test_a_robot_holds_a_puck_at_its_front_and_lets_it_go() -> None:
    puck = Movable("puck", 0.1, 0.5, 0.4, is_box=False)
    built = world((5, 5, 0), things=[(puck, (5.28, 5.0, 0.0))])
    built.hold(0, 0)
    drive(built, [0.2], [1.0], 60)
    front = built.poses[0, :2] + 0.277 * built.headings[0]
    np.testing.assert_allclose(built.things[0, :2], front, atol=0.01)
    built.let_go(0)
    drive(built, [-0.5], [0], 20)
    assert np.hypot(*(built.things[0, :2] - built.poses[0, :2])) > 0.5


def test_a_removed_robot_blocks_no_one_and_is_not_seen() -> None:
    built = world((2, 5, 0), (4, 5, 0), rays=9, range=9.0)
    assert built.ranges[0, 4] == pytest.approx(2 - 0.177)
    built.take_out(1)
    drive(built, [0.65, 0.65], [0, 0], 50)
    assert built.ranges[0, 4] == pytest.approx(10 - built.poses[0, 0])
    assert built.poses[0, 0] > 4.5
    assert built.poses[1].tolist() == [4, 5, 0], "it is shown where it was"


# ---- lasers ----------------------------------------------------------------------------


def test_a_scan_goes_from_the_right_to_the_left_as_in_ros() -> None:
    """Angles from - view / 2 by view / (rays - 1)."""
    built = world((2, 3, np.pi / 2), rays=9, view=180, range=9.0)
    root_2 = np.sqrt(2)
    np.testing.assert_allclose(built.ranges[0, [0, 4, 8]], [8, 7, 2], rtol=1e-6)
    np.testing.assert_allclose(built.ranges[0, 6], 2 * root_2, rtol=1e-6)
    assert built.ranges[0, 2] == 9, "nothing within its reach"
    assert built.ranges.dtype == np.float32


def test_a_laser_sees_walls_boxes_and_robots_and_no_pucks() -> None:
    box, puck = (
        Movable("box", 0.5, 10.0, 1.0, is_box=True),
        Movable("puck", 0.2, 1.0, 1.0, is_box=False),
    )
    built = world(
        (1, 5, 0),
        (1, 8, 0),
        things=[(box, (4.0, 5.0, np.pi / 4)), (puck, (2.0, 5.0, 0.0))],
        walls=[(6, 7, 7, 9)],
        rays=9,
        view=180,
        range=8.0,
    )
    np.testing.assert_allclose(
        built.ranges[0, [0, 4, 8]], [5, 3 - 0.5 * np.sqrt(2), 3 - 0.177], rtol=1e-6
    )
    np.testing.assert_allclose(built.ranges[1, [0, 4, 8]], [3 - 0.177, 5, 2], rtol=1e-6)


def test_a_scan_agrees_with_points_walked_along_each_ray() -> None:
    stream = np.random.default_rng(5)
    walls = [(2.0, 2.0, 2.3, 4.0), (5.0, 6.0, 8.0, 6.1)]
    box = Movable("box", 0.4, 10.0, 1.0, is_box=True)
    poses = [
        (*place, stream.uniform(-3, 3))
        for place in [(1.0, 1.0), (3.0, 3.0), (6.0, 7.0), (4.4, 5.5)]
    ]
    built = world(
        *poses, walls=walls, things=[(box, (5.5, 4.0, 0.7))], rays=24, view=300, range=3.0
    )
    c, s = np.cos(0.7), np.sin(0.7)

    def filled(x: float, y: float, but: int) -> bool:
        across, along = c * (x - 5.5) + s * (y - 4.0), c * (y - 4.0) - s * (x - 5.5)
        return (
            not (0 < x < 10 and 0 < y < 10)
            or any(
                left <= x <= right and low <= y <= high
                for left, low, right, high in walls
            )
            or (abs(across) <= 0.4 and abs(along) <= 0.4)
            or any(
                np.hypot(x - a, y - b) <= 0.177
                for robot, (a, b, _) in enumerate(poses)
                if robot != but
            )
        )

    for robot, (x, y, angle) in enumerate(poses):
        for ray in range(0, 24, 3):
            towards = angle + np.radians(300 * (ray / 23) - 150)
            walked = np.arange(0, 3, 0.01)
            hits = [
                d
                for d in walked
                if filled(x + d * np.cos(towards), y + d * np.sin(towards), robot)
            ]
            assert built.ranges[robot, ray] == pytest.approx(
                hits[0] if hits else 3.0, abs=0.0101
            )


# ---- trials ----------------------------------------------------------------------------


def test_earlier_trials_make_no_difference() -> None:
    """Bodies and contacts of earlier trials lie elsewhere in memory, and some are gone."""
    box = Movable("box", 0.4, 5.0, 0.2, is_box=True)
    crowd = [
        (3 + 0.4 * (robot % 4), 4.4 + 0.4 * (robot // 4), 0.3 * robot)
        for robot in range(12)
    ]
    built = world(*crowd, things=[(box, (5.2, 5.0, 0.3))], rays=8)

    def played(steps: int) -> bytes:
        built.start(np.array(crowd), np.array([(5.2, 5.0, 0.3)]))
        return (
            drive(built, [0.5] * 12, [0.3] * 12, steps).tobytes() + built.things.tobytes()
        )

    first = played(60)
    kept = []
    for robots in (3, 20):
        kept.append(world(*[(1 + 0.4 * robot, 1, 0) for robot in range(robots)]))
        drive(kept[-1], [0.5] * robots, [1.0] * robots, 10)
    assert played(60) == first
    played(7)
    assert played(60) == first
