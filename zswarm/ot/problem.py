"""What candidates are judged by, and the kind of network they are: all that evaluating needs of an experiment."""

import msgspec
import numpy as np

from zswarm import evaluate
from zswarm.draws import derive_seed
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.controller import Controller
from zswarm.ot.workload import Workload


class Problem:
    """The problem of a complete experiment, built.

    Attributes:
        experiment: it is of this one.
        simulator, representation: as the experiment sets them up.
    """

    def __init__(self, complete: Experiment) -> None:
        """Build it.

        Raises:
            ConfigError: the simulator or the representation refuses its settings, or it is played by several participants.
        """
        self.experiment = complete
        problem, network = complete.problem, complete.representation
        self.simulator, self.representation = evaluate.build(problem.simulator, problem.settings, network.kind, network.settings)
        if self.simulator.participants != 1:
            raise ConfigError(
                f"{problem.simulator} is played by {self.simulator.participants} participants; a run evolves problems of one"
            )

    def __eq__(self, other: object) -> bool:
        """Whether the same genomes have the same outcomes."""
        return isinstance(other, Problem) and self._decisive() == other._decisive()

    def __hash__(self) -> int:
        return hash(msgspec.json.encode(self._decisive(), order="sorted"))

    def trial_seeds(self, generation: int) -> np.ndarray:
        """(trials,) uint64: the problem's own where it fixes them; else from the run's seed, and the generation if fresh."""
        problem, seed = self.experiment.problem, self.experiment.seed
        trials = range(problem.trials)
        if problem.seeds == "fresh":
            return np.array([derive_seed(seed, "trial", trial, generation) for trial in trials], np.uint64)
        fixed = self.simulator.fixed_seeds(problem.trials)
        return np.array(fixed if fixed is not None else [derive_seed(seed, "trial", trial) for trial in trials], np.uint64)

    def workload(self, genomes: list[bytes], generation: int) -> Workload:
        """Every candidate on every trial's seed, candidate after candidate."""
        seeds = self.trial_seeds(generation)
        participants = np.repeat(np.arange(len(genomes)), len(seeds)).reshape(-1, 1)
        return Workload(genomes, participants, np.tile(seeds, len(genomes)), len(self.simulator.metrics))

    def total(self, workload: Workload) -> np.ndarray:
        """(candidates,) float64: the sum over a candidate's trials, added in trial order; never -0.0, which SQLite drops."""
        return np.cumsum(workload.fitness[:, 0].reshape(-1, self.experiment.problem.trials), axis=1)[:, -1] + 0.0

    def controller(self, genome: bytes, fitness: float, run: str) -> Controller:
        """A genome with all that is needed to run it."""
        complete, simulator = self.experiment, self.simulator
        return Controller(
            simulator=complete.problem.simulator,
            simulator_settings=complete.problem.settings,
            representation=complete.representation.kind,
            representation_settings=complete.representation.settings,
            inputs=simulator.inputs,
            outputs=simulator.outputs,
            sensors=list(simulator.sensors),
            actuators=list(simulator.actuators),
            genome=genome,
            fitness=fitness,
            run=run,
        )

    def _decisive(self) -> dict[str, object]:
        complete = self.experiment
        return {"problem": complete.problem, "representation": complete.representation, "seed": complete.seed}
