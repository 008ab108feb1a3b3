"""Robots on a line gather, compiled by numba: a complete simulator, as a start for your own.

A problem is a world, its settings and state, and five functions of it. ``problem`` builds a kernel
from them that plays whole trials. Without it they are plain Python, with the same results.
"""

from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.kernels.jit import inline
from zswarm.kernels.random import draw_uniform
from zswarm.kernels.signatures import Float64s, Int64s, UInt64s
from zswarm.sims.simulator import Body, Frame
from zswarm.sims.trial import Teams, play_many, problem

START_M, RADIUS_M, STEP_S = 10.0, 0.1, 0.1
MAX_SPEED = 1.0  # m/s


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    robots: Annotated[int, Meta(ge=2, le=1000, description="robots on the line")] = 5
    steps: Annotated[
        int, Meta(ge=1, le=100_000, description="steps of a trial, 0.1 s each")
    ] = 60


class MySimulatorWorld(NamedTuple):
    """The settings, and the state of a trial. Numbers stay as they are; arrays change."""

    steps: int
    x: Float64s  # (robots,), m
    way: Float64s  # (1,): m that a robot drove, on average
    done: Int64s  # (1,): steps
    stream: UInt64s  # (1,): all random numbers come from the seed in it


@inline(counts=False)
def start(world, seed):
    """Place the robots."""
    world.stream[0] = seed
    for robot in range(world.x.shape[0]):
        world.x[robot] = START_M * draw_uniform(world.stream)
    world.way[0] = 0.0
    world.done[0] = 0


@inline(counts=False)
def observe(world, observations):
    """Write what the robots sense: all numbers of the first one, then those of the second."""
    leftmost, rightmost = ends(world)
    for robot in range(world.x.shape[0]):
        observations[2 * robot] = (world.x[robot] - leftmost) / START_M
        observations[2 * robot + 1] = (rightmost - world.x[robot]) / START_M


@inline(counts=False)
def act(world, actions):
    """Drive for 0.1 s. The first output of all robots comes first, then the second of all."""
    robots = world.x.shape[0]
    for robot in range(robots):
        speed = min(max(2.0 * np.float64(actions[robot]) - 1.0, -1.0), 1.0) * MAX_SPEED
        world.x[robot] += speed * STEP_S
        world.way[0] += abs(speed * STEP_S) / robots
    world.done[0] += 1


@inline(counts=False)
def is_over(world):
    """Return whether the trial has ended."""
    return world.done[0] >= world.steps


@inline(counts=False)
def judge(world, fitness, metrics):
    """Write one fitness per participant, and one number per metric."""
    leftmost, rightmost = ends(world)
    fitness[0] = leftmost - rightmost
    metrics[0] = world.way[0]


@inline(counts=False)
def ends(world):
    """Return the positions of the leftmost and of the rightmost robot."""
    leftmost = rightmost = world.x[0]
    for robot in range(1, world.x.shape[0]):
        leftmost = min(leftmost, world.x[robot])
        rightmost = max(rightmost, world.x[robot])
    return leftmost, rightmost


class MySimulator(Teams):
    """Robots on a line gather.

    Observation: (2,) float32: the distance to the leftmost and to the rightmost robot, each / 10 m.
    Action: (1,) float32: speed; 0 or less is full speed left, 1 or more right, 1/2 stands still.
    Turns: all robots at once.
    Start: each robot at a position drawn from the trial's seed, uniform on 10 m.
    End: after ``steps`` steps.
    Fitness: minus the distance between the outermost robots at the end, in m; 0 at best.
    Metrics: ``way``: m that a robot drove, on average.
    """

    settings_type = Settings
    metrics = ("way",)
    inputs, outputs = 2, 1
    sensors, actuators = ("left", "right"), ("speed",)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        # The trial's only genome, 0, drives every robot.
        self.owners = (0,) * settings.robots
        self.world = MySimulatorWorld(
            steps=settings.steps,
            x=np.zeros(settings.robots),
            way=np.zeros(1),
            done=np.zeros(1, np.int64),
            stream=np.zeros(1, np.uint64),
        )

    def frame(self) -> Frame:
        """Return what a picture shows, in m."""
        bodies = [Body("robot", x, 0.5, RADIUS_M) for x in self.world.x.tolist()]
        return Frame(START_M, 1.0, [], bodies)


MySimulator.problem = problem(
    *("play_my_simulator", start, observe, act, is_over, judge),
    world=MySimulatorWorld,
    loop=play_many,
)
