"""A robot in a maze where the direct way to the goal ends at a wall.

The task, robot and sensors of J. Lehman, K. O. Stanley, "Abandoning Objectives: Evolution Through the Search for Novelty Alone",
Evolutionary Computation 19(2), 2011, section 4, in metres for hundreds of their units; the mazes are drawn anew, with walls along
the axes. There, who is bred for nearness to the goal stays behind the wall next to it; novelty search finds the way round.
"""

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.jit import STEP, Step, array, float32, float64, inline, int64, kernel, void
from zswarm.portable import PI, cos, sin
from zswarm.sims.simulator import Batch, Body, CompiledSimulator, Frame, Outcome, Place, Ray, Turn

RADIUS = 0.08  # m, of the robot
SIGHT = 1.0  # m, of a range finder
NEAR = 0.05  # m, from the goal: reached
FASTEST, STRONGEST = 0.03, 0.01  # m per step; its change in a step is within half of the second
QUICKEST, SHARPEST = 3.0, 1.0  # degrees per step, the same
RADIANS = PI / 180.0
ROOT_HALF = 0.7071067811865476
FINDERS = np.array(  # directions in the robot's frame: ahead, to the right
    [[0.0, -1.0], [ROOT_HALF, -ROOT_HALF], [1.0, 0.0], [ROOT_HALF, ROOT_HALF], [0.0, 1.0], [-1.0, 0.0]]
)
FINDER_TURNS = (-2, -1, 0, 1, 2, 4)  # the same in eighths of a turn, clockwise from ahead
INPUTS, OUTPUTS = len(FINDERS) + 4, 2
ZERO, ONE = np.float32(0), np.float32(1)

# ``world``: float64.
X, Y, HEADING, SPEED, TURNING = range(5)  # m; degrees, 0 to the right, clockwise; m and degrees per step
# ``plan``: float64.
START_X, START_Y, START_HEADING, GOAL_X, GOAL_Y, WIDTH, HEIGHT = range(7)
# ``game``: int64. DECISIONS so far; REACHED: the robot is at the goal.
DECISIONS, REACHED = range(2)

PLANS = {
    "medium": (0.2, 0.75, 0.0, 2.75, 0.25, 3.0, 1.5),
    "hard": (0.3, 1.75, 0.0, 0.3, 0.25, 2.0, 2.0),
}
# (x, y, x, y) of the ends of walls inside, first those to the left or above.
WALLS = {
    "medium": ((0.7, 0.0, 0.7, 1.05), (1.3, 0.45, 1.3, 1.5), (1.9, 0.0, 1.9, 1.05), (2.4, 0.45, 3.0, 0.45)),
    "hard": (
        (0.0, 0.5, 1.4, 0.5),  # between the goal and all that comes near it
        (0.6, 0.5, 0.6, 1.4),  # ends the direct way on the right
        (0.6, 1.1, 1.5, 1.1),
        (1.1, 1.5, 1.1, 2.0),
        (1.0, 0.8, 2.0, 0.8),
    ),
}


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    map: Annotated[
        Literal["medium", "hard"],
        Meta(description="medium: dead ends on the way; hard: the direct way ends next to the goal, behind a wall"),
    ] = "hard"
    steps: Annotated[int, Meta(ge=1, le=1_000_000, description="steps of a trial")] = 400


class Maze(CompiledSimulator):
    """A robot finds the goal of a maze although the direct way leads into a dead end; what novelty search is known for.

    The robot is a disc with a radius of .08 m. x is to the right and y downwards from the upper left corner, in m; headings are
    degrees, 0 to the right, clockwise. The maze hard is 2 m by 2 m, medium 3 m by 1.5 m.

    Observation: (10,) float32: six range finders, from the robot's centre to the left, ahead left, ahead, ahead right, right and
        back: distance to the next wall in m, at most 1; then a compass, 1 where the goal is and else 0: ahead, right, behind,
        left, each a quarter of the way round.
    Action: (2,) float32 turn, drive: the turning speed changes by turn - .5 degrees per step, up to +-3; the speed by
        .01 (drive - .5) m per step, up to +-.03.
    Turns: the robot. In a step it turns, then it drives; where it would touch a wall it stays, and keeps its speeds.
    Start: at rest in a corner far from the goal, heading right; the same for every seed.
    End: after ``steps`` steps, or when the robot's centre is less than .05 m from the goal.
    Fitness: 1 - distance to the goal at the end / the maze's diagonal; who reaches it, 1 + the share of the steps not needed.
    Metrics: ``x``, ``y``: where the robot ended, m; ``reached``: 1 or 0; ``distance`` to the goal at the end, m.
    """

    settings_type = Settings
    metrics = ("x", "y", "reached", "distance")
    inputs, outputs = INPUTS, OUTPUTS
    sensors = (
        *("range_left", "range_ahead_left", "range_ahead", "range_ahead_right", "range_right", "range_back"),
        *("goal_ahead", "goal_right", "goal_behind", "goal_left"),
    )
    actuators = ("turn", "drive")
    owners = (0,)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._plan = np.array(PLANS[settings.map])
        width, height = PLANS[settings.map][WIDTH:]
        rim = ((0.0, 0.0, width, 0.0), (0.0, height, width, height), (0.0, 0.0, 0.0, height), (width, 0.0, width, height))
        self._walls = np.array([*rim, *WALLS[settings.map]])

    def reset(self, seed: int) -> Turn:  # noqa: ARG002  nothing is drawn
        """Put the robot where it starts."""
        self._world, self._game = np.empty(5), np.empty(2, np.int64)
        start(self._plan, self._world, self._game)
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive the robot."""
        act(actions[0], self._walls, self._plan, self._world, self._game)
        return self._turn() if goes_on(self._game, self.settings.steps) else None

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness, metrics = np.zeros(1), np.zeros(len(self.metrics))
        judge(self._plan, self._world, self._game, self.settings.steps, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """The maze, its walls as thick as can be seen."""
        rim, thick = 0.05, 0.02
        _, _, _, goal_x, goal_y, width, height = PLANS[self.settings.map]
        walls = [
            Place("wall", rim + left - thick / 2, rim + top - thick / 2, right - left + thick, bottom - top + thick)
            for left, top, right, bottom in self._walls.tolist()
        ]
        x, y = float(self._world[X]) + rim, float(self._world[Y]) + rim
        towards = float(self._world[HEADING]) * RADIANS
        return Frame(
            width + 2 * rim,
            height + 2 * rim,
            [*walls, Place("goal", rim + goal_x - NEAR, rim + goal_y - NEAR, 2 * NEAR, 2 * NEAR)],
            [Body("robot at the goal" if self._game[REACHED] else "robot", x, y, RADIUS, towards)],
            rays=[Ray(finder, PI / 4 * turn, 0.0, SIGHT) for finder, turn in enumerate(FINDER_TURNS)],
        )

    def play(self, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play``."""
        state = np.empty(batch.state_size, np.float32)
        play_trials(
            step, batch.parameters, batch.participants, state, self._walls, self._plan, self.settings.steps, batch.progress,
            batch.fitness, batch.metrics,
        )  # fmt: skip

    def _turn(self) -> Turn:
        observation = np.empty((1, INPUTS), np.float32)
        observe(self._walls, self._plan, self._world, observation[0])
        return Turn((0,), observation)


@inline
def start(plan, world, game):  # type: ignore[no-untyped-def]  # compiled
    """Put the robot where it starts."""
    world[X], world[Y], world[HEADING] = plan[START_X], plan[START_Y], plan[START_HEADING]
    world[SPEED], world[TURNING] = 0.0, 0.0
    game[DECISIONS], game[REACHED] = 0, 0


@inline
def find_wall(walls, x, y, dx, dy):  # type: ignore[no-untyped-def]  # compiled
    """How far the next wall is from a point in a direction, at most ``SIGHT``."""
    nearest = SIGHT
    for wall in range(walls.shape[0]):
        left, top, right, bottom = walls[wall, 0], walls[wall, 1], walls[wall, 2], walls[wall, 3]
        if left == right:
            if dx != 0.0:
                far = (left - x) / dx
                across = y + far * dy
                if 0.0 <= far < nearest and top <= across <= bottom:
                    nearest = far
        elif dy != 0.0:
            far = (top - y) / dy
            across = x + far * dx
            if 0.0 <= far < nearest and left <= across <= right:
                nearest = far
    return nearest


@inline
def observe(walls, plan, world, observation):  # type: ignore[no-untyped-def]  # compiled
    """What the robot observes."""
    towards = world[HEADING] * RADIANS
    dx, dy = cos(towards), sin(towards)
    for finder in range(FINDERS.shape[0]):
        along, aside = FINDERS[finder, 0], FINDERS[finder, 1]
        observation[finder] = find_wall(walls, world[X], world[Y], dx * along - dy * aside, dy * along + dx * aside)
    x, y = plan[GOAL_X] - world[X], plan[GOAL_Y] - world[Y]
    ahead, right = x * dx + y * dy, y * dx - x * dy
    compass = FINDERS.shape[0]
    for number in range(compass, compass + 4):
        observation[number] = ZERO
    if ahead >= abs(right):
        observation[compass] = ONE
    elif right > abs(ahead):
        observation[compass + 1] = ONE
    elif -ahead >= abs(right):
        observation[compass + 2] = ONE
    else:
        observation[compass + 3] = ONE


@inline
def within(speed, most):  # type: ignore[no-untyped-def]  # compiled
    """A speed, cut to plus or minus the most; NaN stays."""
    if speed > most:
        return most
    if speed < -most:
        return -most
    return speed


@inline
def touches(walls, x, y):  # type: ignore[no-untyped-def]  # compiled
    """Whether a robot with its centre there would touch a wall."""
    for wall in range(walls.shape[0]):
        dx = max(walls[wall, 0] - x, x - walls[wall, 2], 0.0)
        dy = max(walls[wall, 1] - y, y - walls[wall, 3], 0.0)
        if dx * dx + dy * dy < RADIUS * RADIUS:
            return True
    return False


@inline
def away(plan, world):  # type: ignore[no-untyped-def]  # compiled
    """The distance from the robot to the goal."""
    dx, dy = plan[GOAL_X] - world[X], plan[GOAL_Y] - world[Y]
    return np.sqrt(dx * dx + dy * dy)


@inline
def act(action, walls, plan, world, game):  # type: ignore[no-untyped-def]  # compiled
    """One step."""
    world[TURNING] = within(world[TURNING] + SHARPEST * (np.float64(action[0]) - 0.5), QUICKEST)
    world[SPEED] = within(world[SPEED] + STRONGEST * (np.float64(action[1]) - 0.5), FASTEST)
    world[HEADING] = world[HEADING] + world[TURNING]
    towards = world[HEADING] * RADIANS
    x, y = world[X] + world[SPEED] * cos(towards), world[Y] + world[SPEED] * sin(towards)
    if not touches(walls, x, y):
        world[X], world[Y] = x, y
    game[DECISIONS] += 1
    if away(plan, world) < NEAR:
        game[REACHED] = 1


@inline
def goes_on(game, steps):  # type: ignore[no-untyped-def]  # compiled
    """Whether another step follows."""
    return game[DECISIONS] < steps and game[REACHED] == 0


@inline
def judge(plan, world, game, steps, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    distance = away(plan, world)
    if game[REACHED]:
        fitness[0] = 1.0 + np.float64(steps - game[DECISIONS]) / np.float64(steps)
    else:
        fitness[0] = 1.0 - distance / np.sqrt(plan[WIDTH] * plan[WIDTH] + plan[HEIGHT] * plan[HEIGHT])
    metrics[0], metrics[1], metrics[2], metrics[3] = world[X], world[Y], game[REACHED], distance


@kernel(
    void(STEP, array(float32, 2), array(int64, 2), array(float32), array(float64, 2), array(float64), int64, array(int64),
         array(float64, 2), array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, parameters, participants, state, walls, plan, steps, progress, fitness, metrics
):
    """All trials of a batch, see ``CompiledSimulator.play``."""
    observation, action = np.empty(INPUTS, np.float32), np.empty(OUTPUTS, np.float32)
    world, game = np.empty(5), np.empty(2, np.int64)
    for trial in range(participants.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        controller = parameters[participants[trial, 0]]
        state[:] = 0
        start(plan, world, game)
        while goes_on(game, steps):
            observe(walls, plan, world, observation)
            step(controller, state, observation, action)
            act(action, walls, plan, world, game)
        judge(plan, world, game, steps, fitness[trial], metrics[trial])
