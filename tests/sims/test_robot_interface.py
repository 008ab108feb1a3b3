"""What robots' messages mean to controllers."""

import numpy as np
import pytest

from zswarm.kernels.jit import inline
from zswarm.kernels.portable import PI
from zswarm.sims.robot_interface import fit_scan, observe, velocity
from zswarm.sims.turtlebot_exit import TurtlebotExit, TurtlebotExitSettings

VIEW, REACH = 270 * PI / 180, np.float32(4)


def fitted(
    ranges: np.ndarray,
    angle_min: float,
    increment: float,
    rays: int = 36,
    view: float = VIEW,
) -> np.ndarray:
    found = np.full(rays, np.nan, np.float32)
    fit_scan(
        np.asarray(ranges, np.float32),
        len(ranges),
        float(angle_min),
        float(increment),
        rays,
        view,
        REACH,
        found,
    )
    return found


@pytest.mark.parametrize("rays", [8, 36, 181, 1081])
@pytest.mark.parametrize("degrees", [90.0, 270.0, 360.0])
def test_a_scan_that_fits_the_controller_is_not_changed(
    rays: int, degrees: float
) -> None:
    """Angles are float32 in a message, so they are not quite those of the rays."""
    view = degrees * PI / 180
    ranges = np.random.default_rng(1).uniform(0.1, 3.9, rays).astype(np.float32)
    found = fitted(
        ranges, np.float32(-view / 2), np.float32(view / (rays - 1)), rays, view
    )
    if degrees == 360:  # the first ray and the last look the same way
        ranges[0] = ranges[-1] = min(ranges[0], ranges[-1])
        found[0] = found[-1] = min(found[0], found[-1])
    assert found.tobytes() == ranges.tobytes()


@pytest.mark.parametrize("nothing", [0.0, -1.0, np.inf, np.nan, 4.0, 9.0])
def test_an_invalid_reading_counts_as_no_obstacle(nothing: float) -> None:
    ranges = np.full(36, 2.0)
    ranges[7] = nothing
    found = fitted(ranges, -VIEW / 2, VIEW / 35)
    assert found[7] == REACH
    assert (np.delete(found, 7) == 2).all()


def test_ranges_below_the_minimum_become_0() -> None:
    ranges = np.full(36, 2.0)
    ranges[7] = -np.inf
    assert fitted(ranges, -VIEW / 2, VIEW / 35).tolist() == [2.0] * 7 + [0.0] + [2.0] * 28


@pytest.mark.parametrize(
    ("angle_min", "increment"),
    [
        (0.0, PI / 180),
        (-PI, PI / 180),
        (PI, -PI / 180),
        (0.0, -PI / 180),
        (2 * PI, -PI / 180),
    ],
)
def test_full_circle_scans_may_begin_at_any_angle(
    angle_min: float, increment: float
) -> None:
    """Something is at 57 to 63 degrees on the left, and at 2 on the right of straight ahead."""
    angles = np.degrees(angle_min + increment * np.arange(360)) % 360
    ranges = np.where(np.abs(angles - 60) < 3.5, 1.0, 0.0) + np.where(
        np.abs(angles - 358) < 0.5, 2.0, 0.0
    )
    found = fitted(ranges, angle_min, increment)
    seen = np.degrees(np.linspace(-VIEW / 2, VIEW / 2, 36))
    half = 135 / 35
    assert (
        (found == 1) == ((seen + half >= 57 - 1e-6) & (seen - half <= 63 + 1e-6))
    ).all()
    assert ((found == 2) == (np.abs(seen + 2) <= half)).all()


def test_a_scanner_that_looks_ahead_only_sees_nothing_behind() -> None:
    found = fitted(np.ones(61), -PI / 6, PI / 180)
    seen = np.degrees(np.linspace(-VIEW / 2, VIEW / 2, 36))
    assert (found[np.abs(seen) < 30] == 1).all()
    assert (found[np.abs(seen) > 35] == REACH).all()


def test_few_measured_rays_fill_all_rays_of_the_controller() -> None:
    assert (fitted(np.ones(10), -VIEW / 2, VIEW / 9) == 1).all()


@pytest.mark.parametrize(
    "angles",
    [(0.0, 0.0), (np.nan, 0.1), (0.0, np.nan), (1e30, 0.1), (0.0, 1e-30), (np.inf, 0.1)],
)
def test_impossible_angles_see_nothing(angles: tuple[float, float]) -> None:
    assert (fitted(np.ones(36), *angles) == REACH).all()


def test_the_nearest_target_is_given_in_the_robots_frame() -> None:
    """Look up from (1, 1), a rotation by 90 degrees as a quaternion.

    The nearer of two exits is 2 m to the left of the robot.
    """
    scan = np.array([4, 4, 1, 2, 4, 4, 4, 3], np.float32)
    half = np.sqrt(0.5)
    observation = np.full(6, np.nan, np.float32)
    targets = np.array([-1.0, 1.0, 9.0, 9.0])
    distance = observe(scan, 8, REACH, 4, 1.0, 1.0, half, half, targets, 2, observation)
    assert distance == 2
    np.testing.assert_allclose(observation, [0, 0.75, 0, 0.25, 0, 1], atol=1e-6)


def test_on_a_target_and_without_a_heading_there_is_no_direction() -> None:
    scan, observation = np.full(8, 4, np.float32), np.full(3, np.nan, np.float32)
    assert (
        observe(
            scan, 8, REACH, 1, 1.0, 2.0, 0.0, 1.0, np.array([1.0, 2.0]), 1, observation
        )
        == 0
    )
    assert observation.tolist() == [0, 0, 0]
    observe(scan, 8, REACH, 1, 0.0, 2.0, 0.0, 0.0, np.array([1.0, 2.0]), 1, observation)
    assert observation.tolist() == [0, 0, 0]


def test_a_tilted_robot_sees_a_unit_vector() -> None:
    scan, observation = np.full(8, 4, np.float32), np.empty(3, np.float32)
    observe(scan, 8, REACH, 1, 0.0, 0.0, 0.3, 0.9, np.array([1.0, 2.0]), 1, observation)
    assert np.hypot(observation[1], observation[2]) == pytest.approx(1, abs=1e-6)


def test_a_decision_is_limited_to_the_robots_abilities() -> None:
    shares = np.array([0, 0.5, 1, -3, 7, np.inf, -np.inf, np.nan, 0.75], np.float32)
    assert [velocity(share, 2.0) for share in shares] == [-2, 0, 2, -2, 2, 2, -2, 0, 1]


def test_compiled_and_plain_have_the_same_bits() -> None:
    draw = np.random.default_rng(2)
    plain = inline(lambda x: x)
    if not hasattr(plain, "py_func"):
        pytest.skip("kernels are plain Python here")
    for _ in range(50):
        scan, pose, targets = (
            draw.uniform(0.1, 4, 36).astype(np.float32),
            draw.normal(size=4),
            draw.normal(size=6),
        )
        seen, again = np.empty(10, np.float32), np.empty(10, np.float32)
        distances = [
            function(scan, 36, REACH, 8, *pose, targets, 3, filled)
            for function, filled in ((observe, seen), (observe.py_func, again))
        ]
        assert (np.float64(distances[0]).tobytes(), seen.tobytes()) == (
            np.float64(distances[1]).tobytes(),
            again.tobytes(),
        )


def test_messages_carry_everything_that_controllers_observe() -> None:
    simulator = TurtlebotExit(TurtlebotExitSettings(robots=3))
    turn = simulator.reset(5)
    assert simulator.robot is not None
    robot, targets = simulator.robot, np.array(simulator.robot.targets).ravel()
    for row in range(3):
        scan = fitted(
            simulator.scans[row],
            np.float32(-robot.view / 2),
            np.float32(robot.view / (robot.rays - 1)),
        )
        observation = np.empty(simulator.inputs, np.float32)
        observe(
            scan,
            robot.rays,
            np.float32(robot.range),
            robot.sectors,
            *simulator.poses[row],
            targets,
            2,
            observation,
        )
        assert observation.tobytes() == turn.observations[row].tobytes()
