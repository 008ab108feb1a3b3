"""A robot in a maze where the direct way to the goal ends at a wall.

Task, robot and sensors are those of J. Lehman, K. O. Stanley, "Abandoning Objectives: Evolution
Through the Search for Novelty Alone", Evolutionary Computation 19(2), 2011, section 4, scaled to 1
m for 100 of their units. The mazes are our own, with walls along the axes. A controller that is
selected for nearness to the goal ends behind the wall next to it; novelty search finds the way
round.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import Annotated, Literal

import numpy as np

from zswarm.config.meta import PartSettings, about
from zswarm.kernels.jit import inline
from zswarm.kernels.portable import PI, cos, sin
from zswarm.sims.simulator import Body, Frame, Ray, Rectangle, Steps
from zswarm.sims.trial import OneAgent, problem, world

RADIUS = 0.08  # m, of the robot
SIGHT = 1.0  # m, of a range finder
NEAR = 0.05  # m from the goal at which it is reached
# m per step; the speed changes by at most half of the second.
FASTEST, ACCELERATION = 0.03, 0.01
TURN_FASTEST, TURN_ACCELERATION = 3.0, 1.0  # degrees per step, likewise
RADIANS = PI / 180.0
ROOT_HALF = 0.7071067811865476
FINDERS = np.array(  # directions in the robot's frame: ahead, to the right
    [
        *([0.0, -1.0], [ROOT_HALF, -ROOT_HALF], [1.0, 0.0]),
        *([ROOT_HALF, ROOT_HALF], [0.0, 1.0], [-1.0, 0.0]),
    ]
)
FINDER_TURNS = (-2, -1, 0, 1, 2, 4)  # the same in eighths of a turn, clockwise from ahead
ZERO, ONE = np.float32(0), np.float32(1)

PLANS = {
    "medium": (0.2, 0.75, 0.0, 2.75, 0.25, 3.0, 1.5),
    "hard": (0.3, 1.75, 0.0, 0.3, 0.25, 2.0, 2.0),
}
# (x, y, x, y) of the ends of the inner walls; the first end is the left or upper one.
WALLS = {
    "medium": (
        (0.7, 0.0, 0.7, 1.05),
        (1.3, 0.45, 1.3, 1.5),
        (1.9, 0.0, 1.9, 1.05),
        (2.4, 0.45, 3.0, 0.45),
    ),
    "hard": (
        (0.0, 0.5, 1.4, 0.5),  # between the goal and all places near it
        (0.6, 0.5, 0.6, 1.4),  # closes the direct way on the right
        (0.6, 1.1, 1.5, 1.1),
        (1.1, 1.5, 1.1, 2.0),
        (1.0, 0.8, 2.0, 0.8),
    ),
}

# ``constants``: the plan of the maze.
START_X, START_Y, START_HEADING, GOAL_X, GOAL_Y, WIDTH, HEIGHT = range(7)
# ``state``: m; degrees, 0 to the right, clockwise; m and degrees per step.
X, Y, HEADING, SPEED, TURNING = range(5)
STEPS = 0  # ``rules``
DECISIONS, REACHED = range(2)  # ``counts``


class MazeSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    map: Annotated[
        Literal["medium", "hard"],
        about(
            "medium: some dead ends; hard: the direct way ends next to the goal, behind a wall"
        ),
    ] = "hard"
    steps: Steps = 400


class Maze(OneAgent):
    """A robot finds the goal of a maze although the direct way leads into a dead end.

    The robot is a disc with a radius of 0.08 m. x is to the right and y downwards from the upper
    left corner, in m; headings are degrees, 0 to the right, clockwise. The maze hard is 2 m by 2 m,
    medium 3 m by 1.5 m.

    Observation: (10,) float32. Six range finders look from the robot's centre to the left, ahead
        left, ahead, ahead right, right and back: distance to the next wall in m, at most 1. A
        compass has four numbers for the quarters ahead, right, behind and left: 1 for the one with
        the goal, else 0.
    Action: (2,) float32 turn, drive: the turning speed changes by turn - 0.5 degrees per step, up
        to 3 to each side; the speed by 0.01 (drive - 0.5) m per step, up to 0.03 ahead or back.
    Turns: the robot. In a step it turns, then it drives; where it would touch a wall it stays, and
        keeps its speeds.
    Start: at rest in a corner far from the goal, heading right; the same for every seed.
    End: after ``steps`` steps, or when the robot's centre is less than 0.05 m from the goal.
    Fitness: 1 - distance to the goal at the end / the maze's diagonal; at the goal 1 + the share of
        the steps that are not needed.
    Metrics: ``x``, ``y``: where the robot ended, m; ``reached``: 1 or 0; ``distance`` to the goal
        at the end, m.
    """

    settings_type = MazeSettings
    metrics = ("x", "y", "reached", "distance")
    sensors = (
        *("range_left", "range_ahead_left", "range_ahead"),
        *("range_ahead_right", "range_right", "range_back"),
        *("goal_ahead", "goal_right", "goal_behind", "goal_left"),
    )
    actuators = ("turn", "drive")
    inputs, outputs = len(sensors), len(actuators)
    settings: MazeSettings

    def __init__(self, settings: MazeSettings) -> None:
        super().__init__(settings)
        plan = PLANS[settings.map]
        inner = WALLS[settings.map]
        width, height = plan[WIDTH:]
        rim = [
            (0.0, 0.0, width, 0.0),
            (0.0, height, width, height),
            (0.0, 0.0, 0.0, height),
            (width, 0.0, width, height),
        ]
        self.world = world(
            rules=[settings.steps],
            constants=plan,
            walls=[*rim, *inner],
            state=5,
            counts=2,
        )

    def frame(self) -> Frame:
        """Draw the maze with walls of visible thickness."""
        rim = 0.05
        thick = 0.02
        _, _, _, goal_x, goal_y, width, height = PLANS[self.settings.map]
        corner = rim - thick / 2
        places = [
            Rectangle(
                "wall",
                corner + left,
                corner + top,
                right - left + thick,
                low - top + thick,
            )
            for left, top, right, low in self.world.walls.tolist()
        ]
        corner = rim - NEAR
        places.append(
            Rectangle("goal", corner + goal_x, corner + goal_y, 2 * NEAR, 2 * NEAR)
        )
        x, y, heading = self.world.state[: HEADING + 1].tolist()
        kind = "robot at the goal" if self.world.counts[REACHED] else "robot"
        robot = Body(kind, x + rim, y + rim, RADIUS, heading * RADIANS)
        rays = [
            Ray(finder, PI / 4 * turn, 0.0, SIGHT)
            for finder, turn in enumerate(FINDER_TURNS)
        ]
        return Frame(width + 2 * rim, height + 2 * rim, places, [robot], rays=rays)


@inline(counts=False)
def start(world, seed):  # noqa: ARG001  nothing is drawn
    """Put the robot where it starts."""
    state = world.state
    plan = world.constants
    state[X] = plan[START_X]
    state[Y] = plan[START_Y]
    state[HEADING] = plan[START_HEADING]
    state[SPEED] = 0.0
    state[TURNING] = 0.0
    world.counts[:] = 0


@inline(counts=False)
def observe(world, observation):
    """Write what the range finders and the compass read."""
    state = world.state
    towards = state[HEADING] * RADIANS
    dx = cos(towards)
    dy = sin(towards)
    for finder in range(FINDERS.shape[0]):
        along = FINDERS[finder, 0]
        aside = FINDERS[finder, 1]
        observation[finder] = find_wall(
            world.walls,
            state[X],
            state[Y],
            dx * along - dy * aside,
            dy * along + dx * aside,
        )
    x = world.constants[GOAL_X] - state[X]
    y = world.constants[GOAL_Y] - state[Y]
    ahead = x * dx + y * dy
    right = y * dx - x * dy
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


@inline(counts=False)
def find_wall(walls, x, y, dx, dy):
    """Return the distance to the next wall in a direction, at most ``SIGHT``."""
    nearest = SIGHT
    for wall in range(walls.shape[0]):
        left = walls[wall, 0]
        top = walls[wall, 1]
        right = walls[wall, 2]
        bottom = walls[wall, 3]
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


@inline(counts=False)
def act(world, action):
    """Turn, then drive."""
    state = world.state
    counts = world.counts
    turn = np.float64(action[0]) - 0.5
    drive = np.float64(action[1]) - 0.5
    state[TURNING] = limited(state[TURNING] + TURN_ACCELERATION * turn, TURN_FASTEST)
    state[SPEED] = limited(state[SPEED] + ACCELERATION * drive, FASTEST)
    state[HEADING] += state[TURNING]
    towards = state[HEADING] * RADIANS
    x = state[X] + state[SPEED] * cos(towards)
    y = state[Y] + state[SPEED] * sin(towards)
    if not touches(world.walls, x, y):
        state[X] = x
        state[Y] = y
    counts[DECISIONS] += 1
    if goal_distance(world) < NEAR:
        counts[REACHED] = 1


@inline(counts=False)
def limited(speed, most):
    """Limit the size of a speed; NaN stays NaN."""
    if speed > most:
        return most
    if speed < -most:
        return -most
    return speed


@inline(counts=False)
def touches(walls, x, y):
    """Return whether a robot with its centre at (x, y) touches a wall."""
    for wall in range(walls.shape[0]):
        dx = max(walls[wall, 0] - x, x - walls[wall, 2], 0.0)
        dy = max(walls[wall, 1] - y, y - walls[wall, 3], 0.0)
        if dx * dx + dy * dy < RADIUS * RADIUS:
            return True
    return False


@inline(counts=False)
def goal_distance(world):
    """Return the distance from the robot to the goal."""
    plan = world.constants
    state = world.state
    dx = plan[GOAL_X] - state[X]
    dy = plan[GOAL_Y] - state[Y]
    return np.sqrt(dx * dx + dy * dy)


@inline(counts=False)
def is_over(world):
    """Return whether the trial ends."""
    return world.counts[DECISIONS] >= world.rules[STEPS] or world.counts[REACHED] == 1


@inline(counts=False)
def judge(world, fitness, metrics):
    """Write fitness and metrics of a trial that ended."""
    plan = world.constants
    state = world.state
    counts = world.counts
    steps = world.rules[STEPS]
    distance = goal_distance(world)
    if counts[REACHED]:
        fitness[0] = 1.0 + np.float64(steps - counts[DECISIONS]) / np.float64(steps)
    else:
        diagonal = np.sqrt(plan[WIDTH] * plan[WIDTH] + plan[HEIGHT] * plan[HEIGHT])
        fitness[0] = 1.0 - distance / diagonal
    metrics[0] = state[X]
    metrics[1] = state[Y]
    metrics[2] = counts[REACHED]
    metrics[3] = distance


Maze.problem = problem("play_maze", start, observe, act, is_over, judge)
