"""The check that a simulator keeps its contract; ``zswarm.testing`` offers it.

A class is asked what it states of itself, and plays trials with random networks: again, in another order, after one that was cut
short, with clocks and generators in another state, and while what the process holds is counted.
"""

import contextlib
import copy
import gc
import os
import random
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

import msgspec
import numpy as np

from zswarm import plugins
from zswarm.draws import Stream
from zswarm.evaluate import BrokenContractError, evaluate, play_in_turns, turns
from zswarm.lanes import LANES
from zswarm.nets.representation import Representation
from zswarm.sims.simulator import Body, CompiledSimulator, Frame, Outcome, Simulator, Turn
from zswarm.strict import convert

TRIAL_SEEDS = (0, 1, 2**63 + 5, 2**64 - 1)
AGAIN, MOST = 3, 30  # times that a trial is played to see what it leaves behind: at least; while each leaves more
LEAK_BYTES = 4096  # left behind by a trial each time
CLOCKS = {
    "time": 1.0,
    "time_ns": 1e9,
    "monotonic": 1.0,
    "monotonic_ns": 1e9,
    "perf_counter": 1.0,
    "perf_counter_ns": 1e9,
}  # per s
LATER_S = 1e6
SHAPES = get_args(Body.__annotations__["shape"])


class Speed(NamedTuple):
    """How fast a simulator plays in turns, in processor time; a text when it is printed."""

    simulator: str
    trials_per_s: float
    agent_steps_per_s: float
    turn_s: float  # of a turn
    own_share: float  # of that, in the simulator; the rest is the networks', and what lies between

    def __str__(self) -> str:
        """In words."""
        return (
            f"{self.simulator}: {self.agent_steps_per_s:,.0f} agent-steps/s, {self.trials_per_s:,.1f} trials/s in turns; a turn "
            f"takes {self.turn_s * 1e6:,.0f} us, {self.own_share:.0%} of it in the simulator"
        )


def check_simulator(simulator_class: type[Simulator], settings: Mapping[str, Any] | None = None) -> Speed:
    """Play some trials with random fully-meshed networks and check the contract of ``Simulator``.

    Checked are: the numbers and names the class states; agents, shape and dtype of every turn, and that observations are finite
    and stay as they are; lengths and finiteness of the outcome; that a seed gives the same outcome bits again, whatever was
    played before, also where that was left before its end, in another instance, at another time, and with the generators of
    ``random`` and ``numpy.random`` in another state; that no trial leaves memory, open files, threads or processes behind.
    A ``CompiledSimulator`` must give the same bits in its turns, in a batch, and trial by trial, and must report its progress
    and stop when asked.

    Args:
        simulator_class: the class to check.
        settings: of the problem, as in ``[problem.settings]``; the defaults where left out.

    Returns:
        How fast it plays in turns; printed, it is a sentence.

    Raises:
        AssertionError: a rule is broken; the text says which.
    """
    name = simulator_class.__name__
    settings_type = getattr(simulator_class, "settings_type", None)
    require(
        isinstance(settings_type, type) and issubclass(settings_type, msgspec.Struct) and settings_type.__struct_config__.frozen,
        f"{name}.settings_type must be a frozen msgspec.Struct, not {settings_type!r:.80}",
    )

    def new() -> Simulator:
        return simulator_class(convert(settings or {}, simulator_class.settings_type, "settings"))

    checked = _CheckedSimulator(new())
    simulator = checked.simulator
    network = fully_meshed(simulator.inputs, simulator.outputs)
    genomes = network.random(simulator.participants + 2, Stream(1))
    parameters = network.parameters(genomes)
    trials = [(row, seed) for row in range(len(genomes)) for seed in TRIAL_SEEDS]
    participants = np.array([[(row + k) % len(genomes) for k in range(simulator.participants)] for row, _ in trials], np.int64)
    seeds = np.array([seed for _, seed in trials], np.uint64)
    world = _World()

    def play(player: Simulator, trial: int) -> bytes:
        fitness, metrics = np.zeros(simulator.participants), np.zeros(len(simulator.metrics))
        try:
            play_in_turns(player, network, parameters[participants[trial]], int(seeds[trial]), fitness, metrics)
        except BrokenContractError as error:
            raise AssertionError(f"{name}: {error}") from None
        except SystemExit as error:
            raise AssertionError(f"{name}: a trial must end by returning None from step, not by exit({error.code})") from error
        return fitness.tobytes() + metrics.tobytes()

    def alone(trial: int, state: int) -> bytes:
        player = new()
        with world.in_state(state):
            return play(player, trial)

    def why(trial: int) -> str:
        """Of another outcome."""
        used = f"; it uses {' and '.join(sorted(world.used))}" if world.used else ""
        one, again, otherwise = alone(trial, 1), alone(trial, 1), alone(trial, 2)
        if one != again:
            return f"so have two new simulators; it hangs on what is outside, such as variables of its class or module{used}"
        if one != otherwise:
            return f"it hangs on the state of the world outside{used}; draw from zswarm.draws.Stream(seed)"
        return "something is left over from earlier trials: set it anew in reset"

    def check_again(player: Simulator, trial: int, when: str) -> None:
        if play(player, trial) != in_turns[trial]:
            raise AssertionError(f"{name}: seed {seeds[trial]} played again, {when}, has another outcome: {why(trial)}")

    with world.in_state(1):
        in_turns = [play(checked, trial) for trial in range(len(trials))]
    fresh = new()
    timed = _TimedSimulator(fresh)
    begin = time.process_time()
    with world.in_state(2):
        for trial in reversed(range(len(trials))):
            check_again(timed, trial, "after other trials")
        speed = timed.speed(time.process_time() - begin, len(trials))
        left = turns(fresh, network, parameters[participants[0]], int(seeds[0]))
        for _ in zip(range(2), left, strict=False):
            pass
        check_again(fresh, 1, "after a trial that was left before its end")
    _check_left_behind(name, lambda: play(fresh, 1))
    if isinstance(simulator, CompiledSimulator):
        assert isinstance(fresh, CompiledSimulator)  # noqa: S101  of the same class
        _check_compiled(fresh, network, genomes, participants, seeds, in_turns)
    return speed


class _World:
    """What a simulator must not hang on, and which of it was used."""

    def __init__(self) -> None:
        self.used: set[str] = set()

    @contextlib.contextmanager
    def in_state(self, state: int) -> Iterator[None]:
        """Clocks and generators in this state, which is not that of any other number."""
        generators, clocks = (random.getstate(), np.random.get_state()), {name: getattr(time, name) for name in CLOCKS}
        random.seed(state)
        np.random.seed(state)
        seeded = random.getstate(), str(np.random.get_state())
        for name, per_s in CLOCKS.items():
            setattr(time, name, self._later(name, clocks[name], state * LATER_S * per_s))
        try:
            yield
        finally:
            for name, clock in clocks.items():
                setattr(time, name, clock)
            if random.getstate() != seeded[0]:
                self.used.add("the generator of random")
            if str(np.random.get_state()) != seeded[1]:
                self.used.add("the generator of numpy.random")
            random.setstate(generators[0])
            np.random.set_state(generators[1])

    def _later(self, name: str, clock: Callable[[], float], later: float) -> Callable[[], float]:
        def read() -> float:
            self.used.add(f"time.{name}")
            return clock() + type(clock())(later)

        return read


def _check_left_behind(name: str, play: Callable[[], object]) -> None:
    """Play a trial again and again; what grows each time is left behind, what stops growing is kept for the next ones."""
    held: list[dict[str, int]] = []
    least: dict[str, int] = {}
    tracing = tracemalloc.is_tracing()
    tracemalloc.start()
    gc.freeze()  # or looking for what nobody uses any more would take the time of many trials
    try:
        for number in range(-1, MOST + 1):  # the first one may fill what is kept for the next
            play()
            gc.collect()
            held.append({**_holds(), "bytes": tracemalloc.get_traced_memory()[0] // LEAK_BYTES * LEAK_BYTES})
            if number > 0:
                grows = {what: count - held[-2][what] for what, count in held[-1].items()}
                least = {what: min(count, least.get(what, count)) for what, count in grows.items()}
            if number >= AGAIN and max(least.values()) <= 0:
                return
    finally:
        gc.unfreeze()
        if not tracing:
            tracemalloc.stop()
    what, count = next(each for each in least.items() if each[1] > 0)
    raise AssertionError(
        f"{name}: a trial leaves {count:,} {what} behind, each time; what it opens, starts or keeps must end with it, or serve "
        "all trials"
    )


def _holds() -> dict[str, int]:
    """Open files, threads and processes of this process; without /proc, threads only."""
    held = {"threads": threading.active_count()}
    with contextlib.suppress(OSError):
        tasks = list(Path("/proc/self/task").iterdir())
        held |= {"threads": len(tasks), "open files": len(os.listdir("/proc/self/fd"))}
        held["processes"] = sum(len(task.joinpath("children").read_text().split()) for task in tasks)
    return held


class _TimedSimulator(Simulator):
    """A simulator that measures how long another one takes."""

    def __init__(self, simulator: Simulator) -> None:
        super().__init__(simulator.settings)
        self._simulator = simulator
        self.inputs, self.outputs, self.sensors = simulator.inputs, simulator.outputs, simulator.sensors
        self._turns = self._agent_steps = self._ns = 0

    @property
    def owners(self) -> Sequence[int]:  # type: ignore[override]  # it may change in reset
        return self._simulator.owners

    def reset(self, seed: int) -> Turn:
        begin = time.process_time_ns()
        turn = self._simulator.reset(seed)
        self._ns += time.process_time_ns() - begin
        return turn

    def step(self, actions: np.ndarray) -> Turn | None:
        begin = time.process_time_ns()
        turn = self._simulator.step(actions)
        self._ns += time.process_time_ns() - begin
        self._turns, self._agent_steps = self._turns + 1, self._agent_steps + len(actions)
        return turn

    def outcome(self) -> Outcome:
        return self._simulator.outcome()

    def speed(self, seconds: float, trials: int) -> Speed:
        """Of so many trials, in so many seconds."""
        seconds = max(seconds, 1e-9)
        name, turn_s = type(self._simulator).__name__, seconds / max(1, self._turns)
        return Speed(name, trials / seconds, self._agent_steps / seconds, turn_s, min(1.0, self._ns / 1e9 / seconds))


class _CheckedSimulator(Simulator):
    """A simulator that checks what another one answers."""

    def __init__(self, simulator: Simulator) -> None:
        super().__init__(simulator.settings)
        self.simulator = simulator
        self.name = name = type(simulator).__name__
        require(len(set(simulator.metrics)) == len(simulator.metrics), f"{name}.metrics: a name stands there twice")
        require(all(isinstance(metric, str) for metric in simulator.metrics), f"{name}.metrics must be names")
        for what in ("participants", "inputs", "outputs"):
            count = getattr(simulator, what, None)
            require(isinstance(count, int) and count >= 1, f"{name}.{what} must be an int of at least 1, not {count!r}")
        for what, count in (("sensors", simulator.inputs), ("actuators", simulator.outputs)):
            names = getattr(simulator, what)
            require(len(names) in (0, count), f"{name}.{what} must be empty or {count} names, not {len(names)}")
        require(hasattr(simulator, "owners"), f"{name}.owners is missing: per agent the participant that drives it")
        require(
            set(simulator.owners) == set(range(simulator.participants)),
            f"{name}.owners must name a participant 0..{simulator.participants - 1} per agent, and each at least once; "
            f"it names {sorted(set(simulator.owners))}",
        )
        fixed = simulator.fixed_seeds(3)
        require(
            fixed is None or (len(fixed) == 3 and all(0 <= seed < 2**64 for seed in fixed)),
            f"{name}.fixed_seeds(3) must be None or three numbers below 2**64, not {fixed!r}",
        )
        self.participants, self.owners = simulator.participants, simulator.owners
        self.inputs, self.outputs, self.sensors = simulator.inputs, simulator.outputs, simulator.sensors
        self.turns = 0
        self.acting: tuple[Turn, np.ndarray] | None = None  # the turn that agents act in, and its observations as they were

    def reset(self, seed: int) -> Turn:
        turn = self.simulator.reset(seed)
        require(turn is not None, f"{self.name}.reset must return a Turn: somebody must act")
        self.turns, self.acting = 0, None
        self.drawn = self._drawn()
        return self._checked(turn, "reset")

    def step(self, actions: np.ndarray) -> Turn | None:
        before = actions.copy()
        turn = self.simulator.step(actions)
        require(np.array_equal(before, actions, equal_nan=True), f"{self.name}.step must not change the actions it gets")
        self._check_unchanged()
        self.turns += 1
        return None if turn is None else self._checked(turn, "step")

    def _check_unchanged(self) -> None:
        """The observations of the turn before."""
        assert self.acting is not None  # noqa: S101  somebody acted
        turn, kept = self.acting
        require(
            np.array_equal(turn.observations, kept),
            f"{self.name}.step changes the observations of the turn before: each turn needs an array of its own",
        )

    def _drawn(self) -> str:
        """What of a frame stays the same throughout a trial, in words."""
        frame = self.simulator.frame()
        where = f"{self.name}.frame"
        require(frame is None or isinstance(frame, Frame), f"{where} must return a Frame or None, not {frame!r:.80}")
        if frame is None:
            return "no frame"
        for body in frame.bodies:
            require(body.shape in SHAPES, f"{where}: a shape must be one of {', '.join(SHAPES)}, not {body.shape!r:.40}")
        for ray in frame.rays:
            known = range(self.inputs)
            require(ray.sensor in known, f"{where}: a ray's sensor must be in {known}, not {ray.sensor}")
        shapes = " ".join(body.shape for body in frame.bodies)
        return f"{len(frame.bodies)} bodies ({shapes:.60}), {len(frame.lines)} lines and {len(frame.rays)} rays"

    def outcome(self) -> Outcome:
        drawn = self._drawn()
        same = f"{self.name}.frame: the frames of a trial must show the same bodies, not {self.drawn} and then {drawn}"
        require(drawn == self.drawn, same)
        outcome = self.simulator.outcome()
        require(isinstance(outcome, Outcome), f"{self.name}.outcome must return an Outcome, not {outcome!r:.80}")
        for what, values, count in (
            ("fitness", outcome.fitness, self.participants),
            ("metrics", outcome.metrics, len(self.simulator.metrics)),
        ):
            require(len(values) == count, f"{self.name}.outcome: {what} must be {count} numbers, not {len(values)}")
            require(bool(np.isfinite(values).all()), f"{self.name}.outcome: {what} must be finite, not {values}")
        again = self.simulator.outcome()
        same = f"{self.name}.outcome, asked twice, gives {tuple(outcome)} and then {tuple(again)}"
        require((list(again.fitness), list(again.metrics)) == (list(outcome.fitness), list(outcome.metrics)), same)
        return outcome

    def _checked(self, turn: Turn, method: str) -> Turn:
        where = f"{self.name}.{method}"
        if not isinstance(turn, Turn):
            raise AssertionError(f"{where} must return a Turn{' or None' * (method == 'step')}, not {turn!r:.80}")
        agents, observations = list(turn.agents), turn.observations
        require(bool(agents), f"{where}: a turn must name an agent; a trial that is over returns None")
        require(len(set(agents)) == len(agents), f"{where}: an agent stands twice in a turn: {agents}")
        known = range(len(self.owners))
        require(all(agent in known for agent in agents), f"{where}: agents must be in {known}, not {agents}")
        require(
            isinstance(observations, np.ndarray) and observations.dtype == np.float32,
            f"{where}: observations must be a float32 array, not {getattr(observations, 'dtype', type(observations))}",
        )
        wanted = (len(agents), self.inputs)
        require(observations.shape == wanted, f"{where}: observations must be {wanted}, not {observations.shape}")
        wrong = np.argwhere(~np.isfinite(observations))
        for row, number in wrong[:1]:
            value = observations[row, number]
            raise AssertionError(f"{where}: observations must be finite; number {number} of agent {agents[row]} is {value}")
        self.acting = turn, observations.copy()
        return turn


def _check_compiled(
    simulator: CompiledSimulator,
    network: Representation,
    genomes: list[bytes],
    participants: np.ndarray,
    seeds: np.ndarray,
    in_turns: list[bytes],
) -> None:
    name = type(simulator).__name__
    one_by_one = _with_step_alone(network)
    scalar = _played(simulator, one_by_one, genomes, participants, seeds, "play", 1)
    for trial in range(len(seeds)):
        require(
            scalar[trial] == in_turns[trial],
            f"{name}: the turns and the compiled form differ, seed {seeds[trial]}: fitness and metrics "
            f"{np.frombuffer(in_turns[trial])} in turns, {np.frombuffer(scalar[trial])} compiled",
        )
    if type(simulator).play_lanes is not CompiledSimulator.play_lanes:
        lanes = _played(simulator, network, genomes, participants, seeds, "play_lanes", LANES)
        for trial in range(len(seeds)):
            require(lanes[trial] == scalar[trial], f"{name}.play_lanes: seed {seeds[trial]} has another outcome than in play")


def _played(
    simulator: CompiledSimulator,
    network: Representation,
    genomes: list[bytes],
    participants: np.ndarray,
    seeds: np.ndarray,
    method: str,
    aside: int,
) -> list[bytes]:
    """Outcomes of the trials in a batch, checked to be those of each alone; so many may run side by side."""
    where = f"{type(simulator).__name__}.{method}"
    progress = np.zeros(2, np.int64)
    batch = evaluate(simulator, network, genomes, participants, seeds, progress)
    require(
        len(seeds) - aside <= progress[0] < len(seeds),
        f"{where}: progress[0] must be the index of the trial that runs, {len(seeds) - 1} in the last, not {progress[0]}"
        + (f", or of the first of {aside} at most that run side by side" if aside > 1 else ""),
    )
    outcomes = [batch.fitness[trial].tobytes() + batch.metrics[trial].tobytes() for trial in range(len(seeds))]
    for trial in range(len(seeds)):
        one = slice(trial, trial + 1)
        alone = evaluate(simulator, network, genomes, participants[one], seeds[one])
        require(
            alone.fitness[0].tobytes() + alone.metrics[0].tobytes() == outcomes[trial],
            f"{where}: seed {seeds[trial]} alone has another outcome than as trial {trial} of a batch",
        )
    stopped = evaluate(simulator, network, genomes, participants, seeds, np.array([0, 1]))
    require(np.isnan(stopped.fitness).all(), f"{where}: must end before the next trial when progress[1] is not 0")
    return outcomes


def _with_step_alone(network: Representation) -> Representation:
    """The same network as one that decides for one agent at a time only."""
    alone = copy.copy(network)
    alone.step_lanes = None
    return alone


def fully_meshed(inputs: int, outputs: int) -> Representation:
    """A small network of that size."""
    representation_class = plugins.load("representation", "fully-meshed")
    network: Representation = representation_class(representation_class.settings_type(), inputs, outputs)
    return network


def require(holds: bool, text: str) -> None:
    """A rule.

    Raises:
        AssertionError: it is broken.
    """
    if not holds:
        raise AssertionError(text)
