"""Inverted pendulum on a cart, exactly as FREVO's ``InvertedPendulum``.

FREVO is at github.com/smartgrids-aau/Frevo; this is its version 1.5.

Every constant and every order of operations is FREVO's; sine and cosine are ours and may differ in
the last bit. Its model of cart and pendulum is not that of textbooks; docs/simulators.md has the
equations.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import Annotated, Literal, get_args

import numpy as np

from zswarm.config.meta import PartSettings, about, above, within
from zswarm.kernels.jit import inline
from zswarm.kernels.portable import PI, cos, remainder, sin
from zswarm.sims.simulator import Body, Frame, Line, Rectangle
from zswarm.sims.trial import OneAgent, problem, world

GRAVITY, CART_KG, MASS_KG, ROD_M = 9.81, 0.1, 0.01, 1.0
STRONGEST = 5.0  # N, on the cart
TOP = 0.9781476007338057  # sine of 78 degrees: above it the mass is within 12 degrees of the top
NINETY = np.float32(90)

# ``state``: rad, from the right counter-clockwise; m/s; m/s; m. Then sums over the steps so far.
PHI, ROD_SPEED, CART_SPEED, POSITION, ANGLES, SQUARES, WAY, SQUARE_WAYS, DISTANCES = (
    range(9)
)
LEFTMOST, RIGHTMOST, UPRIGHT, STATES = range(9, 13)
STEPS, MODEL = range(2)  # ``rules``
STEP_S = 0  # ``constants``
DECISIONS = 0  # ``counts``

InputModel = Literal[
    "angle",
    "angle-vpendulum",
    "angle-vpendulum-vslide",
    "angle-vpendulum-vslide-position",
]
FitnessModel = Literal[
    "angle-pow-2",
    "angle-pow-2-plus-used-way",
    "angle-plus-dist-origin",
    "angle-plus-dist-origin-pow-2",
    "angle-plus-abs-dist-origin",
]
INPUT_MODELS, FITNESS_MODELS = get_args(InputModel), get_args(FitnessModel)
POW_2, USED_WAY, DIST, DIST_POW_2, ABS_DIST = range(5)


class InvertedPendulumSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    steps: Annotated[int, within(1, 10_000_000, "steps of a trial")] = 10_000
    timestep_ms: Annotated[
        float,
        above(0, 1e6, "duration of a step in ms, rounded to float32 as in FREVO"),
    ] = 1.0
    input_model: Annotated[
        InputModel,
        about(
            "inputs of the controller: angle, then speed of the mass, speed and position "
            "of the cart"
        ),
    ] = "angle-vpendulum-vslide"
    fitness_model: Annotated[
        FitnessModel,
        about(
            "formula of the fitness, from angles and positions: [simulators.md](simulators.md)"
        ),
    ] = "angle-pow-2-plus-used-way"


class InvertedPendulum(OneAgent):
    """A cart on an endless track swings up the pendulum that hangs on it, and keeps it there.

    The angle is phi in degrees + 360, less full turns, less 90, phi from the right
    counter-clockwise: 0 at the top, 180 at the bottom, 90 on the left and -90 on the right, just
    below which it is 270. FREVO's remainder has the sign of what is divided: once phi is below -360
    degrees, angles are 360 less.

    Observation: (1,) to (4,) float32, as ``input_model`` says: the angle in degrees (phi is rounded
        to float32 first), the mass's speed across the rod in m/s (counter-clockwise), the cart's
        speed in m/s and position in m. None is scaled.
    Action: (1,) float32 o: a force of 5 (2 o - 1) N on the cart.
    Turns: the cart. A step of t = ``timestep_ms``, with g = 9.81, cart .1 kg, mass .01 kg on a rod
    of 1 m:
        a = (force - .01 g sin phi cos phi + .01 v^2 cos phi) / (.1 + .01 |cos phi|); the cart's
        speed += a t; v += a sin phi t - g cos phi t; phi += v t; position += the cart's speed t.
    Start: all at rest at position 0, the mass at the bottom; the same for every seed.
    End: after ``steps`` steps.
    Fitness: with A = angle / 180 and p the position after each of the N steps, by
    ``fitness_model``:
        angle-pow-2: 1 - (sum of A^2) / N; at most 1, 0 for a pendulum that hangs all the time;
        angle-pow-2-plus-used-way: 2 (1 - (sum of A^2) / N) / max(2, width of the way that the cart
        used); at most 1;
        angle-plus-dist-origin: - sum of |A| - |sum of p|; angle-plus-dist-origin-pow-2: - sum of
        |A| - sum of p^2;
        angle-plus-abs-dist-origin: - sum of |A| - (sum of |p|) / 1000; these three at most 0.
    Metrics: ``upright``: share of the steps that began within 12 degrees of the top; ``way``: width
        of what the cart used, m; ``position`` of the cart at the end, m; ``angle`` at the end,
        degrees.
    """

    settings_type = InvertedPendulumSettings
    metrics = ("upright", "way", "position", "angle")
    actuators, outputs = ("force",), 1
    settings: InvertedPendulumSettings

    def __init__(self, settings: InvertedPendulumSettings) -> None:
        super().__init__(settings)
        self.inputs = 1 + INPUT_MODELS.index(settings.input_model)
        self.sensors = ("angle", "mass_speed", "cart_speed", "cart_position")[
            : self.inputs
        ]
        rules = [settings.steps, FITNESS_MODELS.index(settings.fitness_model)]
        step_s = float(np.float32(settings.timestep_ms)) / 1000.0
        self.world = world(rules=rules, constants=[step_s], state=STATES, counts=1)

    def frame(self) -> Frame:
        """Draw ten metres of track; a cart outside the inner eight stands at their end."""
        width = 10.0
        height = 2.6
        inner = 4.0
        phi = self.world.state[PHI]
        position = float(self.world.state[POSITION])
        x = width / 2 + min(max(position, -inner), inner)
        y = height / 2
        mass_x = x + float(cos(phi))
        mass_y = y - float(sin(phi))
        places = [
            Rectangle("track", 0.0, y - 0.01, width, 0.02),
            Rectangle("start", width / 2 - 0.02, y + 0.12, 0.04, 0.12),
        ]
        kind = "cart" if abs(position) <= inner else "cart, out of view"
        bodies = [
            Body(kind, x, y, 0.12, shape="square"),
            Body("mass", mass_x, mass_y, 0.08),
        ]
        return Frame(width, height, places, bodies, [Line("rod", x, y, mass_x, mass_y)])


@inline(counts=False)
def start(world, seed):  # noqa: ARG001  nothing is drawn
    """Put all at rest, with the mass at the bottom."""
    world.state[:] = 0.0
    world.state[PHI] = PI * 3.0 / 2.0
    world.counts[DECISIONS] = 0


@inline(counts=False)
def positive_degrees(phi):
    """Convert radians to degrees, plus a full turn."""
    return phi * 180.0 / PI + 360.0


@inline(counts=False)
def observe(world, observation):
    """Write as much of the state as the observation has room for."""
    degrees = np.float64(np.float32(positive_degrees(world.state[PHI])))
    observation[0] = np.float32(remainder(degrees, 360.0)) - NINETY
    for number in range(1, observation.shape[0]):
        observation[number] = world.state[number]


@inline(counts=False)
def act(world, action):
    """Push the cart for one step, and add to the sums."""
    state = world.state
    step_s = world.constants[STEP_S]
    sine = sin(state[PHI])
    cosine = cos(state[PHI])
    state[UPRIGHT] += int(sine > TOP)
    force = (np.float64(action[0]) * 2.0 - 1.0) * STRONGEST
    weight = MASS_KG * GRAVITY * sine * cosine
    centrifugal = MASS_KG * state[ROD_SPEED] * state[ROD_SPEED] / ROD_M
    a = (force - weight + centrifugal * cosine) / (CART_KG + MASS_KG * abs(cosine))
    state[CART_SPEED] += a * step_s
    state[ROD_SPEED] = state[ROD_SPEED] + a * sine * step_s - GRAVITY * cosine * step_s
    state[PHI] += state[ROD_SPEED] / ROD_M * step_s
    state[POSITION] += state[CART_SPEED] * step_s
    position = state[POSITION]
    off = abs(remainder(positive_degrees(state[PHI]), 360.0) - 90.0) / 180.0
    state[ANGLES] += off
    state[SQUARES] += off * off
    state[WAY] += position
    state[SQUARE_WAYS] += position * position
    state[DISTANCES] += abs(position)
    if position > state[RIGHTMOST]:
        state[RIGHTMOST] = position
    if position < state[LEFTMOST]:
        state[LEFTMOST] = position
    world.counts[DECISIONS] += 1


@inline(counts=False)
def is_over(world):
    """Return whether the trial ends."""
    return world.counts[DECISIONS] >= world.rules[STEPS]


@inline(counts=False)
def judge(world, fitness, metrics):
    """Write fitness and metrics of a trial that ended."""
    state = world.state
    steps = world.rules[STEPS]
    model = world.rules[MODEL]
    upright = 1.0 - state[SQUARES] / steps
    way = state[RIGHTMOST] - state[LEFTMOST]
    if model == POW_2:
        fitness[0] = upright
    elif model == USED_WAY:
        fitness[0] = upright * 2.0 / max(way, 2.0)
    elif model == DIST:
        fitness[0] = -state[ANGLES] - abs(state[WAY])
    elif model == DIST_POW_2:
        fitness[0] = -state[ANGLES] - state[SQUARE_WAYS]
    else:
        fitness[0] = -state[ANGLES] - state[DISTANCES] / 1000.0
    metrics[0] = state[UPRIGHT] / steps
    metrics[1] = way
    metrics[2] = state[POSITION]
    metrics[3] = remainder(positive_degrees(state[PHI]), 360.0) - 90.0


InvertedPendulum.problem = problem("play_pendulum", start, observe, act, is_over, judge)
