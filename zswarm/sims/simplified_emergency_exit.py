"""Simplified emergency exit, exactly FREVO's ``SimplifiedEmergencyExit`` (github.com/smartgrids-aau/Frevo, version 1.5)."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.errors import ConfigError
from zswarm.jit import STEP, Step, array, float32, float64, inline, int64, kernel, void
from zswarm.sims.simulator import Batch, Body, CompiledSimulator, Frame, Outcome, Place, Turn

INPUTS, OUTPUTS = 2, 2
ONE, TWO = np.float32(1), np.float32(2)
X, Y = range(2)
STEPS, WIDTH, HEIGHT, AGENT_X, AGENT_Y, EXIT_X, EXIT_Y = range(7)  # ``rules``: the settings

Length = Annotated[int, Meta(ge=1, le=1_000_000)]
Cell = Annotated[int, Meta(ge=0, lt=1_000_000)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``; cells count from 0."""

    steps: Annotated[int, Meta(ge=1, le=1_000_000, description="steps of a trial")] = 50
    width: Annotated[Length, Meta(description="cells")] = 100
    height: Annotated[Length, Meta(description="cells")] = 100
    agent_x: Annotated[Cell, Meta(description="column in which the robot starts; below `width`")] = 50
    agent_y: Annotated[Cell, Meta(description="row in which it starts; below `height`")] = 50
    exit_x: Annotated[Cell, Meta(description="column of the exit; below `width`")] = 99
    exit_y: Annotated[Cell, Meta(description="row of the exit; below `height`")] = 99


class SimplifiedEmergencyExit(CompiledSimulator):
    """One robot in an empty room walks to the exit, and must stop there; for a first look at a method.

    Observation: (2,) float32: signed dx, dy to the exit in cells, not scaled.
    Action: (2,) float32 x and y: a cell forth where 2 o - 1 is 1 or more, a cell back where it is -1 or less, both rounded to
        float32, else none; walls hold the robot.
    Turns: the robot.
    Start: where the settings say, the same for every seed.
    End: after ``steps`` steps, also where the robot was on the exit before.
    Fitness: minus the distance to the exit at the end, in cells. At most 0.
    Metrics: ``x``, ``y``: the robot's cell at the end.
    """

    settings_type = Settings
    metrics = ("x", "y")
    inputs, outputs = INPUTS, OUTPUTS
    sensors, actuators = ("exit_dx", "exit_dy"), ("vx", "vy")
    owners = (0,)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        for what, x, y in (("agent", settings.agent_x, settings.agent_y), ("exit", settings.exit_x, settings.exit_y)):
            if x >= settings.width or y >= settings.height:
                raise ConfigError(
                    f"simplified-emergency-exit: {what}_x {x} and {what}_y {y} must be below width {settings.width} "
                    f"and height {settings.height}"
                )
        self._rules = np.array(msgspec.structs.astuple(settings), np.int64)

    def reset(self, seed: int) -> Turn:  # noqa: ARG002  nothing is drawn
        """Put the robot where it starts."""
        self._steps = 0
        self._place = self._rules[AGENT_X : AGENT_Y + 1].copy()
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Move the robot."""
        act(actions[0], self._place, self._rules)
        self._steps += 1
        return self._turn() if self._steps < self.settings.steps else None

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness, metrics = np.zeros(1), np.zeros(2)
        judge(self._place, self._rules, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """The room in cells; robot and exit as large as can be seen."""
        x, y = self._place.tolist()
        size = max(1.0, max(self.settings.width, self.settings.height) / 50)
        way_out = Place("exit", self.settings.exit_x + (1 - size) / 2, self.settings.exit_y + (1 - size) / 2, size, size)
        return Frame(self.settings.width, self.settings.height, [way_out], [Body("robot", x + 0.5, y + 0.5, 0.4 * size)])

    def play(self, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play``."""
        state = np.empty(batch.state_size, np.float32)
        play_trials(step, batch.parameters, batch.participants, state, self._rules, batch.progress, batch.fitness, batch.metrics)

    def _turn(self) -> Turn:
        observation = np.empty((1, INPUTS), np.float32)
        observe(self._place, self._rules, observation[0])
        return Turn((0,), observation)


@inline
def observe(place, rules, observation):  # type: ignore[no-untyped-def]  # compiled
    """Where the exit is."""
    observation[X] = np.float32(rules[EXIT_X] - place[X])
    observation[Y] = np.float32(rules[EXIT_Y] - place[Y])


@inline
def moved(cell, output, cells):  # type: ignore[no-untyped-def]  # compiled
    """A coordinate after a step; NaN moves nothing."""
    speed = TWO * output - ONE
    return min(max(cell + int(speed >= ONE) - int(speed <= -ONE), 0), cells - 1)


@inline
def act(action, place, rules):  # type: ignore[no-untyped-def]  # compiled
    """One step."""
    place[X] = moved(place[X], action[X], rules[WIDTH])
    place[Y] = moved(place[Y], action[Y], rules[HEIGHT])


@inline
def judge(place, rules, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    dx, dy = rules[EXIT_X] - place[X], rules[EXIT_Y] - place[Y]
    fitness[0] = 0.0 - np.sqrt(np.float64(dx * dx + dy * dy))
    metrics[X], metrics[Y] = place[X], place[Y]


@kernel(
    void(STEP, array(float32, 2), array(int64, 2), array(float32), array(int64), array(int64), array(float64, 2),
         array(float64, 2))
)  # fmt: skip
def play_trials(step, parameters, participants, state, rules, progress, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """All trials of a batch, see ``CompiledSimulator.play``."""
    observation, action, place = np.empty(INPUTS, np.float32), np.empty(OUTPUTS, np.float32), np.empty(2, np.int64)
    for trial in range(participants.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        controller = parameters[participants[trial, 0]]
        state[:] = 0
        place[X], place[Y] = rules[AGENT_X], rules[AGENT_Y]
        for _ in range(rules[STEPS]):
            observe(place, rules, observation)
            step(controller, state, observation, action)
            act(action, place, rules)
        judge(place, rules, fitness[trial], metrics[trial])
