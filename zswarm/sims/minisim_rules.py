"""The rules of ``minisim``, for one team against defenders and for two teams.

State is integers, each team's in its own view: its home is the column x = 0, and what is at (x, y)
for one team is at (width - 1 - x, height - 1 - y) for the other. So the field is the same for both,
and no rule depends on which team is first.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import NamedTuple

import numpy as np

from zswarm.kernels.jit import inline
from zswarm.kernels.random import draw_integer
from zswarm.kernels.signatures import Int64Rows, Int64s, UInt64s

BACK, FORTH = np.float32(0.25), np.float32(0.75)  # an output below the first steps back
ZERO, ONE = np.float32(0), np.float32(1)
NOBODY = -1

# ``robots``; MARK: the step in which a defender last chose it, or whether it is tagged now
X, Y, START_Y, MARK, ROBOT_COLUMNS = range(5)
# ``games``
CARRIER, STEP_NUMBER, CAPTURES, STEALS, TAGGED, CLOSEST, NEAREST_HOME, GAME_COLUMNS = (
    range(8)
)


class MinisimWorld(NamedTuple):
    """Settings, and the state of a trial."""

    steps: int
    width: int
    height: int
    number: int  # of the robots of a team
    robot_sight: int
    defender_sight: int
    reach: int
    rest: int
    robots: Int64Rows  # the first team's first
    defenders: Int64Rows  # x and y
    stand: Int64s  # x and y of the flag's stand, in each team's view
    games: Int64Rows  # a row for each team
    stream: UInt64s


@inline(counts=False)
def start(world, seed):
    """Lay out a trial; two teams start in the same way, each in its view."""
    robots = world.robots
    stand = world.stand
    stream = world.stream
    stream[0] = seed
    stand[X] = world.width - 1 - draw_integer(stream, world.width // 2)
    stand[Y] = draw_integer(stream, world.height)
    robots[:] = 0
    for robot in range(world.number):
        y = draw_integer(stream, world.height)
        for row in range(robot, robots.shape[0], world.number):
            robots[row, Y] = y
            robots[row, START_Y] = y
    for defender in range(world.defenders.shape[0]):
        world.defenders[defender, X] = stand[X]
        world.defenders[defender, Y] = stand[Y]
    world.games[:] = 0
    for team in range(world.games.shape[0]):
        begin_attempt(world, team)


@inline(counts=False)
def begin_attempt(world, team):
    """Put the flag that a team is after on its stand, and forget what was done to capture it."""
    world.games[team, CARRIER] = NOBODY
    world.games[team, CLOSEST] = max(world.width, world.height)
    world.games[team, NEAREST_HOME] = world.stand[X]


@inline(counts=False)
def distance(dx, dy):
    """Return the king moves of an offset."""
    return max(abs(dx), abs(dy))


@inline(counts=False)
def intrudes(world, x):
    """Return whether a robot is in the other's half; the middle column belongs to no team."""
    return 2 * x > world.width - 1


@inline(counts=False)
def observe(world, observations):
    """Write what all robots observe."""
    inputs = observations.shape[0] // world.robots.shape[0]
    for robot in range(world.robots.shape[0]):
        observe_one(world, robot, observations[inputs * robot : inputs * (robot + 1)])


@inline(counts=False)
def observe_one(world, robot, observation):
    """Write what a robot observes."""
    robots = world.robots
    stand = world.stand
    games = world.games
    many = world.number
    team = int(robot >= many)
    x = robots[robot, X]
    y = robots[robot, Y]
    carrier = games[team, CARRIER]
    carries = carrier == robot
    dx, dy = (-x, 0) if carries else (stand[X] - x, stand[Y] - y)
    bearing(world, dx, dy, observation, 0)
    observation[7] = ONE if carries else ZERO
    observation[8] = ONE if carrier != NOBODY and not carries else ZERO
    if games.shape[0] == 1:
        defenders = world.defenders
        sense(world, x, y, defenders, 0, defenders.shape[0], NOBODY, 1, observation, 3)
        # Indices that begin with 0 need no check for negative ones.
        sense(world, x, y, robots, 0, robots.shape[0], robot, 1, observation, 5)
    else:
        first = team * many
        begin = (1 - team) * many
        seen_x, seen_y = world.width - 1 - x, world.height - 1 - y  # by the other team
        sense(
            world, seen_x, seen_y, robots, begin, begin + many, NOBODY, -1, observation, 3
        )
        sense(world, x, y, robots, first, first + many, robot, 1, observation, 5)
        thief = games[1 - team, CARRIER]
        flag_x = stand[X]
        flag_y = stand[Y]
        if thief != NOBODY:
            flag_x = robots[thief, X]
            flag_y = robots[thief, Y]
        bearing(world, seen_x - flag_x, seen_y - flag_y, observation, 9)
        observation[12] = ONE if thief != NOBODY else ZERO
        observation[13] = ONE if intrudes(world, x) else ZERO


@inline(counts=False)
def bearing(world, dx, dy, observation, at):
    """Write direction and nearness of something whose place is always known."""
    away = distance(dx, dy)
    observation[at] = np.float32(dx) / np.float32(max(away, 1))
    observation[at + 1] = np.float32(dy) / np.float32(max(away, 1))
    observation[at + 2] = ONE - np.float32(away) / np.float32(
        max(world.width, world.height)
    )


@inline(counts=False)
def sense(world, x, y, others, first, end, itself, sign, observation, at):
    """Write an arrow to the nearest of the others in sight, longer the nearer it is.

    Args:
        x, y: the robot's cell in the view of the others.
        others, first, end: a table, and the rows to look at.
        itself: the row to pass over.
        sign: -1 if the others are in the view of the other team, else 1.
    """
    sight = world.robot_sight
    least = sight
    dx = 0
    dy = 0
    for other in range(first, end):
        to_x = sign * (others[other, X] - x)
        to_y = sign * (others[other, Y] - y)
        if distance(to_x, to_y) < least and other != itself:
            least = distance(to_x, to_y)
            dx = to_x
            dy = to_y
    nearness = np.float32(sight - least) / np.float32(sight)
    observation[at] = np.float32(dx) / np.float32(max(least, 1)) * nearness
    observation[at + 1] = np.float32(dy) / np.float32(max(least, 1)) * nearness


@inline(counts=False)
def act(world, actions):
    """Play one step, given the actions of all robots."""
    games = world.games
    rest = world.rest
    move(world, actions)
    for team in range(games.shape[0]):
        games[team, STEP_NUMBER] += 1
    score(world, 0)
    if games.shape[0] == 2:
        score(world, 1)
        tag_intruders(world)
    else:
        if rest == 0 or games[0, STEP_NUMBER] % rest != 0:
            move_defenders(world)
        tag(world)


@inline(counts=False)
def velocity(output):
    """Return -1, 0 or 1; NaN means no move."""
    return int(output > FORTH) - int(output < BACK)


@inline(counts=False)
def move(world, actions):
    """Move all robots by one cell at most."""
    robots = world.robots
    many = world.robots.shape[0]
    for robot in range(many):
        x = robots[robot, X] + velocity(actions[robot])
        y = robots[robot, Y] + velocity(actions[many + robot])
        robots[robot, X] = min(max(x, 0), world.width - 1)
        robots[robot, Y] = min(max(y, 0), world.height - 1)


@inline(counts=False)
def score(world, team):
    """Let a robot of a team take the flag, or bring it home."""
    robots = world.robots
    stand = world.stand
    games = world.games
    many = world.number
    for robot in range(team * many, (team + 1) * many):
        away = distance(stand[X] - robots[robot, X], stand[Y] - robots[robot, Y])
        games[team, CLOSEST] = min(games[team, CLOSEST], away)
        if away == 0 and games[team, CARRIER] == NOBODY:
            games[team, CARRIER] = robot
            games[team, STEALS] += 1
    if games[team, CARRIER] != NOBODY:
        games[team, NEAREST_HOME] = min(
            games[team, NEAREST_HOME], robots[games[team, CARRIER], X]
        )
        if games[team, NEAREST_HOME] == 0:
            games[team, CAPTURES] += 1
            begin_attempt(world, team)


@inline(counts=False)
def move_defenders(world):
    """Let each defender follow a robot that no other one follows, or return to the stand."""
    robots = world.robots
    defenders = world.defenders
    stand = world.stand
    step = world.games[0, STEP_NUMBER]
    for defender in range(defenders.shape[0]):
        x = defenders[defender, X]
        y = defenders[defender, Y]
        least = world.defender_sight + 1
        prey = NOBODY
        dx = stand[X] - x
        dy = stand[Y] - y
        for robot in range(robots.shape[0]):
            to_x = robots[robot, X] - x
            to_y = robots[robot, Y] - y
            free = robots[robot, X] > 0 and robots[robot, MARK] != step
            if free and distance(to_x, to_y) < least:
                least = distance(to_x, to_y)
                prey = robot
                dx = to_x
                dy = to_y
        if prey != NOBODY:
            robots[prey, MARK] = step
        defenders[defender, X] = x + min(max(dx, -1), 1)
        defenders[defender, Y] = y + min(max(dy, -1), 1)


@inline(counts=False)
def tag(world):
    """Send robots home that a defender reaches."""
    robots = world.robots
    defenders = world.defenders
    for robot in range(robots.shape[0]):
        for defender in range(defenders.shape[0]):
            dx = defenders[defender, X] - robots[robot, X]
            dy = defenders[defender, Y] - robots[robot, Y]
            if robots[robot, X] > 0 and distance(dx, dy) <= world.reach:
                send_home(world, robot)
                world.games[0, TAGGED] += 1


@inline(counts=False)
def send_home(world, robot):
    """Put a robot on its start cell, and the flag, if it has it, on the stand."""
    robots = world.robots
    games = world.games
    team = robot // world.number
    robots[robot, X] = 0
    robots[robot, Y] = robots[robot, START_Y]
    if games[team, CARRIER] == robot:
        games[team, CARRIER] = NOBODY


@inline(counts=False)
def tag_intruders(world):
    """Send home intruders that guards reach, and these guards; all are found before any is sent."""
    robots = world.robots
    many = world.number
    robots[:, MARK] = 0
    for one in range(many):
        for other in range(many, 2 * many):
            dx = world.width - 1 - robots[other, X] - robots[one, X]
            dy = world.height - 1 - robots[other, Y] - robots[one, Y]
            differ = intrudes(world, robots[one, X]) != intrudes(world, robots[other, X])
            if distance(dx, dy) <= world.reach and differ:
                robots[one, MARK] = robots[other, MARK] = 1
    for robot in range(robots.shape[0]):
        if robots[robot, MARK] == 1:
            world.games[robot // many, TAGGED] += int(intrudes(world, robots[robot, X]))
            send_home(world, robot)


@inline(counts=False)
def is_over(world):
    """Return whether the trial ends."""
    return world.games[0, STEP_NUMBER] >= world.steps


@inline(counts=False)
def judge(world, fitness, metrics):
    """Write the teams' fitness, and the metrics of both together."""
    games = world.games
    metrics[:] = 0.0
    for team in range(games.shape[0]):
        there = 1.0 - games[team, CLOSEST] / max(world.width, world.height)
        back = 1.0 - games[team, NEAREST_HOME] / world.stand[X]
        fitness[team] = games[team, CAPTURES] + (there + back) / 2.0
        metrics[0] += games[team, CAPTURES]
        metrics[1] += games[team, STEALS]
        metrics[2] += games[team, TAGGED]
