"""XOR, exactly FREVO's ``XOR`` (github.com/smartgrids-aau/Frevo, version 1.5)."""

import msgspec
import numpy as np

from zswarm.jit import STEP, Step, array, float32, float64, inline, int64, kernel, void
from zswarm.lanes import LANES
from zswarm.sims.simulator import Batch, Body, CompiledSimulator, Frame, Label, Outcome, Turn

INPUTS, OUTPUTS, CASES = 2, 1, 4
CASE_INPUTS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
WANTED = np.array([0, 1, 1, 0], np.float32)
CORRECT = 0.5  # an error below it


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``: there are none."""


class XOR(CompiledSimulator):
    """A network says whether its two inputs differ; a small test of networks and optimizers.

    There are four agents, one per case: 0 0, 0 1, 1 0, 1 1. Each decides once, with a network that has decided nothing before.

    Observation: (2,) float32: 0 or 1 each.
    Action: (1,) float32, wanted is 1 where the inputs differ, else 0.
    Turns: one, of all four agents.
    Start: the same for every seed.
    End: after that turn.
    Fitness: minus the root of the mean square error of the four cases, each error rounded to float32. At most 0; -.5 for whoever
        always says .5.
    Metrics: ``correct``: cases with an error below .5, 4 when solved; ``output_00``, ``output_01``, ``output_10``, ``output_11``.
    """

    settings_type = Settings
    metrics = ("correct", "output_00", "output_01", "output_10", "output_11")
    inputs, outputs = INPUTS, OUTPUTS
    sensors, actuators = ("a", "b"), ("differ",)
    owners = (0,) * CASES

    def reset(self, seed: int) -> Turn:  # noqa: ARG002  nothing is drawn
        """All four cases."""
        self._said: np.ndarray | None = None
        return Turn(range(CASES), CASE_INPUTS.copy())

    def step(self, actions: np.ndarray) -> Turn | None:
        """The trial is over."""
        self._said = np.ascontiguousarray(actions[:, 0])
        return None

    def outcome(self) -> Outcome:
        """Fitness and metrics of what was said."""
        assert self._said is not None  # noqa: S101  the trial is over
        fitness, metrics = np.zeros(1), np.zeros(len(self.metrics))
        judge(self._said, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """The truth table: a row for each case, and what the network says."""
        row, size = 1.0, 0.4
        said = [None] * CASES if self._said is None else self._said.tolist()
        heads = [Label(head, x, 0.6, size) for head, x in (("a", 0.6), ("b", 1.4), ("wanted", 2.8), ("said", 4.8))]
        labels, bodies = list(heads), []
        for case, ((a, b), wanted, answer) in enumerate(zip(CASE_INPUTS.tolist(), WANTED.tolist(), said, strict=True)):
            y = 1.6 + case * row
            words = "?" if answer is None else f"{answer:.3f}"
            for text, x in ((f"{a:.0f}", 0.6), (f"{b:.0f}", 1.4), (f"{wanted:.0f}", 2.8), (words, 4.8)):
                labels.append(Label(text, x, y, size))
            kind = "not yet said" if answer is None else "right" if abs(answer - wanted) < CORRECT else "wrong"
            bodies.append(Body(kind, 6.2, y, 0.25))
        return Frame(7.0, 1.2 + CASES * row, [], bodies, labels=labels)

    def play(self, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play``."""
        self._play(step, 1, batch)

    def play_lanes(self, step_lanes: Step, step: Step, batch: Batch) -> None:  # noqa: ARG002  one trial takes no longer
        """See ``CompiledSimulator.play_lanes``: the four cases of two trials side by side."""
        self._play(step_lanes, LANES, batch)

    def _play(self, step: Step, together: int, batch: Batch) -> None:
        state = np.empty(batch.state_size * together, np.float32)
        play_trials(step, together, batch.parameters, batch.participants, state, batch.progress, batch.fitness, batch.metrics)


@inline
def judge(said, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of four answers, float32."""
    total, correct = 0.0, 0
    for case in range(CASES):
        error = np.float64(said[case] - WANTED[case])
        total += error * error
        correct += int(abs(error) < CORRECT)
        metrics[1 + case] = said[case]
    fitness[0] = 0.0 - np.sqrt(total / 4.0)
    metrics[0] = correct


@kernel(void(STEP, int64, array(float32, 2), array(int64, 2), array(float32), array(int64), array(float64, 2), array(float64, 2)))
def play_trials(step, together, parameters, participants, state, progress, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """All trials of a batch, see ``CompiledSimulator.play``; ``step`` decides so many cases together, one or eight."""
    observation, output = np.empty(INPUTS * together, np.float32), np.empty(together, np.float32)
    controller = np.empty(parameters.shape[1] * together, np.float32)
    trials = max(1, together // CASES)
    said = np.empty((trials, CASES), np.float32)
    for first in range(0, participants.shape[0], trials):
        progress[0] = first
        if progress[1] != 0:
            return
        for lane in range(together):
            row = participants[min(first + lane // CASES, participants.shape[0] - 1), 0]
            for number in range(parameters.shape[1]):
                controller[number * together + lane] = parameters[row, number]
        for begin in range(0, trials * CASES, together):
            state[:] = 0
            for lane in range(together):
                for sensor in range(INPUTS):
                    observation[sensor * together + lane] = CASE_INPUTS[(begin + lane) % CASES, sensor]
            step(controller, state, observation, output)
            for lane in range(together):
                said[(begin + lane) // CASES, (begin + lane) % CASES] = output[lane]
        for trial in range(first, min(first + trials, participants.shape[0])):
            judge(said[trial - first], fitness[trial], metrics[trial])
