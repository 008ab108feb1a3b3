"""Simulators that pass calls on to another one, and check its answers or measure its time."""

import time
from collections.abc import Sequence
from typing import NamedTuple, get_args

import numpy as np

from zswarm.sims.simulator import Body, Frame, Outcome, Simulator, Turn
from zswarm.testing.rules import BrokenRule, checking, require

SHAPES = get_args(Body.__annotations__["shape"])


class Speed(NamedTuple):
    """Speed of a simulator in turns, in processor time. ``str()`` puts it into words."""

    simulator: str
    trials_per_s: float
    agent_steps_per_s: float
    turn_s: float  # duration of a turn
    own_share: float  # of a turn, in the simulator; the networks take the rest

    def __str__(self) -> str:
        """Return a sentence."""
        return (
            f"{self.simulator}: {self.agent_steps_per_s:,.0f} agent-steps/s, "
            f"{self.trials_per_s:,.1f} trials/s in turns; a turn takes "
            f"{self.turn_s * 1e6:,.0f} us, {self.own_share:.0%} of it in the simulator"
        )


class TimedSimulator(Simulator):
    """Measures how long another simulator takes."""

    def __init__(self, simulator: Simulator) -> None:
        super().__init__(simulator.settings)
        self._simulator = simulator
        self.inputs, self.outputs = simulator.inputs, simulator.outputs
        self.sensors = simulator.sensors
        self._turns = self._agent_steps = self._ns = 0

    @property
    def owners(self) -> Sequence[int]:  # type: ignore[override]  # may change in reset
        """Return those of the simulator."""
        return self._simulator.owners

    def reset(self, seed: int) -> Turn:
        """Start a trial."""
        begin = time.process_time_ns()
        turn = self._simulator.reset(seed)
        self._ns += time.process_time_ns() - begin
        return turn

    def step(self, actions: np.ndarray) -> Turn | None:
        """Pass on a step."""
        begin = time.process_time_ns()
        turn = self._simulator.step(actions)
        self._ns += time.process_time_ns() - begin
        self._turns += 1
        self._agent_steps += len(actions)
        return turn

    def outcome(self) -> Outcome:
        """Pass on the outcome."""
        return self._simulator.outcome()

    def speed(self, seconds: float, trials: int) -> Speed:
        """Return the speed, given the time that all trials took."""
        seconds = max(seconds, 1e-9)
        return Speed(
            simulator=type(self._simulator).__name__,
            trials_per_s=trials / seconds,
            agent_steps_per_s=self._agent_steps / seconds,
            turn_s=seconds / max(1, self._turns),
            own_share=min(1.0, self._ns / 1e9 / seconds),
        )


class CheckedSimulator(Simulator):
    """Checks what another simulator states and answers."""

    def __init__(self, simulator: Simulator) -> None:
        super().__init__(simulator.settings)
        self.simulator = simulator
        self._check_statements()
        self.participants, self.owners = simulator.participants, simulator.owners
        self.inputs, self.outputs = simulator.inputs, simulator.outputs
        self.sensors = simulator.sensors
        # The turn in which agents act, and a copy of its observations.
        self.acting: tuple[Turn, np.ndarray] | None = None

    def reset(self, seed: int) -> Turn:
        """Start a trial."""
        turn = self.simulator.reset(seed)
        require(turn is not None, ".reset must return a Turn: an agent must act")
        self.acting = None
        self.drawn = self._drawn()
        with checking(".reset"):
            return self._checked(turn, "a Turn")

    def step(self, actions: np.ndarray) -> Turn | None:
        """Pass on a step."""
        copied = actions.copy()
        turn = self.simulator.step(actions)
        same = np.array_equal(copied, actions, equal_nan=True)
        require(same, ".step must not change the actions it is given")
        assert self.acting is not None  # noqa: S101  set by reset
        previous, copied = self.acting
        same = np.array_equal(previous.observations, copied)
        text = ".step changes the observations of the previous turn: each turn needs its own array"
        require(same, text)
        with checking(".step"):
            return None if turn is None else self._checked(turn, "a Turn or None")

    def outcome(self) -> Outcome:
        """Pass on the outcome."""
        drawn = self._drawn()
        text = ".frame: the frames of a trial must show the same bodies"
        require(drawn == self.drawn, f"{text}, not {self.drawn} and then {drawn}")
        outcome = self.simulator.outcome()
        valid = isinstance(outcome, Outcome)
        require(valid, f".outcome must return an Outcome, not {outcome!r:.80}")
        self._check_numbers("fitness", outcome.fitness, self.participants)
        self._check_numbers("metrics", outcome.metrics, len(self.simulator.metrics))
        again = self.simulator.outcome()
        same = [list(part) for part in again] == [list(part) for part in outcome]
        require(
            same,
            f".outcome, called twice, gives {tuple(outcome)} and then {tuple(again)}",
        )
        return outcome

    def _check_statements(self) -> None:
        simulator = self.simulator
        unique = len(set(simulator.metrics)) == len(simulator.metrics)
        require(unique, ".metrics: a name stands there twice")
        valid = all(isinstance(metric, str) for metric in simulator.metrics)
        require(valid, ".metrics must be names")
        for name in ("participants", "inputs", "outputs"):
            count = getattr(simulator, name, None)
            valid = isinstance(count, int) and count >= 1
            require(valid, f".{name} must be an int of at least 1, not {count!r}")
        for name, count in (
            ("sensors", simulator.inputs),
            ("actuators", simulator.outputs),
        ):
            given = len(getattr(simulator, name))
            require(
                given in (0, count),
                f".{name} must be empty or {count} names, not {given}",
            )
        stated = hasattr(simulator, "owners")
        require(stated, ".owners is missing: per agent the participant that drives it")
        owners, participants = set(simulator.owners), range(simulator.participants)
        text = f".owners must name each participant in {participants}, and no other, "
        require(owners == set(participants), f"{text}not {sorted(owners)}")
        seeds = simulator.fixed_seeds(3)
        valid = seeds is None or (
            len(seeds) == 3 and all(0 <= seed < 2**64 for seed in seeds)
        )
        require(
            valid,
            f".fixed_seeds(3) must be None or three numbers below 2**64, not {seeds!r}",
        )

    def _check_numbers(self, name: str, values: Sequence[float], count: int) -> None:
        text = f".outcome: {name} must be {count} numbers, not {len(values)}"
        require(len(values) == count, text)
        finite = np.isfinite(values).all()
        require(finite, f".outcome: {name} must be finite, not {values}")

    def _drawn(self) -> str:
        """Describe what must stay the same in all frames of a trial."""
        frame = self.simulator.frame()
        if frame is None:
            return "no frame"
        require(
            isinstance(frame, Frame),
            f".frame must return a Frame or None, not {frame!r:.80}",
        )
        for body in frame.bodies:
            text = f".frame: a shape must be one of {', '.join(SHAPES)}, not {body.shape!r:.40}"
            require(body.shape in SHAPES, text)
        known = range(self.simulator.inputs)
        for ray in frame.rays:
            text = f".frame: a ray's sensor must be in {known}, not {ray.sensor}"
            require(ray.sensor in known, text)
        shapes = " ".join(body.shape for body in frame.bodies)
        bodies, lines, rays = len(frame.bodies), len(frame.lines), len(frame.rays)
        return f"{bodies} bodies ({shapes:.60}), {lines} lines and {rays} rays"

    def _checked(self, turn: Turn, kinds: str) -> Turn:
        if not isinstance(turn, Turn):
            raise BrokenRule(f" must return {kinds}, not {turn!r:.80}")
        agents, observations = list(turn.agents), turn.observations
        require(agents, ": a turn must name an agent; return None when the trial is over")
        require(
            len(set(agents)) == len(agents),
            f": an agent stands twice in a turn: {agents}",
        )
        known = range(len(self.owners))
        valid = all(agent in known for agent in agents)
        require(valid, f": agents must be in {known}, not {agents}")
        dtype = getattr(observations, "dtype", type(observations))
        valid = isinstance(observations, np.ndarray) and dtype == np.float32
        require(valid, f": observations must be a float32 array, not {dtype}")
        shape = (len(agents), self.inputs)
        text = f": observations must be {shape}, not {observations.shape}"
        require(observations.shape == shape, text)
        for row, number in np.argwhere(~np.isfinite(observations))[:1]:
            text = (
                f"number {number} of agent {agents[row]} is {observations[row, number]}"
            )
            raise BrokenRule(f": observations must be finite; {text}")
        self.acting = turn, observations.copy()
        return turn
