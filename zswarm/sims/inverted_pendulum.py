"""Inverted pendulum on a cart, exactly FREVO's ``InvertedPendulum`` (github.com/smartgrids-aau/Frevo, version 1.5).

Every constant and every order of operations is FREVO's; sine and cosine are ours, which differ from its in the last bit at times.
Its model of cart and pendulum is not that of textbooks.
"""

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.jit import STEP, Step, array, float32, float64, inline, int64, kernel, void
from zswarm.portable import PI, cos, remainder, sin
from zswarm.sims.simulator import Batch, Body, CompiledSimulator, Frame, Line, Outcome, Place, Turn

GRAVITY, CART_KG, MASS_KG, ROD_M = 9.81, 0.1, 0.01, 1.0
STRONGEST = 5.0  # N, on the cart
TOP = 0.9781476007338057  # sine of 78 degrees: the mass is within 12 degrees of the top above this
NINETY = np.float32(90)

# ``state``: float64.
PHI, ROD_SPEED, CART_SPEED, POSITION = range(4)  # rad, from the right counter-clockwise; m/s; m/s; m
STATES = 4
# ``sums``: float64, over the steps so far.
ANGLES, SQUARES, WAY, SQUARE_WAYS, DISTANCES, LEFTMOST, RIGHTMOST, UPRIGHT = range(8)
SUMS = 8
INPUT_MODELS = ("angle", "angle-vpendulum", "angle-vpendulum-vslide", "angle-vpendulum-vslide-position")
FITNESS_MODELS = (
    *("angle-pow-2", "angle-pow-2-plus-used-way", "angle-plus-dist-origin", "angle-plus-dist-origin-pow-2"),
    "angle-plus-abs-dist-origin",
)
POW_2, USED_WAY, DIST, DIST_POW_2, ABS_DIST = range(5)


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    steps: Annotated[int, Meta(ge=1, le=10_000_000, description="steps of a trial")] = 10_000
    timestep_ms: Annotated[float, Meta(gt=0, le=1e6, description="time of a step in ms, rounded to float32 as FREVO does")] = 1.0
    input_model: Annotated[
        Literal["angle", "angle-vpendulum", "angle-vpendulum-vslide", "angle-vpendulum-vslide-position"],
        Meta(description="what the controller senses: the angle, then speed of the mass, speed and position of the cart"),
    ] = "angle-vpendulum-vslide"
    fitness_model: Annotated[
        Literal[
            "angle-pow-2",
            "angle-pow-2-plus-used-way",
            "angle-plus-dist-origin",
            "angle-plus-dist-origin-pow-2",
            "angle-plus-abs-dist-origin",
        ],
        Meta(description="how fitness is made of angles and positions; the formulas are in [simulators.md](simulators.md)"),
    ] = "angle-pow-2-plus-used-way"


class InvertedPendulum(CompiledSimulator):
    """A cart on an endless track swings up the pendulum that hangs on it, and keeps it there.

    The angle is phi in degrees + 360, less full turns, less 90, phi from the right counter-clockwise: 0 at the top, 180 at the
    bottom, 90 on the left and -90 on the right, just below which it is 270. FREVO's remainder has the sign of what is divided:
    once phi is below -360 degrees, angles are 360 less.

    Observation: (1,) to (4,) float32, as ``input_model`` says: the angle in degrees (phi is rounded to float32 first), the mass's
        speed across the rod in m/s (counter-clockwise), the cart's speed in m/s and position in m. None is scaled.
    Action: (1,) float32 o: a force of 5 (2 o - 1) N on the cart.
    Turns: the cart. A step of t = ``timestep_ms``, with g = 9.81, cart .1 kg, mass .01 kg on a rod of 1 m:
        a = (force - .01 g sin phi cos phi + .01 v^2 cos phi) / (.1 + .01 |cos phi|); the cart's speed += a t;
        v += a sin phi t - g cos phi t; phi += v t; position += the cart's speed t.
    Start: all at rest at position 0, the mass at the bottom; the same for every seed.
    End: after ``steps`` steps.
    Fitness: with A = angle / 180 and p the position after each of the N steps, by ``fitness_model``:
        angle-pow-2: 1 - (sum of A^2) / N; at most 1, 0 for a pendulum that hangs all the time;
        angle-pow-2-plus-used-way: 2 (1 - (sum of A^2) / N) / max(2, width of the way that the cart used); at most 1;
        angle-plus-dist-origin: - sum of |A| - |sum of p|; angle-plus-dist-origin-pow-2: - sum of |A| - sum of p^2;
        angle-plus-abs-dist-origin: - sum of |A| - (sum of |p|) / 1000; these three at most 0.
    Metrics: ``upright``: share of the steps that began within 12 degrees of the top; ``way``: width of what the cart used, m;
        ``position`` of the cart at the end, m; ``angle`` at the end, degrees.
    """

    settings_type = Settings
    metrics = ("upright", "way", "position", "angle")
    actuators = ("force",)
    outputs = 1
    owners = (0,)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self.inputs = 1 + INPUT_MODELS.index(settings.input_model)
        self.sensors = ("angle", "mass_speed", "cart_speed", "cart_position")[: self.inputs]
        self._model = FITNESS_MODELS.index(settings.fitness_model)
        self._step_s = float(np.float32(settings.timestep_ms)) / 1000.0

    def reset(self, seed: int) -> Turn:  # noqa: ARG002  nothing is drawn
        """Let the pendulum hang."""
        self._state, self._sums, self._steps = np.empty(STATES), np.empty(SUMS), 0
        start(self._state, self._sums)
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Push the cart."""
        act(actions[0], self._state, self._sums, self._step_s)
        self._steps += 1
        return self._turn() if self._steps < self.settings.steps else None

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness, metrics = np.zeros(1), np.zeros(len(self.metrics))
        judge(self._state, self._sums, self.settings.steps, self._model, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """Ten metres of the track around the start; a cart that leaves the inner eight is shown where it left them."""
        width, height, inner = 10.0, 2.6, 4.0
        phi, position = float(self._state[PHI]), float(self._state[POSITION])
        is_seen = abs(position) <= inner
        x, y = width / 2 + min(max(position, -inner), inner), height / 2
        along, up = cos(phi), sin(phi)
        return Frame(
            width,
            height,
            [Place("track", 0.0, y - 0.01, width, 0.02), Place("start", width / 2 - 0.02, y + 0.12, 0.04, 0.12)],
            [Body("cart" if is_seen else "cart, out of view", x, y, 0.12, shape="square"), Body("mass", x + along, y - up, 0.08)],
            [Line("rod", x, y, x + along, y - up)],
        )

    def play(self, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play``."""
        state = np.empty(batch.state_size, np.float32)
        play_trials(
            step, batch.parameters, batch.participants, state, self.inputs, self.settings.steps, self._step_s, self._model,
            batch.progress, batch.fitness, batch.metrics,
        )  # fmt: skip

    def _turn(self) -> Turn:
        observation = np.empty((1, self.inputs), np.float32)
        observe(self._state, observation[0])
        return Turn((0,), observation)


@inline
def start(state, sums):  # type: ignore[no-untyped-def]  # compiled
    """All at rest, the mass at the bottom."""
    state[:] = 0.0
    sums[:] = 0.0
    state[PHI] = PI * 3.0 / 2.0


@inline
def turns_of(phi):  # type: ignore[no-untyped-def]  # compiled
    """phi in degrees, + 360."""
    return phi * 180.0 / PI + 360.0


@inline
def observe(state, observation):  # type: ignore[no-untyped-def]  # compiled
    """What the controller senses: as much of it as there is place for."""
    degrees = np.float64(np.float32(turns_of(state[PHI])))
    observation[0] = np.float32(remainder(degrees, 360.0)) - NINETY
    for number in range(1, observation.shape[0]):
        observation[number] = state[number]


@inline
def act(action, state, sums, step_s):  # type: ignore[no-untyped-def]  # compiled
    """One step, and what it adds to the sums."""
    sine, cosine = sin(state[PHI]), cos(state[PHI])
    sums[UPRIGHT] += int(sine > TOP)
    force = (np.float64(action[0]) * 2.0 - 1.0) * STRONGEST
    weight = MASS_KG * GRAVITY * sine * cosine
    centrifugal = MASS_KG * state[ROD_SPEED] * state[ROD_SPEED] / ROD_M
    a = (force - weight + centrifugal * cosine) / (CART_KG + MASS_KG * abs(cosine))
    state[CART_SPEED] = state[CART_SPEED] + a * step_s
    state[ROD_SPEED] = state[ROD_SPEED] + a * sine * step_s - GRAVITY * cosine * step_s
    state[PHI] = state[PHI] + state[ROD_SPEED] / ROD_M * step_s
    state[POSITION] = state[POSITION] + state[CART_SPEED] * step_s
    position = state[POSITION]
    off = abs(remainder(turns_of(state[PHI]), 360.0) - 90.0) / 180.0
    sums[ANGLES] += off
    sums[SQUARES] += off * off
    sums[WAY] += position
    sums[SQUARE_WAYS] += position * position
    sums[DISTANCES] += abs(position)
    if position > sums[RIGHTMOST]:
        sums[RIGHTMOST] = position
    if position < sums[LEFTMOST]:
        sums[LEFTMOST] = position


@inline
def judge(state, sums, steps, model, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    upright, way = 1.0 - sums[SQUARES] / steps, sums[RIGHTMOST] - sums[LEFTMOST]
    if model == POW_2:
        fitness[0] = upright
    elif model == USED_WAY:
        fitness[0] = upright * 2.0 / max(way, 2.0)
    elif model == DIST:
        fitness[0] = -sums[ANGLES] - abs(sums[WAY])
    elif model == DIST_POW_2:
        fitness[0] = -sums[ANGLES] - sums[SQUARE_WAYS]
    else:
        fitness[0] = -sums[ANGLES] - sums[DISTANCES] / 1000.0
    metrics[0], metrics[1], metrics[2] = sums[UPRIGHT] / steps, way, state[POSITION]
    metrics[3] = remainder(turns_of(state[PHI]), 360.0) - 90.0


@kernel(
    void(STEP, array(float32, 2), array(int64, 2), array(float32), int64, int64, float64, int64, array(int64), array(float64, 2),
         array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, parameters, participants, controller_state, inputs, steps, step_s, model, progress, fitness, metrics
):
    """All trials of a batch, see ``CompiledSimulator.play``."""
    observation, action = np.empty(inputs, np.float32), np.empty(1, np.float32)
    state, sums = np.empty(STATES), np.empty(SUMS)
    for trial in range(participants.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        controller = parameters[participants[trial, 0]]
        controller_state[:] = 0
        start(state, sums)
        for _ in range(steps):
            observe(state, observation)
            step(controller, controller_state, observation, action)
            act(action, state, sums, step_s)
        judge(state, sums, steps, model, fitness[trial], metrics[trial])
