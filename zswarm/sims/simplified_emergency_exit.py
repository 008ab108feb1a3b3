"""Simplified emergency exit, exactly as FREVO's ``SimplifiedEmergencyExit``.

FREVO is at github.com/smartgrids-aau/Frevo; this is its version 1.5.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about
from zswarm.errors import ConfigError
from zswarm.kernels.jit import inline
from zswarm.sims.simulator import Body, Frame, Rectangle, Steps
from zswarm.sims.trial import OneAgent, problem, world

ONE, TWO = np.float32(1), np.float32(2)
# Of ``rules``: the settings.
STEPS, WIDTH, HEIGHT, AGENT_X, AGENT_Y, EXIT_X, EXIT_Y = range(7)
X, Y, DECISIONS = range(3)  # ``counts``

Length = Annotated[int, Meta(ge=1, le=1_000_000)]
Cell = Annotated[int, Meta(ge=0, lt=1_000_000)]


class SimplifiedEmergencyExitSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``; cells count from 0."""

    steps: Steps = 50
    width: Annotated[Length, about("cells")] = 100
    height: Annotated[Length, about("cells")] = 100
    agent_x: Annotated[Cell, about("column in which the robot starts; below `width`")] = (
        50
    )
    agent_y: Annotated[Cell, about("row in which the robot starts; below `height`")] = 50
    exit_x: Annotated[Cell, about("column of the exit; below `width`")] = 99
    exit_y: Annotated[Cell, about("row of the exit; below `height`")] = 99


class SimplifiedEmergencyExit(OneAgent):
    """One robot in an empty room walks to the exit, and must stop there; to try methods on.

    Observation: (2,) float32: signed dx, dy to the exit in cells, not scaled.
    Action: (2,) float32 x and y: a cell forward where 2 o - 1 is 1 or more, a cell back where it is
        -1 or less, both rounded to float32, else none; walls hold the robot.
    Turns: the robot.
    Start: where the settings say, the same for every seed.
    End: after ``steps`` steps, even if the robot has been on the exit.
    Fitness: minus the distance to the exit at the end, in cells. At most 0.
    Metrics: ``x``, ``y``: the robot's cell at the end.
    """

    settings_type = SimplifiedEmergencyExitSettings
    metrics = ("x", "y")
    sensors, actuators = ("exit_dx", "exit_dy"), ("vx", "vy")
    inputs, outputs = len(sensors), len(actuators)
    settings: SimplifiedEmergencyExitSettings

    def __init__(self, settings: SimplifiedEmergencyExitSettings) -> None:
        super().__init__(settings)
        width = settings.width
        height = settings.height
        for what in ("agent", "exit"):
            x = getattr(settings, f"{what}_x")
            y = getattr(settings, f"{what}_y")
            if x >= width or y >= height:
                raise ConfigError(
                    f"simplified-emergency-exit: {what}_x {x} and {what}_y {y} must be below "
                    f"width {width} and height {height}"
                )
        self.world = world(rules=msgspec.structs.astuple(settings), counts=3)

    def frame(self) -> Frame:
        """Draw the room in cells, with robot and exit large enough to be seen."""
        s, (x, y, _) = self.settings, self.world.counts.tolist()
        size = max(1.0, max(s.width, s.height) / 50)
        corner = (1 - size) / 2
        exit_ = Rectangle("exit", s.exit_x + corner, s.exit_y + corner, size, size)
        return Frame(
            s.width, s.height, [exit_], [Body("robot", x + 0.5, y + 0.5, 0.4 * size)]
        )


@inline(counts=False)
def start(world, seed):  # noqa: ARG001  nothing is drawn
    """Put the robot where it starts."""
    world.counts[X] = world.rules[AGENT_X]
    world.counts[Y] = world.rules[AGENT_Y]
    world.counts[DECISIONS] = 0


@inline(counts=False)
def observe(world, observation):
    """Write the offset to the exit."""
    observation[0] = np.float32(world.rules[EXIT_X] - world.counts[X])
    observation[1] = np.float32(world.rules[EXIT_Y] - world.counts[Y])


@inline(counts=False)
def act(world, action):
    """Move the robot."""
    counts = world.counts
    rules = world.rules
    counts[X] = moved(counts[X], action[0], rules[WIDTH])
    counts[Y] = moved(counts[Y], action[1], rules[HEIGHT])
    counts[DECISIONS] += 1


@inline(counts=False)
def moved(cell, output, cells):
    """Return a coordinate after a step; NaN moves nothing."""
    speed = TWO * output - ONE
    return min(max(cell + int(speed >= ONE) - int(speed <= -ONE), 0), cells - 1)


@inline(counts=False)
def is_over(world):
    """Return whether the trial ends."""
    return world.counts[DECISIONS] >= world.rules[STEPS]


@inline(counts=False)
def judge(world, fitness, metrics):
    """Write fitness and metrics of a trial that ended."""
    counts = world.counts
    rules = world.rules
    dx = rules[EXIT_X] - counts[X]
    dy = rules[EXIT_Y] - counts[Y]
    fitness[0] = 0.0 - np.sqrt(np.float64(dx * dx + dy * dy))
    metrics[0] = counts[X]
    metrics[1] = counts[Y]


SimplifiedEmergencyExit.problem = problem(
    "play_exit", start, observe, act, is_over, judge
)
