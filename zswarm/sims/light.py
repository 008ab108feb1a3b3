"""A robot seeks a light, exactly FREVO's ``Light`` (github.com/smartgrids-aau/Frevo, version 1.5) with its default fitness.

Every constant and every order of operations is FREVO's; sine, cosine and arc tangent are ours, which differ from its in the last
bits at times. FREVO's two other ways to compute fitness, which count the cells that the robot crossed, are not offered.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import draw_java, skip_java, start_java
from zswarm.jit import STEP, Step, array, float32, float64, inline, int64, kernel, uint64, void
from zswarm.portable import PI, atan2, cos, exp, remainder, sin
from zswarm.sims.simulator import Batch, Body, CompiledSimulator, Frame, Outcome, Place, Ray, Turn

INPUTS, OUTPUTS = 2, 2
SIDE, DIAMETER, WHEEL = 200.0, 10.0, 5.0  # of the room, the robot, its wheels
FASTEST = 12.0  # rad/s, of a wheel
STEP_S = 0.1
SIGHT, FIELD_OF_VIEW = 70.0, 45.0  # of a sensor: reach, and degrees
NEAREST_LIGHT, SPREAD = 80.0, 25  # a light's coordinates are those of a circle this large, each with up to 24 added to its radius
TOUCH = DIAMETER / 2.0 + 1.0
RADIANS, DEGREES = PI / 180.0, 180.0 / PI
E = 2.718281828459045

# ``world``: float64.
X, Y, HEADING, LIGHT_X, LIGHT_Y = range(5)  # HEADING: degrees, 0 up, clockwise
# ``game``: int64. DECISIONS so far; FOUND: the light was touched.
DECISIONS, FOUND = range(2)


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    steps: Annotated[int, Meta(ge=1, le=1_000_000, description="steps of a trial, of .1 s")] = 300
    seed: Annotated[int, Meta(ge=0, lt=2**48, description="of the first light; the trials have `seed`, `seed` + 1, ...")] = 1234
    heading_seed: Annotated[
        int, Meta(ge=0, lt=2**48, description="of the generator that draws the robot's first heading in each trial")
    ] = 1


class Light(CompiledSimulator):
    """A robot on two wheels finds a light, which its two sensors see up to 70 away only, and touches it.

    The room is 200 wide, x to the right and y downwards from its middle; headings are degrees, 0 up, clockwise. The robot is a
    disc of 10 with wheels of 5, which turn at -12 to 12 rad/s. A light's angle and distance are those from a sensor, on the left
    or right edge of the robot, both looking ahead.

    Observation: (2,) float32, left and right: 1 - distance / 70 for a light less than 22.5 degrees off the heading and up to 70
        away; else 1, as if it were touched: FREVO reads no light in view as distance 0.
    Action: (2,) float32 for the left and right wheel: 0 full speed back, .5 stop, 1 full speed ahead; not cut.
    Turns: the robot.
    A step of t = .1 s, for wheels at l and r: heading += degrees((l - r) t / 2); then both coordinates change by 1.25 (l + r) t
        in that direction, unless the robot would be outside the room: then it stays.
    Start: the robot in the middle. The light from Java's Random(trial's seed): angle = nextInt(360) degrees, then
        x = (80 + nextInt(25)) cos, y = (80 + nextInt(25)) sin; a few are so far behind a wall that nobody touches them. The
        heading is nextInt(360) of the word of Random(``heading_seed``) whose index is the trial's seed - ``seed``.
    End: after ``steps`` + 1 steps (the first does not count), or when the middles of robot and light are up to 6 apart.
    Fitness: (.3 if the light was touched) + .4 e^(left / steps - 1) + .3 e^(- d / 70), the last part 0 for d above 70; left are
        the steps not needed, d is the distance at the end. .147 for whoever does nothing, always below 1.
    Metrics: ``found``: 1 or 0; ``steps`` before that in which it was, or ``steps``; ``distance`` to the light, ``x`` and ``y`` of
        the robot at the end.
    Trial seeds: ``seed``, ``seed`` + 1, ... of the settings, as FREVO.
    """

    settings_type = Settings
    metrics = ("found", "steps", "distance", "x", "y")
    inputs, outputs = INPUTS, OUTPUTS
    sensors, actuators = ("light_left", "light_right"), ("left", "right")
    owners = (0,)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._seeds = np.array([settings.seed, settings.heading_seed], np.uint64)

    def fixed_seeds(self, trials: int) -> Sequence[int]:
        """Seeds of lights one after another from the settings' ``seed``."""
        return range(self.settings.seed, self.settings.seed + trials)

    def reset(self, seed: int) -> Turn:
        """Put up the light of a seed."""
        self._world, self._game = np.empty(5), np.empty(2, np.int64)
        start(np.uint64(seed), self._seeds, self._world, self._game)
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive the robot."""
        act(actions[0], self._world, self._game)
        return self._turn() if goes_on(self._game, self.settings.steps) else None

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness, metrics = np.zeros(1), np.zeros(len(self.metrics))
        judge(self._world, self._game, self.settings.steps, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """The room, with a rim in which lights can be, too."""
        rim = 10.0
        middle = SIDE / 2 + rim
        x, y, heading, light_x, light_y = self._world.tolist()
        return Frame(
            SIDE + 2 * rim,
            SIDE + 2 * rim,
            [
                Place("wall", rim - 1, rim - 1, SIDE + 2, 1.0),
                Place("wall", rim - 1, rim + SIDE, SIDE + 2, 1.0),
                Place("wall", rim - 1, rim, 1.0, SIDE),
                Place("wall", rim + SIDE, rim, 1.0, SIDE),
                Place("light", middle + light_x - 2.5, middle + light_y - 2.5, 5.0, 5.0),
            ],
            [
                Body(
                    "robot at the light" if self._game[FOUND] else "robot",
                    *(middle + x, middle + y, DIAMETER / 2),
                    (heading - 90.0) * RADIANS,
                )
            ],
            rays=[
                Ray(sensor, 0.0, SIGHT, 0.0, FIELD_OF_VIEW * RADIANS, aside)
                for sensor, aside in enumerate((-DIAMETER / 2, DIAMETER / 2))
            ],
        )

    def play(self, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play``."""
        state = np.empty(batch.state_size, np.float32)
        play_trials(
            step, batch.parameters, batch.participants, batch.seeds, state, self._seeds, self.settings.steps, batch.progress,
            batch.fitness, batch.metrics,
        )  # fmt: skip

    def _turn(self) -> Turn:
        observation = np.empty((1, INPUTS), np.float32)
        observe(self._world, observation[0])
        return Turn((0,), observation)


@inline
def start(seed, seeds, world, game):  # type: ignore[no-untyped-def]  # compiled
    """Put up the light of a seed, and the robot; ``seeds`` are the settings'."""
    state = np.empty(1, np.uint64)
    start_java(state, seeds[1])
    skip_java(state, seed - seeds[0])
    world[X], world[Y], world[HEADING] = 0.0, 0.0, np.float64(draw_java(state, 360))
    start_java(state, seed)
    angle = np.float64(draw_java(state, 360)) * RADIANS
    world[LIGHT_X] = (NEAREST_LIGHT + np.float64(draw_java(state, SPREAD))) * cos(angle)
    world[LIGHT_Y] = (NEAREST_LIGHT + np.float64(draw_java(state, SPREAD))) * sin(angle)
    game[:] = 0


@inline
def clockwise(angle):  # type: ignore[no-untyped-def]  # compiled
    """An angle in degrees, from 0 to 360."""
    rest = remainder(angle, 360.0)
    return rest if angle >= 0.0 else 360.0 + rest


@inline
def sense(world, heading, aside):  # type: ignore[no-untyped-def]  # compiled
    """How far the light is from the sensor that is so many degrees aside of the heading, or 0 if it is not in view."""
    towards = (heading + aside) * RADIANS
    dx = world[LIGHT_X] - (world[X] + sin(towards) * (DIAMETER / 2.0))
    dy = world[LIGHT_Y] - (world[Y] - cos(towards) * (DIAMETER / 2.0))
    distance = np.sqrt(dx * dx + dy * dy)
    angle = clockwise(atan2(dx, -dy) * DEGREES)
    off = remainder(heading, 360.0) - remainder(angle, 360.0)
    if off > 180.0:
        off -= 360.0
    if off < -180.0:
        off += 360.0
    return distance if abs(off) < FIELD_OF_VIEW / 2.0 and distance <= SIGHT else 0.0


@inline
def observe(world, observation):  # type: ignore[no-untyped-def]  # compiled
    """What the robot observes; no light in view reads 1, see the data sheet."""
    heading = clockwise(world[HEADING])
    observation[0] = np.float32(1.0 - sense(world, heading, -90.0) / SIGHT)
    observation[1] = np.float32(1.0 - sense(world, heading, 90.0) / SIGHT)


@inline
def away(world):  # type: ignore[no-untyped-def]  # compiled
    """The distance from the robot to the light."""
    dx, dy = world[LIGHT_X] - world[X], world[LIGHT_Y] - world[Y]
    return np.sqrt(dx * dx + dy * dy)


@inline
def act(action, world, game):  # type: ignore[no-untyped-def]  # compiled
    """One step."""
    left = np.float64(action[0]) * 2.0 * FASTEST - FASTEST
    right = np.float64(action[1]) * 2.0 * FASTEST - FASTEST
    turning = WHEEL / 2.0 / DIAMETER * (left - right) * 2.0
    world[HEADING] = world[HEADING] + turning * STEP_S * DEGREES
    towards, speed = world[HEADING] * RADIANS, WHEEL / 4.0 * (left + right)
    x, y = world[X] + speed * sin(towards) * STEP_S, world[Y] - speed * cos(towards) * STEP_S
    most = SIDE / 2.0 - DIAMETER / 2.0
    if not (abs(x) > most or abs(y) > most):
        world[X], world[Y] = x, y
    game[DECISIONS] += 1
    if away(world) <= TOUCH:
        game[FOUND] = 1


@inline
def goes_on(game, steps):  # type: ignore[no-untyped-def]  # compiled
    """Whether another step follows; the first one does not count and ends nothing."""
    return game[DECISIONS] <= steps and (game[FOUND] == 0 or game[DECISIONS] < 2)


@inline
def judge(world, game, steps, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    needed = game[DECISIONS] - 2 if game[FOUND] else steps  # FREVO counts from 0
    distance = away(world)
    near = exp((SIGHT - distance) / SIGHT) / E if not distance > SIGHT else 0.0
    fast = exp((steps - needed) / np.float64(steps)) / E
    fitness[0] = (0.3 if game[FOUND] else 0.0) + 0.4 * fast + 0.3 * near
    metrics[0], metrics[1], metrics[2], metrics[3], metrics[4] = game[FOUND], needed, distance, world[X], world[Y]


@kernel(
    void(STEP, array(float32, 2), array(int64, 2), array(uint64), array(float32), array(uint64), int64, array(int64),
         array(float64, 2), array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, parameters, participants, trial_seeds, state, seeds, steps, progress, fitness, metrics
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
        start(trial_seeds[trial], seeds, world, game)
        while goes_on(game, steps):
            observe(world, observation)
            step(controller, state, observation, action)
            act(action, world, game)
        judge(world, game, steps, fitness[trial], metrics[trial])
