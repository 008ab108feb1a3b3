"""The game of two teams in minisim: each fetches the other's flag and guards its own.

State is integers, each team's in its own view: its home is the column x = 0, and what is at (x, y) for one team is at
(width - 1 - x, height - 1 - y) for the other. So the field is the same for both, and the rules have no first and second.
"""

import numpy as np

from zswarm.draws import draw_integer
from zswarm.jit import STEP, array, float32, float64, inline, int64, kernel, uint64, void
from zswarm.sims.minisim_board import (
    HEIGHT,
    NOBODY,
    ONE,
    OUTPUTS,
    REACH,
    ROBOT_SIGHT,
    ROBOTS,
    STEPS,
    WIDTH,
    ZERO,
    Game,
    arrow,
    bearing,
    distance,
    move,
)

INPUTS = 14
X, Y, START_Y, TAGGED_NOW = range(4)  # ``robots``: a row each, the first team's first
CARRIER, STEP_NUMBER, CAPTURES, STEALS, TAGGED, CLOSEST, NEAREST_HOME = range(7)  # ``games``: a row for each team

GRIDS, TABLE, NUMBERS = array(float32, 2), array(int64, 2), array(int64)


def tables(robots: int, _defenders: int) -> tuple[np.ndarray, ...]:
    """Robots, the stand of the other's flag, games."""
    return np.zeros((2 * robots, 4), np.int64), np.zeros(2, np.int64), np.zeros((2, 7), np.int64)


@inline
def begin_attempt(team, stand, games, rules):  # type: ignore[no-untyped-def]  # compiled
    """The flag that a team is after is on its stand, and nothing was done yet towards the next capture."""
    games[team, CARRIER] = NOBODY
    games[team, CLOSEST] = max(rules[WIDTH], rules[HEIGHT])
    games[team, NEAREST_HOME] = stand[X]


@inline
def start(seed, robots, stand, games, rules):  # type: ignore[no-untyped-def]  # compiled
    """Lay out a trial: the same for both teams, each in its view."""
    state = np.empty(1, np.uint64)
    state[0] = seed
    stand[X] = rules[WIDTH] - 1 - draw_integer(state, rules[WIDTH] // 2)
    stand[Y] = draw_integer(state, rules[HEIGHT])
    games[:] = 0
    for robot in range(rules[ROBOTS]):
        y = draw_integer(state, rules[HEIGHT])
        for row in (robot, rules[ROBOTS] + robot):
            robots[row, X], robots[row, Y], robots[row, START_Y] = 0, y, y
    for team in range(2):
        begin_attempt(team, stand, games, rules)


@inline
def sense(x, y, team, own, itself, robots, rules, observation, at, stride):  # type: ignore[no-untyped-def]  # compiled
    """Write where the nearest other robot is, of the own team or the other one."""
    least, dx, dy = rules[ROBOT_SIGHT], 0, 0
    first = (team if own else 1 - team) * rules[ROBOTS]
    for other in range(first, first + rules[ROBOTS]):
        to_x, to_y = robots[other, X], robots[other, Y]
        if not own:
            to_x, to_y = rules[WIDTH] - 1 - to_x, rules[HEIGHT] - 1 - to_y
        to_x, to_y = to_x - x, to_y - y
        if distance(to_x, to_y) < least and other != itself:
            least, dx, dy = distance(to_x, to_y), to_x, to_y
    arrow(dx, dy, least, rules[ROBOT_SIGHT], observation, at, stride)


@inline
def observe(robot, robots, stand, games, rules, observation, stride):  # type: ignore[no-untyped-def]  # compiled
    """What a robot observes, written so far apart."""
    x, y, team = robots[robot, X], robots[robot, Y], robot // rules[ROBOTS]
    carries, thief = games[team, CARRIER] == robot, games[1 - team, CARRIER]
    dx, dy = (-x, 0) if carries else (stand[X] - x, stand[Y] - y)
    bearing(dx, dy, rules, observation, 0, stride)
    sense(x, y, team, False, robot, robots, rules, observation, 3, stride)
    sense(x, y, team, True, robot, robots, rules, observation, 5, stride)
    observation[7 * stride] = ONE if carries else ZERO
    observation[8 * stride] = ONE if games[team, CARRIER] != NOBODY and not carries else ZERO
    flag_x, flag_y = (robots[thief, X], robots[thief, Y]) if thief != NOBODY else (stand[X], stand[Y])
    bearing(rules[WIDTH] - 1 - flag_x - x, rules[HEIGHT] - 1 - flag_y - y, rules, observation, 9, stride)
    observation[12 * stride] = ONE if thief != NOBODY else ZERO
    observation[13 * stride] = ONE if intrudes(x, rules) else ZERO


@inline
def intrudes(x, rules):  # type: ignore[no-untyped-def]  # compiled
    """Whether a robot is in the other's half; the column in the middle is nobody's."""
    return 2 * x > rules[WIDTH] - 1


@inline
def act(actions, robots, stand, games, rules):  # type: ignore[no-untyped-def]  # compiled
    """One step of the game, given the actions of all robots."""
    move(robots, actions, rules)
    for team in range(2):
        games[team, STEP_NUMBER] += 1
        score(team, robots, stand, games, rules)
    tag(robots, games, rules)


@inline
def score(team, robots, stand, games, rules):  # type: ignore[no-untyped-def]  # compiled
    """Let a robot take the other's flag, or bring it home."""
    for robot in range(team * rules[ROBOTS], (team + 1) * rules[ROBOTS]):
        away = distance(stand[X] - robots[robot, X], stand[Y] - robots[robot, Y])
        games[team, CLOSEST] = min(games[team, CLOSEST], away)
        if away == 0 and games[team, CARRIER] == NOBODY:
            games[team, CARRIER] = robot
            games[team, STEALS] += 1
    if games[team, CARRIER] != NOBODY:
        games[team, NEAREST_HOME] = min(games[team, NEAREST_HOME], robots[games[team, CARRIER], X])
        if games[team, NEAREST_HOME] == 0:
            games[team, CAPTURES] += 1
            begin_attempt(team, stand, games, rules)


@inline
def tag(robots, games, rules):  # type: ignore[no-untyped-def]  # compiled
    """Send home intruders that guards reach, and these guards; all see the places before anybody was sent."""
    robots[:, TAGGED_NOW] = 0
    for one in range(rules[ROBOTS]):
        for other in range(rules[ROBOTS], 2 * rules[ROBOTS]):
            dx = rules[WIDTH] - 1 - robots[other, X] - robots[one, X]
            dy = rules[HEIGHT] - 1 - robots[other, Y] - robots[one, Y]
            if distance(dx, dy) <= rules[REACH] and intrudes(robots[one, X], rules) != intrudes(robots[other, X], rules):
                robots[one, TAGGED_NOW] = robots[other, TAGGED_NOW] = 1
    for robot in range(robots.shape[0]):
        if robots[robot, TAGGED_NOW] == 1:
            team = robot // rules[ROBOTS]
            games[team, TAGGED] += int(intrudes(robots[robot, X], rules))
            robots[robot, X], robots[robot, Y] = 0, robots[robot, START_Y]
            if games[team, CARRIER] == robot:
                games[team, CARRIER] = NOBODY


@inline
def judge(stand, games, rules, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness of both teams, and metrics of a trial that ended."""
    for team in range(2):
        there = 1.0 - games[team, CLOSEST] / max(rules[WIDTH], rules[HEIGHT])
        back = 1.0 - games[team, NEAREST_HOME] / stand[X]
        fitness[team] = games[team, CAPTURES] + (there + back) / 2.0
    metrics[0] = games[0, CAPTURES] + games[1, CAPTURES]
    metrics[1] = games[0, STEALS] + games[1, STEALS]
    metrics[2] = games[0, TAGGED] + games[1, TAGGED]


@inline(counts=False)
def play_steps(  # type: ignore[no-untyped-def]  # compiled
    step, together, controllers, states, robots, stand, games, rules, observations, outputs, actions
):
    """Play a trial that was laid out; so many robots of a team decide together, the last one again where there are fewer."""
    groups = states.shape[0] // 2
    for _ in range(rules[STEPS]):
        for group in range(states.shape[0]):
            team = group // groups
            first, last = team * rules[ROBOTS] + group % groups * together, (team + 1) * rules[ROBOTS] - 1
            for lane in range(together):
                observe(min(first + lane, last), robots, stand, games, rules, observations[lane:], together)
            step(controllers[team], states[group], observations, outputs)
            for lane in range(min(together, last + 1 - first)):
                actions[first + lane, X] = outputs[lane]
                actions[first + lane, Y] = outputs[together + lane]
        act(actions, robots, stand, games, rules)


@kernel(
    void(STEP, int64, GRIDS, TABLE, array(uint64), GRIDS, TABLE, NUMBERS, TABLE, NUMBERS, NUMBERS, array(float64, 2),
         array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, together, parameters, participants, seeds, states, robots, stand, games, rules, progress, fitness, metrics
):
    """All trials of a batch, see ``CompiledSimulator.play``; ``step`` decides for so many robots together."""
    observations, outputs = np.empty(INPUTS * together, np.float32), np.empty(OUTPUTS * together, np.float32)
    controllers = np.empty((2, parameters.shape[1] * together), np.float32)
    actions = np.empty((robots.shape[0], OUTPUTS), np.float32)
    for trial in range(seeds.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        for team in range(2):
            for number in range(parameters.shape[1]):
                own = parameters[participants[trial, team], number]
                controllers[team, number * together : (number + 1) * together] = own
        states[:] = 0
        start(seeds[trial], robots, stand, games, rules)
        play_steps(step, together, controllers, states, robots, stand, games, rules, observations, outputs, actions)
        judge(stand, games, rules, fitness[trial], metrics[trial])


DUEL = Game(INPUTS, tables, start, observe, act, judge, play_trials)
