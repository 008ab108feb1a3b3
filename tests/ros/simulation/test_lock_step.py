"""When a simulation steps that waits for its robots."""

import pytest

from zswarm.ros.link.messages import Velocity
from zswarm.ros.simulation.lock_step import LockStep, Overdue, Step


def velocity(robot: int, linear: float = 0.0, stamp_ns: int = 0) -> Velocity:
    return Velocity(robot=robot, stamp_ns=stamp_ns, linear=linear, angular=0.0)


@pytest.fixture
def asked() -> LockStep:
    """Robots 1 and 3 saw something at 400 ns; it is second 10, and they have 5."""
    lock = LockStep(5.0)
    lock.ask([1, 3], 400, 10.0)
    return lock


def test_the_simulation_steps_when_all_robots_have_sent_velocities(
    asked: LockStep,
) -> None:
    assert asked.handle(velocity(3, 0.3), 10.1) is None
    assert asked.handle(velocity(1, 0.1), 10.2) == Step(
        {3: velocity(3, 0.3), 1: velocity(1, 0.1)}
    )
    assert asked.handle(velocity(1), 10.3) is None, (
        "nothing is waited for until the next scans"
    )


def test_the_later_of_two_velocities_counts(asked: LockStep) -> None:
    asked.handle(velocity(1, 0.1), 10.0)
    asked.handle(velocity(1, 0.2), 10.0)
    stepped = asked.handle(velocity(3), 10.0)
    assert isinstance(stepped, Step)
    assert stepped.velocities[1].linear == 0.2


def test_velocities_of_absent_robots_and_past_steps_are_ignored(asked: LockStep) -> None:
    """Robot 2 is out; 300 ns are over."""
    asked.handle(velocity(1, stamp_ns=400), 10.0)
    assert asked.handle(velocity(2), 10.0) is None
    assert asked.handle(velocity(3, stamp_ns=300), 10.0) is None
    assert isinstance(asked.handle(velocity(3, stamp_ns=400), 10.0), Step)


def test_robots_that_are_silent_for_too_long_are_named(asked: LockStep) -> None:
    asked.handle(velocity(3), 10.0)
    assert asked.handle(None, 14.9) is None
    assert asked.handle(None, 15.0) == Overdue((1,), 400)
    assert asked.handle(None, 99.0) is None, "it is said once"


def test_a_velocity_at_the_last_moment_counts(asked: LockStep) -> None:
    asked.handle(velocity(3), 10.0)
    assert isinstance(asked.handle(velocity(1), 15.0), Step)


def test_the_wait_ends_at_the_robots_deadline(asked: LockStep) -> None:
    assert asked.left_s(12.0, 60.0) == 3.0
    assert asked.left_s(99.0, 60.0) == 0.0
    asked.stop()
    assert asked.left_s(12.0, 60.0) == 60.0


def test_new_scans_are_answered_again(asked: LockStep) -> None:
    """This happens when a trial begins in the middle of another."""
    asked.handle(velocity(1), 10.0)
    asked.ask([1], 200, 20.0)
    assert asked.handle(velocity(3), 20.0) is None
    assert isinstance(asked.handle(velocity(1), 20.0), Step)
