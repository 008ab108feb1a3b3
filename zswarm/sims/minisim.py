"""Minisim: robots play capture the flag against scripted defenders, on a grid.

The simulator of this name in the paper was never published. This game is a design of our own on the same subject: quick
to compute, and a matter of teamwork, because a defender that chases one robot leaves the flag to another.
"""

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import draw_integer
from zswarm.errors import ConfigError
from zswarm.jit import STEP, Step, array, float32, float64, inline, int64, kernel, uint64, void
from zswarm.lanes import LANES
from zswarm.sims.minisim_board import (
    DEFENDER_SIGHT,
    HEIGHT,
    NOBODY,
    ONE,
    OUTPUTS,
    REACH,
    REST,
    ROBOT_SIGHT,
    STEPS,
    WIDTH,
    ZERO,
    Game,
    arrow,
    bearing,
    distance,
    move,
)
from zswarm.sims.minisim_duel import DUEL
from zswarm.sims.simulator import Batch, Body, CompiledSimulator, Frame, Label, Outcome, Place, Turn

INPUTS = 9

# All state is integers: ``robots`` and ``defenders`` (a row each), ``stand`` (x, y) and ``game``.
X, Y, START_Y, CHASED = range(4)  # CHASED: the step in which a defender last chose this robot
CARRIER, STEP_NUMBER, CAPTURES, STEALS, TAGGED, CLOSEST, NEAREST_HOME = range(7)

Length = Annotated[int, Meta(ge=2, le=1_000)]
Sight = Annotated[int, Meta(ge=1, le=1_000)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``; lengths are in cells, distances in king moves (a diagonal step counts 1)."""

    steps: Annotated[int, Meta(ge=1, le=1_000_000, description="steps of a trial; at least 2 (`width` - `width` div 2)")] = 100
    width: Annotated[Length, Meta(description="cells")] = 20
    height: Annotated[Length, Meta(description="cells")] = 20
    robots: Annotated[int, Meta(ge=1, le=1_000, description="robots")] = 8
    defenders: Annotated[int, Meta(ge=0, le=1_000, description="scripted defenders")] = 2
    robot_sight: Annotated[
        Sight, Meta(description="king moves from which on a robot does not sense defenders and other robots")
    ] = 8
    defender_sight: Annotated[Sight, Meta(description="king moves up to which a defender chases a robot")] = 6
    reach: Annotated[
        int,
        Meta(ge=0, le=1_000, description="king moves up to which a defender tags a robot; not above `defender_sight`"),
    ] = 1
    rest: Annotated[
        int,
        Meta(
            ge=0,
            le=1_000_000,
            description="defenders stand still in every `rest`-th step; 0: in none; not 1 where there are defenders",
        ),
    ] = 4
    teams: Annotated[
        Literal[1, 2],
        Meta(description="1: robots against scripted defenders; 2: two teams of `robots`, each a participant; then no defenders"),
    ] = 1


class Minisim(CompiledSimulator):
    """Robots fetch a flag again and again and take it home; defenders that come near send them back.

    Cells have x and y from 0. The distance of an offset is |dx, dy| = max(|dx|, |dy|), king moves. Any number of robots
    and defenders may share a cell. Home is the column x = 0; ``size`` is the greater of width and height.

    Observation: (9,) float32, each operation rounded to float32. Where dx, dy is the offset to
        the goal, which is the flag's stand, or for the carrier the cell at x = 0 in its row:
        0-1: dx / max(1, |dx, dy|), dy / max(1, |dx, dy|). 2: 1 - |dx, dy| / size.
        the nearest defender (the first of equals), with d = |dx, dy| and s = ``robot_sight``:
        3-4: (dx / d) * ((s - d) / s), (dy / d) * ((s - d) / s); zeros if d is 0 or d >= s.
        the nearest other robot: 5-6, as for the defender.
        7: 1 for the carrier, else 0. 8: 1 while another robot carries the flag, else 0.
    Action: (2,) float32 for x and y: below .25 a cell back, above .75 a cell forth, else none; walls hold robots in.
    Turns: all robots at once, seeing the state before the step. A step (they count from 1):
        1. Robots move. The first robot on the stand takes the flag if nobody has it (a steal). A carrier at home has
        captured it; the flag is back on its stand.
        2. Unless the step is a multiple of ``rest`` (0: always), defender after defender moves one cell (dx and dy cut
        to -1..1) towards the nearest robot (the first of equals) within ``defender_sight`` that is not at home and that
        no earlier defender chose in this step, else towards the stand.
        3. Every robot not at home within ``reach`` of a defender is tagged: it is put on its start cell, and the flag,
        if it had it, on the stand.
    Start: from ``Stream(seed)`` of zswarm.draws the stand, x = width - 1 - integer(width // 2) and y = integer(height),
        then per robot y = integer(height), x = 0. Defenders start on the stand.
    End: after ``steps`` steps.
    Fitness: captures + (there + back) / 2, where the second part, in 0..1, is what was done since the last capture:
        there = 1 - c / size, c the least distance of a robot to the stand after moves of robots (``size`` before any);
        back = 1 - h / (x of the stand), h the least x of a carrier after such moves (x of the stand before any).
    Metrics: ``captures``; ``steals``; ``tagged``, counted per robot and time.

    With ``teams`` = 2 two teams of ``robots`` play each other, each driven by a participant; there are no defenders. Both see
    the field from their own side, as above: for each home is the column x = 0, the other's flag stands in the far half, and
    what one team sees at (x, y) the other sees at (width - 1 - x, height - 1 - y). So the field is the same for both, nothing
    in the rules depends on who is first, and a team that plays itself always ties. A robot with 2 x > width - 1 is in the
    other's half, and intrudes; where 2 x = width - 1 it is in nobody's.

    Observation: (14,) float32; 0-8 as above, with the other's robots for defenders and those of the own team for others.
        9-11: as 0-2 for the own flag, which is on its stand or where the robot is that carries it.
        12: 1 while one of the others carries the own flag, else 0. 13: 1 for a robot that intrudes, else 0.
    Turns: all robots of both teams at once. A step: 1. as above, for each team. 2. Whoever intrudes with one of the others
        within ``reach`` that does not is tagged, and so is that one; all of them are found before any is sent to its start
        cell. A flag that one of them had is on its stand again.
    Start: stand and robots are drawn as above, once: each team starts so in its own view.
    Fitness: of each team as above, so that a team does better by more captures of its own or by fewer of the other's.
    Metrics: ``captures`` and ``steals`` of both teams together; ``tagged``, intruders only.
    """

    settings_type = Settings
    metrics = ("captures", "steals", "tagged")
    outputs = OUTPUTS
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        shortest = 2 * (settings.width - settings.width // 2)
        if settings.steps < shortest:
            raise ConfigError(
                f"minisim: no flag can be captured in {settings.steps} steps; width {settings.width} takes {shortest}"
            )
        if settings.reach > settings.defender_sight:
            raise ConfigError(
                f"minisim: reach {settings.reach} must not exceed defender_sight {settings.defender_sight}: "
                "a defender cannot tag what it does not see"
            )
        if settings.rest == 1 and settings.defenders:
            raise ConfigError("minisim: rest 1 keeps the defenders on the flag for ever; give 0 (no rest) or 2 and more")
        if settings.teams == 2 and settings.defenders:
            raise ConfigError("minisim: two teams guard their flags themselves; give defenders = 0 with teams = 2")
        self._game = DUEL if settings.teams == 2 else RAID
        self.inputs, self.participants = self._game.inputs, settings.teams
        self.owners = tuple(team for team in range(settings.teams) for _ in range(settings.robots))
        self._rules = np.array(msgspec.structs.astuple(settings), np.int64)

    def reset(self, seed: int) -> Turn:
        """Lay out the start of a seed; all robots act next."""
        self._state = self._tables()
        self._game.start(np.uint64(seed), *self._state, self._rules)
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Move the robots, then the defenders; all robots act next."""
        self._game.act(actions, *self._state, self._rules)
        return self._turn() if self._state[-1].flat[STEP_NUMBER] < self.settings.steps else None

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness, metrics = np.zeros(self.participants), np.zeros(3)
        self._game.judge(*self._state[-2:], self._rules, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """The field in cells; a robot that has the flag is of another kind. Of two teams the first one's view."""
        if self.settings.teams == 2:
            return self._frame_of_two()
        robots, defenders, stand, game = (table.tolist() for table in self._state)
        bodies = [
            Body("robot with the flag" if game[CARRIER] == number else "robot", robot[X] + 0.5, robot[Y] + 0.5, 0.4)
            for number, robot in enumerate(robots)
        ]
        bodies += [Body("defender", defender[X] + 0.5, defender[Y] + 0.5, 0.4, shape="triangle") for defender in defenders]
        places = [Place("home", 0, 0, 1, self.settings.height), Place("flag's stand", stand[X], stand[Y], 1, 1)]
        return Frame(
            self.settings.width, self.settings.height, places, bodies, labels=[self._score(f"flags home: {game[CAPTURES]}")]
        )

    def _frame_of_two(self) -> Frame:
        robots, (stand_x, stand_y), games = (table.tolist() for table in self._state)
        width, height = self.settings.width, self.settings.height
        bodies = []
        for number, robot in enumerate(robots):
            team = self.owners[number]
            x, y = (robot[X], robot[Y]) if team == 0 else (width - 1 - robot[X], height - 1 - robot[Y])
            name = ("robot", "opponent")[team]
            kind = f"{name} with the flag" if games[team][CARRIER] == number else name
            bodies.append(Body(kind, x + 0.5, y + 0.5, 0.4, shape=("disc", "triangle")[team]))
        places = [
            Place("home", 0, 0, 1, height),
            Place("opponents' home", width - 1, 0, 1, height),
            Place("flag's stand", width - 1 - stand_x, height - 1 - stand_y, 1, 1),
            Place("opponents' flag's stand", stand_x, stand_y, 1, 1),
        ]
        score = self._score(f"flags home: {games[0][CAPTURES]} robots, {games[1][CAPTURES]} opponents")
        return Frame(width, height, places, bodies, labels=[score])

    def _score(self, text: str) -> Label:
        return Label(text, self.settings.width / 2, 0.05 * self.settings.height, 0.04 * self.settings.height)

    def play(self, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play``."""
        self._play(step, 1, batch)

    def play_lanes(self, step_lanes: Step, step: Step, batch: Batch) -> None:  # noqa: ARG002  eight at once take as long as two
        """See ``CompiledSimulator.play_lanes``: eight robots of a trial decide at once."""
        self._play(step_lanes, LANES, batch)

    def _play(self, step: Step, together: int, batch: Batch) -> None:
        """So many robots decide together."""
        groups = -(-self.settings.robots // together)
        states = np.zeros((self.participants * groups, together * batch.state_size), np.float32)
        self._game.play_trials(
            step, together, batch.parameters, batch.participants, batch.seeds, states, *self._tables(), self._rules,
            batch.progress, batch.fitness, batch.metrics
        )  # fmt: skip

    def _tables(self) -> tuple[np.ndarray, ...]:
        return self._game.tables(self.settings.robots, self.settings.defenders)

    def _turn(self) -> Turn:
        observations = np.empty((len(self.owners), self.inputs), np.float32)
        for robot in range(len(self.owners)):
            self._game.observe(robot, *self._state, self._rules, observations[robot], 1)
        return Turn(range(len(self.owners)), observations)


NUMBERS = array(int64)
TABLE = array(int64, 2)
GRIDS = array(float32, 2)


def tables(robots: int, defenders: int) -> tuple[np.ndarray, ...]:
    """Robots, defenders, stand and game."""
    shapes = (robots, 4), (defenders, 2), (2,), (7,)
    return tuple(np.zeros(shape, np.int64) for shape in shapes)


@inline
def begin_attempt(stand, game, rules):  # type: ignore[no-untyped-def]  # compiled
    """The flag is on its stand, and nothing was done yet towards the next capture."""
    game[CARRIER] = NOBODY
    game[CLOSEST] = max(rules[WIDTH], rules[HEIGHT])
    game[NEAREST_HOME] = stand[X]


@inline
def start(seed, robots, defenders, stand, game, rules):  # type: ignore[no-untyped-def]  # compiled
    """Lay out a trial."""
    state = np.empty(1, np.uint64)
    state[0] = seed
    stand[X] = rules[WIDTH] - 1 - draw_integer(state, rules[WIDTH] // 2)
    stand[Y] = draw_integer(state, rules[HEIGHT])
    for robot in range(robots.shape[0]):
        robots[robot, X] = 0
        robots[robot, Y] = robots[robot, START_Y] = draw_integer(state, rules[HEIGHT])
        robots[robot, CHASED] = 0
    for defender in range(defenders.shape[0]):
        defenders[defender, X], defenders[defender, Y] = stand[X], stand[Y]
    game[:] = 0
    begin_attempt(stand, game, rules)


@inline
def sense(x, y, others, itself, sight, observation, at, stride):  # type: ignore[no-untyped-def]  # compiled
    """Write where the nearest of the others is, if nearer than ``sight``; the nearer, the longer the arrow."""
    least, dx, dy = sight, 0, 0
    for other in range(others.shape[0]):
        to_x, to_y = others[other, X] - x, others[other, Y] - y
        if distance(to_x, to_y) < least and other != itself:
            least, dx, dy = distance(to_x, to_y), to_x, to_y
    arrow(dx, dy, least, sight, observation, at, stride)


@inline
def observe(robot, robots, defenders, stand, game, rules, observation, stride):  # type: ignore[no-untyped-def]  # compiled
    """What a robot observes, written so far apart."""
    x, y, carries, sight = robots[robot, X], robots[robot, Y], game[CARRIER] == robot, rules[ROBOT_SIGHT]
    dx, dy = (-x, 0) if carries else (stand[X] - x, stand[Y] - y)
    bearing(dx, dy, rules, observation, 0, stride)
    sense(x, y, defenders, NOBODY, sight, observation, 3, stride)
    sense(x, y, robots, robot, sight, observation, 5, stride)
    observation[7 * stride] = ONE if carries else ZERO
    observation[8 * stride] = ONE if game[CARRIER] != NOBODY and not carries else ZERO


@inline
def act(actions, robots, defenders, stand, game, rules):  # type: ignore[no-untyped-def]  # compiled
    """One step of the game, given the actions of all robots."""
    game[STEP_NUMBER] += 1
    move(robots, actions, rules)
    score(robots, stand, game, rules)
    if rules[REST] == 0 or game[STEP_NUMBER] % rules[REST] != 0:
        move_defenders(robots, defenders, stand, game, rules)
    tag(robots, defenders, game, rules)


@inline
def score(robots, stand, game, rules):  # type: ignore[no-untyped-def]  # compiled
    """Let a robot take the flag, or bring it home."""
    for robot in range(robots.shape[0]):
        away = distance(stand[X] - robots[robot, X], stand[Y] - robots[robot, Y])
        game[CLOSEST] = min(game[CLOSEST], away)
        if away == 0 and game[CARRIER] == NOBODY:
            game[CARRIER] = robot
            game[STEALS] += 1
    if game[CARRIER] != NOBODY:
        game[NEAREST_HOME] = min(game[NEAREST_HOME], robots[game[CARRIER], X])
        if game[NEAREST_HOME] == 0:
            game[CAPTURES] += 1
            begin_attempt(stand, game, rules)


@inline
def move_defenders(robots, defenders, stand, game, rules):  # type: ignore[no-untyped-def]  # compiled
    """Each defender follows a robot of its own, or returns to the stand."""
    for defender in range(defenders.shape[0]):
        x, y = defenders[defender, X], defenders[defender, Y]
        least, prey, dx, dy = rules[DEFENDER_SIGHT] + 1, NOBODY, stand[X] - x, stand[Y] - y
        for robot in range(robots.shape[0]):
            to_x, to_y = robots[robot, X] - x, robots[robot, Y] - y
            free = robots[robot, X] > 0 and robots[robot, CHASED] != game[STEP_NUMBER]
            if free and distance(to_x, to_y) < least:
                least, prey, dx, dy = distance(to_x, to_y), robot, to_x, to_y
        if prey != NOBODY:
            robots[prey, CHASED] = game[STEP_NUMBER]
        defenders[defender, X] = x + min(max(dx, -1), 1)
        defenders[defender, Y] = y + min(max(dy, -1), 1)


@inline
def tag(robots, defenders, game, rules):  # type: ignore[no-untyped-def]  # compiled
    """Send home whom a defender reaches."""
    for robot in range(robots.shape[0]):
        for defender in range(defenders.shape[0]):
            dx, dy = defenders[defender, X] - robots[robot, X], defenders[defender, Y] - robots[robot, Y]
            if robots[robot, X] > 0 and distance(dx, dy) <= rules[REACH]:
                robots[robot, X], robots[robot, Y] = 0, robots[robot, START_Y]
                game[TAGGED] += 1
                if game[CARRIER] == robot:
                    game[CARRIER] = NOBODY


@inline
def judge(stand, game, rules, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    there = 1.0 - game[CLOSEST] / max(rules[WIDTH], rules[HEIGHT])
    back = 1.0 - game[NEAREST_HOME] / stand[X]
    fitness[0] = game[CAPTURES] + (there + back) / 2.0
    metrics[0], metrics[1], metrics[2] = game[CAPTURES], game[STEALS], game[TAGGED]


@inline(counts=False)
def play_steps(  # type: ignore[no-untyped-def]  # compiled
    step, together, controller, states, robots, defenders, stand, game, rules, observations, outputs, actions
):
    """Play a trial that was laid out; so many robots decide together, the last one again where there are fewer."""
    last = robots.shape[0] - 1
    for _ in range(rules[STEPS]):
        for group in range(states.shape[0]):
            for lane in range(together):
                observe(min(group * together + lane, last), robots, defenders, stand, game, rules, observations[lane:], together)
            step(controller, states[group], observations, outputs)
            for lane in range(min(together, robots.shape[0] - group * together)):
                actions[group * together + lane, X] = outputs[lane]
                actions[group * together + lane, Y] = outputs[together + lane]
        act(actions, robots, defenders, stand, game, rules)


@kernel(
    void(STEP, int64, GRIDS, array(int64, 2), array(uint64), GRIDS, TABLE, TABLE, NUMBERS, NUMBERS, NUMBERS, NUMBERS,
         array(float64, 2), array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, together, parameters, participants, seeds, states, robots, defenders, stand, game, rules, progress, fitness, metrics
):
    """All trials of a batch, see ``CompiledSimulator.play``; ``step`` decides for so many robots together."""
    observations, outputs = np.empty(INPUTS * together, np.float32), np.empty(OUTPUTS * together, np.float32)
    controller = np.empty(parameters.shape[1] * together, np.float32)
    actions = np.empty((robots.shape[0], OUTPUTS), np.float32)
    for trial in range(seeds.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        for number in range(parameters.shape[1]):
            controller[number * together : (number + 1) * together] = parameters[participants[trial, 0], number]
        states[:] = 0
        start(seeds[trial], robots, defenders, stand, game, rules)
        play_steps(step, together, controller, states, robots, defenders, stand, game, rules, observations, outputs, actions)
        judge(stand, game, rules, fitness[trial], metrics[trial])


RAID = Game(INPUTS, tables, start, observe, act, judge, play_trials)
