"""Robots on a line gather: a whole simulator, to be changed into another one."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream
from zswarm.sims.simulator import Body, Frame, Outcome, Simulator, Turn

START_M, RADIUS_M, STEP_S = 10.0, 0.1, 0.1
MAX_SPEED = 1.0  # m/s


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What an experiment may set in ``[problem.settings]``."""

    robots: Annotated[int, Meta(ge=2, le=1000, description="robots on the line")] = 5
    steps: Annotated[int, Meta(ge=1, le=100_000, description="steps of a trial, each of 0.1 s")] = 60


class MySimulator(Simulator):
    """Robots on a line gather.

    Observation: (2,) float32: how far the leftmost and the rightmost robot are from this one, each / 10 m.
    Action: (1,) float32: speed; 0 or less is full speed to the left, 1 or more to the right, 1/2 stands still.
    Turns: all robots at once.
    Start: each robot somewhere on 10 m, drawn from the trial's seed.
    End: after ``steps`` steps.
    Fitness: minus the distance between the leftmost and the rightmost robot at the end, in m; 0 at best.
    Metrics: ``way``: m that a robot drove, on average.
    """

    settings_type = Settings
    metrics = ("way",)
    inputs, outputs = 2, 1
    sensors, actuators = ("left", "right"), ("speed",)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self.owners = (0,) * settings.robots  # participant 0, the one genome of a trial, drives every robot

    def reset(self, seed: int) -> Turn:
        """Put the robots on the line. All that is drawn comes from the seed."""
        self._x = Stream(seed).uniform(0.0, START_M, self.settings.robots)
        self._way, self._steps = 0.0, 0
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive for 0.1 s. None ends the trial."""
        speed = np.clip(2.0 * actions[:, 0].astype(np.float64) - 1.0, -1.0, 1.0) * MAX_SPEED
        self._x += speed * STEP_S
        for metres in np.abs(speed * STEP_S).tolist():  # in a fixed order: the same bits on every machine
            self._way += metres / self.settings.robots
        self._steps += 1
        return self._turn() if self._steps < self.settings.steps else None

    def outcome(self) -> Outcome:
        """One fitness per participant, one number per metric."""
        return Outcome([float(self._x.min() - self._x.max())], [self._way])

    def frame(self) -> Frame:
        """What a picture shows of it, in m."""
        return Frame(START_M, 1.0, [], [Body("robot", x, 0.5, RADIUS_M) for x in self._x.tolist()])

    def _turn(self) -> Turn:
        """Who acts next, and what they observe: a row for each."""
        left, right = self._x - self._x.min(), self._x.max() - self._x
        return Turn(range(self.settings.robots), (np.stack([left, right], axis=1) / START_M).astype(np.float32))
