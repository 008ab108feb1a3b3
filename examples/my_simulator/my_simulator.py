"""Robots on a line gather: a complete simulator, as a start for your own."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.kernels.random import Stream
from zswarm.sims.simulator import Body, Frame, Outcome, Simulator, Turn

START_M, RADIUS_M, STEP_S = 10.0, 0.1, 0.1
MAX_SPEED = 1.0  # m/s


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    robots: Annotated[int, Meta(ge=2, le=1000, description="robots on the line")] = 5
    steps: Annotated[
        int, Meta(ge=1, le=100_000, description="steps of a trial, 0.1 s each")
    ] = 60


class MySimulator(Simulator):
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

    def reset(self, seed: int) -> Turn:
        """Place the robots. All random numbers come from the seed."""
        self._x = Stream(seed).uniform(0.0, START_M, self.settings.robots)
        self._way, self._steps = 0.0, 0
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive for 0.1 s. Return None at the end of the trial."""
        speed = (
            np.clip(2.0 * actions[:, 0].astype(np.float64) - 1.0, -1.0, 1.0) * MAX_SPEED
        )
        moves = speed * STEP_S
        self._x += moves
        # A fixed order gives the same bits on every machine.
        for move in np.abs(moves).tolist():
            self._way += move / self.settings.robots
        self._steps += 1
        return self._turn() if self._steps < self.settings.steps else None

    def outcome(self) -> Outcome:
        """Return one fitness per participant and one number per metric."""
        return Outcome([float(self._x.min() - self._x.max())], [self._way])

    def frame(self) -> Frame:
        """Return what a picture shows, in m."""
        return Frame(
            START_M, 1.0, [], [Body("robot", x, 0.5, RADIUS_M) for x in self._x.tolist()]
        )

    def _turn(self) -> Turn:
        """Return the robots that act next, and a row of observations for each."""
        left, right = self._x - self._x.min(), self._x.max() - self._x
        observations = np.stack([left, right], axis=1) / START_M
        return Turn(range(self.settings.robots), observations.astype(np.float32))
