"""Kernels of problems have the place of their problem, where numba reads and caches."""

import inspect

import pytest

from zswarm.sims.food_or_poison import FoodOrPoison
from zswarm.sims.inverted_pendulum import InvertedPendulum
from zswarm.sims.light import Light
from zswarm.sims.maze import Maze
from zswarm.sims.trial import TrialSimulator


@pytest.mark.parametrize("simulator", [FoodOrPoison, InvertedPendulum, Light, Maze])
def test_the_source_of_a_kernel_is_found_in_its_problem(
    simulator: type[TrialSimulator],
) -> None:
    """From Python 3.13 on, no source is read that begins within a text."""
    play = inspect.unwrap(simulator.problem.play_trials)
    lines, _ = inspect.getsourcelines(play)
    assert play.__code__.co_filename == inspect.getfile(simulator)
    assert any(line.startswith("def start(") for line in lines)
