"""Minisim: several robots play capture the flag against scripted defenders.

The minimal simulator of the paper of that name was never published; this game is a design of our own. It has the same
subject (several robots, a two-dimensional grid, a flag to capture) and is meant to be quick to compute and hard to play.
"""

from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.errors import ConfigError
from zswarm.jit import STEP, Step, array, float32, float64, inline, int64, kernel, uint64, void
from zswarm.sims.simulator import CompiledSimulator, Outcome, Turn

INPUTS, OUTPUTS = 9, 2
LOW, HIGH = np.float32(0.25), np.float32(0.75)  # an output below LOW steps back, above HIGH forward
ZERO, ONE = np.float32(0), np.float32(1)

X, Y = 0, 1
NOBODY = -1
# What ``game`` holds, all integers.
CARRIER, CAPTURES, STEALS, TAGGED, CLOSEST, NEAREST_HOME, STEP_NUMBER = range(7)
# What ``rules`` holds, all integers.
WIDTH, HEIGHT, ROBOT_SIGHT, DEFENDER_SIGHT, REACH, REST, PENALTY = range(7)

Length = Annotated[int, Meta(ge=2, le=1_000)]
Sight = Annotated[int, Meta(ge=1, le=1_000)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``; distances are in king moves, so a diagonal neighbour is 1 away."""

    steps: Annotated[int, Meta(ge=1, le=1_000_000)] = 100
    width: Length = 20  # cells
    height: Length = 20  # cells
    robots: Annotated[int, Meta(ge=1, le=1_000)] = 8
    defenders: Annotated[int, Meta(ge=0, le=1_000)] = 2
    robot_sight: Sight = 8  # cells at which defenders and mates fade from a robot's sensors
    defender_sight: Sight = 6  # cells up to which a defender goes for a robot
    reach: Annotated[int, Meta(ge=0, le=1_000)] = 1  # cells up to which a defender tags
    penalty: Annotated[int, Meta(ge=0, le=1_000)] = 10
    rest: Annotated[int, Meta(ge=0, le=1_000_000)] = 4  # defenders stand still in every rest-th step; 0: never


class Minisim(CompiledSimulator):
    """x

    """

    Settings = Settings
    metrics = ("captures", "steals", "tagged")
    inputs, outputs = INPUTS, OUTPUTS
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        if settings.reach >= settings.width // 2:
            raise ConfigError("x")
        self.owners = (0,) * settings.robots
        self._rules = np.array(
            [settings.width, settings.height, settings.robot_sight, settings.defender_sight, settings.reach, settings.rest, settings.penalty]
        )

    def reset(self, seed: int) -> Turn:
        """Draw the start of a seed; all robots act next."""
        self._robots, self._defenders, self._stand, self._game = self._tables()
        self._actions = np.empty((self.settings.robots, OUTPUTS), np.float32)
        start(np.uint64(seed), self._robots, self._defenders, self._stand, self._game, self._rules)
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Move all robots, then the defenders."""
        move_robots(actions, self._robots, self._stand, self._game, self._rules)
        move_defenders(self._robots, self._defenders, self._stand, self._game, self._rules)
        return self._turn() if self._game[STEP_NUMBER] < self.settings.steps else None

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness, metrics = np.zeros(1), np.zeros(len(self.metrics))
        judge(self._stand, self._game, self._rules, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def play(
        self,
        step: Step,
        state_size: int,
        parameters: np.ndarray,
        participants: np.ndarray,
        seeds: np.ndarray,
        progress: np.ndarray,
        fitness: np.ndarray,
        metrics: np.ndarray,
    ) -> None:
        """See ``CompiledSimulator.play``."""
        states = np.zeros((self.settings.robots, state_size), np.float32)
        play_trials(
            step, parameters, participants, seeds.astype(np.uint64), *self._tables(), self._rules, self.settings.steps,
            states, progress, fitness, metrics
        )  # fmt: skip

    def _tables(self):
        return (
            np.zeros((self.settings.robots, 4), np.int64),
            np.zeros((self.settings.defenders, 2), np.int64),
            np.zeros(2, np.int64),
            np.zeros(7, np.int64),
        )

    def _turn(self) -> Turn:
        observations = np.empty((self.settings.robots, INPUTS), np.float32)
        for robot in range(self.settings.robots):
            observe(robot, self._robots, self._defenders, self._stand, self._game, self._rules, observations[robot])
        return Turn(range(self.settings.robots), observations)


TABLE = array(int64, 2)
NUMBERS = array(int64)
GAMMA, MIX_1, MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@inline
def draw(state, bound):  # type: ignore[no-untyped-def]  # compiled
    """The next integer below bound, as ``zswarm.draws.Stream.integer``; state holds the seed at the start."""
    state[0] += GAMMA
    word = state[0]
    word = (word ^ (word >> np.uint64(30))) * MIX_1
    word = (word ^ (word >> np.uint64(27))) * MIX_2
    word = word ^ (word >> np.uint64(31))
    return np.int64(((word >> np.uint64(32)) * np.uint64(bound)) >> np.uint64(32))


@inline
def distance(ax, ay, bx, by):  # type: ignore[no-untyped-def]  # compiled
    """King moves between two cells."""
    return max(abs(ax - bx), abs(ay - by))


@inline
def start(seed, robots, defenders, stand, game, rules):  # type: ignore[no-untyped-def]  # compiled
    state = np.empty(1, np.uint64)
    state[0] = seed
    half = rules[WIDTH] // 2
    stand[X] = rules[WIDTH] - 1 - draw(state, half)
    stand[Y] = draw(state, rules[HEIGHT])
    for robot in range(robots.shape[0]):
        robots[robot, X] = 0
        robots[robot, 3] = 0
        robots[robot, Y] = robots[robot, 2] = draw(state, rules[HEIGHT])
    for defender in range(defenders.shape[0]):
        defenders[defender, X] = stand[X]
        defenders[defender, Y] = stand[Y]
    game[:] = 0
    game[CARRIER] = NOBODY
    game[CLOSEST], game[NEAREST_HOME] = max(rules[WIDTH], rules[HEIGHT]), stand[X]


@inline
def point(dx, dy, sight, observation, index):  # type: ignore[no-untyped-def]  # compiled
    """Write where something is: the nearer the longer, zero from ``sight`` on."""
    away = max(abs(dx), abs(dy))
    if 0 < away < sight:
        nearness = np.float32(sight - away) / np.float32(sight)
        observation[index] = np.float32(dx) / np.float32(away) * nearness
        observation[index + 1] = np.float32(dy) / np.float32(away) * nearness
    else:
        observation[index] = observation[index + 1] = ZERO


@inline
def observe(robot, robots, defenders, stand, game, rules, observation):  # type: ignore[no-untyped-def]  # compiled
    """What a robot observes."""
    x, y = robots[robot, X], robots[robot, Y]
    dx, dy = stand[X] - x, stand[Y] - y
    if game[CARRIER] == robot:
        dx, dy = -x, 0
    away = max(abs(dx), abs(dy))
    observation[0] = np.float32(dx) / np.float32(max(away, 1))
    observation[1] = np.float32(dy) / np.float32(max(away, 1))
    observation[2] = ONE - np.float32(away) / np.float32(max(rules[WIDTH], rules[HEIGHT]))
    near, dx, dy = rules[ROBOT_SIGHT], 0, 0
    for other in range(defenders.shape[0]):
        away = distance(defenders[other, X], defenders[other, Y], x, y)
        if away < near:
            near, dx, dy = away, defenders[other, X] - x, defenders[other, Y] - y
    point(dx, dy, rules[ROBOT_SIGHT], observation, 3)
    near, dx, dy = rules[ROBOT_SIGHT], 0, 0
    for other in range(robots.shape[0]):
        away = distance(robots[other, X], robots[other, Y], x, y)
        if away < near and other != robot:
            near, dx, dy = away, robots[other, X] - x, robots[other, Y] - y
    point(dx, dy, rules[ROBOT_SIGHT], observation, 5)
    observation[7] = ONE if game[CARRIER] == robot else ZERO
    observation[8] = ONE if game[CARRIER] != robot and game[CARRIER] != NOBODY else ZERO


@inline
def velocity(output):  # type: ignore[no-untyped-def]  # compiled
    return -1 if output < LOW else (1 if output > HIGH else 0)


@inline
def move_robots(actions, robots, stand, game, rules):  # type: ignore[no-untyped-def]  # compiled
    for robot in range(robots.shape[0]):
        if game[STEP_NUMBER] < robots[robot, 3]:
            continue
        robots[robot, X] = min(max(robots[robot, X] + velocity(actions[robot, X]), 0), rules[WIDTH] - 1)
        robots[robot, Y] = min(max(robots[robot, Y] + velocity(actions[robot, Y]), 0), rules[HEIGHT] - 1)
    for robot in range(robots.shape[0]):
        away = distance(robots[robot, X], robots[robot, Y], stand[X], stand[Y])
        game[CLOSEST] = min(game[CLOSEST], away)
        if away == 0 and game[CARRIER] == NOBODY:
            game[CARRIER] = robot
            game[STEALS] += 1
    if game[CARRIER] != NOBODY:
        game[NEAREST_HOME] = min(game[NEAREST_HOME], robots[game[CARRIER], X])
        if robots[game[CARRIER], X] == 0:
            game[CAPTURES] += 1
            game[CARRIER] = NOBODY
            game[CLOSEST], game[NEAREST_HOME] = max(rules[WIDTH], rules[HEIGHT]), stand[X]


@inline
def move_defenders(robots, defenders, stand, game, rules):  # type: ignore[no-untyped-def]  # compiled
    game[STEP_NUMBER] += 1
    resting = rules[REST] > 0 and game[STEP_NUMBER] % rules[REST] == 0
    chased = np.zeros(robots.shape[0], np.uint8)
    if not resting:
        for defender in range(defenders.shape[0]):
            x, y = defenders[defender, X], defenders[defender, Y]
            near, prey = rules[DEFENDER_SIGHT] + 1, NOBODY
            for robot in range(robots.shape[0]):
                away = distance(robots[robot, X], robots[robot, Y], x, y)
                if away < near and robots[robot, X] > 0 and not chased[robot]:
                    near, prey = away, robot
            to_x, to_y = stand[X], stand[Y]
            if prey != NOBODY:
                chased[prey] = 1
                to_x, to_y = robots[prey, X], robots[prey, Y]
            defenders[defender, X] = x + min(max(to_x - x, -1), 1)
            defenders[defender, Y] = y + min(max(to_y - y, -1), 1)
    for robot in range(robots.shape[0]):
        if robots[robot, X] > 0:
            for defender in range(defenders.shape[0]):
                if distance(robots[robot, X], robots[robot, Y], defenders[defender, X], defenders[defender, Y]) <= rules[REACH]:
                    robots[robot, X], robots[robot, Y] = 0, robots[robot, 2]
                    robots[robot, 3] = game[STEP_NUMBER] + rules[PENALTY]
                    game[TAGGED] += 1
                    if game[CARRIER] == robot:
                        game[CARRIER] = NOBODY
                    break


@inline
def judge(stand, game, rules, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    there = 1.0 - game[CLOSEST] / max(rules[WIDTH], rules[HEIGHT])
    back = 1.0 - game[NEAREST_HOME] / stand[X]
    fitness[0] = game[CAPTURES] + (there + back) / 2.0
    metrics[0] = game[CAPTURES]
    metrics[1] = game[STEALS]
    metrics[2] = game[TAGGED]


@kernel(
    void(STEP, array(float32, 2), array(int64, 2), array(uint64), TABLE, TABLE, NUMBERS, NUMBERS, NUMBERS, int64,
         array(float32, 2), array(int64), array(float64, 2), array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, parameters, participants, seeds, robots, defenders, stand, game, rules, steps, states, progress, fitness, metrics
):  # fmt: skip
    """All trials of a batch, see ``CompiledSimulator.play``."""
    observation, actions = np.empty(INPUTS, np.float32), np.empty((robots.shape[0], OUTPUTS), np.float32)
    for trial in range(seeds.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        controller = parameters[participants[trial, 0]]
        states[:] = 0
        start(seeds[trial], robots, defenders, stand, game, rules)
        while game[STEP_NUMBER] < steps:
            for robot in range(robots.shape[0]):
                observe(robot, robots, defenders, stand, game, rules, observation)
                step(controller, states[robot], observation, actions[robot])
            move_robots(actions, robots, stand, game, rules)
            move_defenders(robots, defenders, stand, game, rules)
        judge(stand, game, rules, fitness[trial], metrics[trial])
