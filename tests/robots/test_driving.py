"""Robots drive in ROS as in this process: the same poses and fitness, bit for bit."""

import os
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from tests.robots.trials import built, by_network, by_policy
from tests.ros.ros_here import LINKS, need
from tests.sims import robot_controllers

pytestmark = pytest.mark.robots
# By hand some are out early, one after the other.
CROWD = {"robots": 5, "steps": 60, "map": "open", "epsilon": 0.5}


@pytest.fixture(params=LINKS)
def link(request: pytest.FixtureRequest) -> str:
    need(request.param)
    return str(request.param)


def below(process: int) -> set[str]:
    """Command lines of what runs in this process's name, anywhere below it."""
    listed = subprocess.run(
        ["ps", "-eo", "pid=,ppid=,args="], capture_output=True, text=True, check=True
    ).stdout
    rows = [line.split(None, 2) for line in listed.splitlines()]
    found, parents = set(), {str(process)}
    while parents:
        children = {(pid, args) for pid, parent, args in rows if parent in parents}
        found |= {args for _, args in children if not args.startswith("ps -eo")}
        parents = {pid for pid, _ in children}
    return found


@pytest.fixture
def nothing_is_left() -> Iterator[None]:
    """Afterwards the same processes run as before."""
    before = below(os.getpid())
    yield
    assert below(os.getpid()) == before


@pytest.mark.usefixtures("nothing_is_left")
def test_poses_and_fitness_have_the_same_bits(link: str) -> None:
    """Steer by hand, so that some leave early, then by a recurrent network."""
    here, there = (
        built("turtlebot-exit", **CROWD),
        built("turtlebot-exit-ros", link=link, **CROWD),
    )
    steered = by_policy(here, robot_controllers.turtlebot_exit, 3)
    assert 0 < steered.outcome.metrics[0] <= 5
    assert by_policy(there, robot_controllers.turtlebot_exit, 3).bits == steered.bits
    for seed in (1, 2**64 - 1):
        there_played, here_played = (
            by_network(there, seed, iterations=2),
            by_network(here, seed, iterations=2),
        )
        assert there_played.bits == here_played.bits
        assert there_played.outcome.metrics == [
            *here_played.outcome.metrics,
            0.0,
            0.0,
            0.0,
        ]
    there.close()


def test_one_robot_alone_has_no_namespace_and_the_same_bits(link: str) -> None:
    settings: dict[str, Any] = {"robots": 1, "steps": 20}
    # First: it compiles the kernels.
    here = by_network(built("turtlebot-exit", **settings), 4)
    there = built("turtlebot-exit-ros", link=link, **settings)
    assert by_network(there, 4).bits == here.bits
    there.close()
