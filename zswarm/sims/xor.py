"""Compute XOR, exactly as FREVO's ``XOR`` (github.com/smartgrids-aau/Frevo, version 1.5)."""

import numpy as np

from zswarm.config.meta import PartSettings
from zswarm.kernels.jit import STEP, Step, inline, int64, kernel, void
from zswarm.kernels.lanes import LANES
from zswarm.sims.simulator import (
    Body,
    CompiledSimulator,
    Frame,
    KernelBatch,
    Label,
    Outcome,
    Turn,
)

INPUTS, OUTPUTS, CASES = 2, 1, 4
CASE_INPUTS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
WANTED = np.array([0, 1, 1, 0], np.float32)
CORRECT = 0.5  # an error below it


class XORSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``: none."""


class XOR(CompiledSimulator):
    """A network says whether its two inputs differ; a small test of networks and optimizers.

    There are four agents, one per case: 0 0, 0 1, 1 0, 1 1. Each decides once, with a network that
    has decided nothing before.

    Observation: (2,) float32: 0 or 1 each.
    Action: (1,) float32, wanted is 1 where the inputs differ, else 0.
    Turns: one, of all four agents.
    Start: the same for every seed.
    End: after that turn.
    Fitness: minus the root of the mean square error of the four cases, each error rounded to
        float32. At most 0; -.5 for the constant output .5.
    Metrics: ``correct``: cases with an error below .5, 4 when solved; ``output_00``, ``output_01``,
    ``output_10``, ``output_11``.
    """

    settings_type = XORSettings
    metrics = ("correct", "output_00", "output_01", "output_10", "output_11")
    inputs, outputs = INPUTS, OUTPUTS
    sensors, actuators = ("a", "b"), ("differ",)
    owners = (0,) * CASES

    def reset(self, seed: int) -> Turn:  # noqa: ARG002  nothing is drawn
        """Start a trial with all four cases."""
        self._said: np.ndarray | None = None
        return Turn(range(CASES), CASE_INPUTS.copy())

    def step(self, actions: np.ndarray) -> Turn | None:
        """Store the answers; the trial is over."""
        self._said = np.ascontiguousarray(actions[:, 0])
        return None

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the answers."""
        assert self._said is not None  # noqa: S101  the trial is over
        fitness = np.zeros(1)
        metrics = np.zeros(len(self.metrics))
        judge(self._said, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """Return the truth table: a row for each case, with the network's answer."""
        row = 1.0
        size = 0.4
        said = [None] * CASES if self._said is None else self._said.tolist()
        heads = [
            Label(head, x, 0.6, size)
            for head, x in (("a", 0.6), ("b", 1.4), ("wanted", 2.8), ("said", 4.8))
        ]
        labels = list(heads)
        bodies = []
        for case, ((a, b), wanted, answer) in enumerate(
            zip(CASE_INPUTS.tolist(), WANTED.tolist(), said, strict=True)
        ):
            y = 1.6 + case * row
            words = "?" if answer is None else f"{answer:.3f}"
            for text, x in (
                (f"{a:.0f}", 0.6),
                (f"{b:.0f}", 1.4),
                (f"{wanted:.0f}", 2.8),
                (words, 4.8),
            ):
                labels.append(Label(text, x, y, size))
            kind = (
                "not yet said"
                if answer is None
                else "right"
                if abs(answer - wanted) < CORRECT
                else "wrong"
            )
            bodies.append(Body(kind, 6.2, y, 0.25))
        return Frame(7.0, 1.2 + CASES * row, [], bodies, labels=labels)

    def play(self, step: Step, batch: KernelBatch) -> None:
        """See ``CompiledSimulator.play``."""
        play_trials(step, 1, batch)

    def play_lanes(self, step_lanes: Step, step: Step, batch: KernelBatch) -> None:  # noqa: ARG002  one trial takes no longer
        """See ``CompiledSimulator.play_lanes``: the four cases of two trials in parallel."""
        play_trials(step_lanes, LANES, batch)


@inline
def judge(said, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Write fitness and metrics of four answers, float32."""
    total = 0.0
    correct = 0
    for case in range(CASES):
        error = np.float64(said[case] - WANTED[case])
        total += error * error
        correct += int(abs(error) < CORRECT)
        metrics[1 + case] = said[case]
    fitness[0] = 0.0 - np.sqrt(total / 4.0)
    metrics[0] = correct


@kernel(void(STEP, int64, KernelBatch))
def play_trials(step, together, batch):  # type: ignore[no-untyped-def]  # compiled
    """Play a batch as ``CompiledSimulator.play`` does; ``step`` decides one or eight cases."""
    last = batch.participants.shape[0] - 1
    numbers = batch.parameters.shape[1]
    observation = np.empty(INPUTS * together, np.float32)
    output = np.empty(together, np.float32)
    controller = np.empty(numbers * together, np.float32)
    state = np.empty(batch.state_size * together, np.float32)
    trials = max(1, together // CASES)
    said = np.empty((trials, CASES), np.float32)
    for first in range(0, last + 1, trials):
        batch.progress[0] = first
        if batch.progress[1] != 0:
            return
        for lane in range(together):
            row = batch.participants[min(first + lane // CASES, last), 0]
            for number in range(numbers):
                controller[number * together + lane] = batch.parameters[row, number]
        for begin in range(0, trials * CASES, together):
            state[:] = 0
            for lane in range(together):
                for sensor in range(INPUTS):
                    case = (begin + lane) % CASES
                    observation[sensor * together + lane] = CASE_INPUTS[case, sensor]
            step(controller, state, observation, output)
            for lane in range(together):
                said[(begin + lane) // CASES, (begin + lane) % CASES] = output[lane]
        for trial in range(first, min(first + trials, last + 1)):
            judge(said[trial - first], batch.fitness[trial], batch.metrics[trial])
