"""Build simulators from five compiled functions: start, observe, act, is_over and judge.

All agents of such a simulator act at the same time. The functions take a world, which is a
``NamedTuple`` of arrays and settings.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any, ClassVar, NamedTuple

import numpy as np

from zswarm.kernels.jit import STEP, Step, inline, int64, kernel, void
from zswarm.kernels.lanes import LANES, load, select, store, window
from zswarm.kernels.signatures import Float64Rows, Float64s, Int64s, UInt64s
from zswarm.sims.simulator import CompiledSimulator, KernelBatch, Outcome, Turn

SPARE = 3  # numbers behind all observations: four are read at once
# Behind those of all agents: eight are read at once.
SPARE_ACTIONS = np.zeros(LANES, np.float32)
LANE_NUMBERS = np.arange(LANES, dtype=np.int32)


class World(NamedTuple):
    """The settings of a problem, and the state of a trial."""

    rules: Int64s
    constants: Float64s
    walls: Float64Rows  # (walls, 4)
    state: Float64s
    counts: Int64s
    stream: UInt64s  # (1,), the state of a random generator


def world(
    *,
    rules: Sequence[int] = (),
    constants: Sequence[float] = (),
    walls: Sequence[tuple[float, float, float, float]] = (),
    state: int = 0,
    counts: int = 0,
) -> World:
    """Make a world; ``state`` and ``counts`` are the lengths of these arrays."""
    return World(
        np.array(rules, np.int64),
        np.array(constants, np.float64),
        np.array(walls, np.float64).reshape(-1, 4),
        np.zeros(state),
        np.zeros(counts, np.int64),
        np.zeros(1, np.uint64),
    )


class TrialKernel(NamedTuple):
    """The functions of a problem, each declared with ``inline(counts=False)``, and their kernel.

    Observations are one array, robot after robot. So are actions, number after number: those of
    all agents for the first output, then those for the second.
    """

    start: Callable[..., Any]  # (world, seed)
    observe: Callable[..., Any]  # (world, observations)
    act: Callable[..., Any]  # (world, actions)
    is_over: Callable[..., Any]  # (world)
    judge: Callable[..., Any]  # (world, fitness, metrics)
    play_trials: Callable[..., Any]


start: Callable[..., Any]  # ``problem`` sets these for each problem
observe: Callable[..., Any]
act: Callable[..., Any]
is_over: Callable[..., Any]
judge: Callable[..., Any]


def play_one(step, world, batch, inputs, outputs):
    """Play the trials of one agent, see ``CompiledSimulator.play``."""
    memory = np.empty(batch.state_size, np.float32)
    observation = np.empty(inputs, np.float32)
    action = np.empty(outputs, np.float32)
    for trial in range(batch.seeds.shape[0]):
        batch.progress[0] = trial
        if batch.progress[1] != 0:
            return
        controller = batch.parameters[batch.participants[trial, 0]]
        memory[:] = 0
        start(world, batch.seeds[trial])  # noqa: F821
        while not is_over(world):  # noqa: F821
            observe(world, observation)  # noqa: F821
            step(controller, memory, observation, action)
            act(world, action)  # noqa: F821
        judge(world, batch.fitness[trial], batch.metrics[trial])  # noqa: F821


def play_many(step, world, batch, together, robots, inputs, outputs):
    """Play the trials of one or more teams; ``step`` decides for ``together`` robots at once."""
    teams = batch.participants.shape[1]
    numbers = batch.parameters.shape[1]
    agents = teams * robots
    groups = -(-robots // together)
    controllers = np.empty((teams, numbers * together), np.float32)
    states = np.zeros((teams * groups, together * batch.state_size), np.float32)
    gathered = np.empty((inputs + SPARE) * together, np.float32)
    observation = gathered[: inputs * together]
    action = np.empty(outputs * together, np.float32)
    # Zeros, because lanes also read what lies behind the last robot.
    padded = np.zeros(agents * inputs + SPARE, np.float32)
    observations = padded[: agents * inputs]
    actions = np.zeros(outputs * agents + LANES, np.float32)
    for trial in range(batch.seeds.shape[0]):
        batch.progress[0] = trial
        if batch.progress[1] != 0:
            return
        for team in range(teams):
            for number in range(numbers):
                parameter = batch.parameters[batch.participants[trial, team], number]
                for lane in range(together):
                    controllers[team, number * together + lane] = parameter
        states[:] = 0
        start(world, batch.seeds[trial])  # noqa: F821
        while not is_over(world):  # noqa: F821
            observe(world, observations)  # noqa: F821
            for team in range(teams):
                controller = controllers[team]
                last = (team + 1) * robots - 1
                for group in range(groups):
                    first = team * robots + group * together
                    state = states[team * groups + group]
                    if together == 1:
                        observed = observations[inputs * first : inputs * (first + 1)]
                        step(controller, state, observed, action)
                        for number in range(outputs):
                            actions[agents * number + first] = action[number]
                    else:
                        gather(padded, first, last, inputs, gathered)
                        step(controller, state, observation, action)
                        spread(action, first, last, agents, outputs, actions)
            act(world, actions)  # noqa: F821
        judge(world, batch.fitness[trial], batch.metrics[trial])  # noqa: F821


@inline(counts=False, inner=True)
def gather(observations, first, last, inputs, observation):
    """Copy the observations of eight robots; the last robot fills spare lanes."""
    lanes = load(LANE_NUMBERS, 0) + first
    rows = select(lanes < last, lanes, last) * inputs
    for number in range(0, inputs, 4):  # rows become columns, four at once
        columns = window(observations, rows, number)
        store(observation, number * LANES, columns[0])
        store(observation, (number + 1) * LANES, columns[1])
        store(observation, (number + 2) * LANES, columns[2])
        store(observation, (number + 3) * LANES, columns[3])


@inline(counts=False, inner=True)
def spread(action, first, last, agents, outputs, actions):
    """Copy the actions of eight robots, of which some may be spare, to those of all."""
    for number in range(outputs):
        at = number * agents + first
        if first + LANES <= last + 1:
            store(actions, at, load(action, number * LANES))
        else:
            for lane in range(last + 1 - first):
                actions[at + lane] = action[number * LANES + lane]


def problem(
    name: str,
    start: Callable[..., Any],
    observe: Callable[..., Any],
    act: Callable[..., Any],
    is_over: Callable[..., Any],
    judge: Callable[..., Any],
    *,
    world: type[tuple[Any, ...]] = World,
    loop: Callable[..., None] = play_one,
) -> TrialKernel:
    """Build the kernel.

    The loop gets a name and globals of its own: numba caches no function that closes over others.
    It also gets the place of ``start``: numba caches by file, so that a changed problem is compiled
    again and problems of two modules share no kernel, and reads the source at that line.
    """
    functions = {
        "start": start,
        "observe": observe,
        "act": act,
        "is_over": is_over,
        "judge": judge,
    }
    place = getattr(start, "py_func", start).__code__
    code = loop.__code__.replace(
        co_filename=place.co_filename, co_firstlineno=place.co_firstlineno
    )
    play = FunctionType(code, {**globals(), **functions}, name)
    play.__qualname__ = name
    numbers = [int64] * (code.co_argcount - 3)
    return TrialKernel(
        play_trials=kernel(void(STEP, world, KernelBatch, *numbers))(play), **functions
    )


class TrialSimulator(CompiledSimulator):
    """A simulator whose trials are played by the functions of its problem.

    Attributes:
        problem: these functions.
        world: the settings, and the state of a trial.
    """

    problem: ClassVar[TrialKernel]
    world: Any

    def reset(self, seed: int) -> Turn:
        """Start a trial."""
        self.problem.start(self.world, np.uint64(seed))
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Let all agents act."""
        self.problem.act(self.world, np.append(actions.T, SPARE_ACTIONS))
        return None if self.problem.is_over(self.world) else self._turn()

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the trial that ended."""
        fitness = np.zeros(self.participants)
        metrics = np.zeros(len(self.metrics))
        self.problem.judge(self.world, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def _turn(self) -> Turn:
        agents = range(len(self.owners))
        observations = np.empty((len(agents), self.inputs), np.float32)
        self.problem.observe(self.world, observations.reshape(-1))
        return Turn(agents, observations)


class OneAgent(TrialSimulator):
    """A simulator with one agent."""

    owners = (0,)

    def play(self, step: Step, batch: KernelBatch) -> None:
        """See ``CompiledSimulator.play``."""
        self.problem.play_trials(step, self.world, batch, self.inputs, self.outputs)


class Teams(TrialSimulator):
    """A simulator with a team of robots for each participant, which act all at the same time."""

    def play(self, step: Step, batch: KernelBatch) -> None:
        """See ``CompiledSimulator.play``."""
        self._play(step, 1, batch)

    def play_lanes(self, step_lanes: Step, step: Step, batch: KernelBatch) -> None:  # noqa: ARG002  eight at once take as long as two
        """See ``CompiledSimulator.play_lanes``: eight robots of a trial decide at once."""
        self._play(step_lanes, LANES, batch)

    def _play(self, step: Step, together: int, batch: KernelBatch) -> None:
        robots = len(self.owners) // self.participants
        self.problem.play_trials(
            step, self.world, batch, together, robots, self.inputs, self.outputs
        )
