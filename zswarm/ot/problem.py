"""What candidates are judged by, and the kind of network they are: all that evaluating needs of an experiment."""

import operator
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from zswarm import evaluate, plugins
from zswarm.controller import Controller
from zswarm.draws import Stream, derive_seed
from zswarm.experiment import Experiment
from zswarm.ot.rankings.ranking import Ranking, Round
from zswarm.ot.workload import Workload
from zswarm.strict import convert


class Problem:
    """The problem of a complete experiment, built.

    Attributes:
        experiment: it is of this one.
        simulator, representation, ranking: as the experiment sets them up.
    """

    def __init__(self, complete: Experiment) -> None:
        """Build it.

        Raises:
            ConfigError: the simulator, the representation or the ranking refuses its settings, or they do not fit together.
        """
        self.experiment = complete
        problem, network, ranking = complete.problem, complete.representation, complete.ranking
        self.simulator, self.representation = evaluate.build(problem.simulator, problem.settings, network.kind, network.settings)
        loaded = plugins.load("ranking", ranking.kind)
        settings = convert(ranking.settings, loaded.settings_type, "ranking")
        self.ranking: Ranking = loaded(settings, self.simulator.participants)

    def __eq__(self, other: object) -> bool:
        """Whether the same genomes have the same outcomes."""
        return isinstance(other, Problem) and self._decisive() == other._decisive()

    def __hash__(self) -> int:
        return hash(msgspec.json.encode(self._decisive(), order="sorted"))

    def __repr__(self) -> str:
        problem, genes = self.experiment.problem, self.genes
        of = f", {genes} genes" if genes is not None else ""
        return (
            f"<zswarm.Problem: {problem.simulator}, {problem.trials} trial{'s' if problem.trials != 1 else ''}; "
            f"{self.experiment.representation.kind}{of}>"
        )

    def trial_seeds(self, generation: int) -> np.ndarray:
        """(trials,) uint64: the problem's own where it fixes them; else from the run's seed, and the generation if fresh."""
        problem, seed = self.experiment.problem, self.experiment.seed
        trials = range(problem.trials)
        if problem.seeds == "fresh":
            return np.array([derive_seed(seed, "trial", trial, generation) for trial in trials], np.uint64)
        fixed = self.simulator.fixed_seeds(problem.trials)
        return np.array(fixed if fixed is not None else [derive_seed(seed, "trial", trial) for trial in trials], np.uint64)

    def workload(
        self, genomes: list[bytes], generation: int, seeds: np.ndarray | None = None, games: np.ndarray | None = None
    ) -> Workload:
        """Every game on every trial's seed, game after game.

        Args:
            seeds: (trials,) uint64, instead of the generation's.
            games: (games, participants) indices into genomes; by default each candidate by itself.
        """
        seeds = self.trial_seeds(generation) if seeds is None else seeds
        games = np.arange(len(genomes)).reshape(-1, 1) if games is None else games
        return Workload(genomes, np.repeat(games, len(seeds), axis=0), np.tile(seeds, len(games)), len(self.simulator.metrics))

    def trials_at_once(self, candidates: int | None) -> int | None:
        """Of the first round of so many candidates, None where their number is not known."""
        games = None if candidates is None else self.ranking.next_games(candidates, ())
        return None if games is None else len(games) * self.experiment.problem.trials

    def played(self, workload: Workload) -> Round:
        """The games of a workload, with the sums over their trials, added in trial order; never -0.0, which SQLite drops."""
        trials, participants = self.experiment.problem.trials, self.simulator.participants
        results = np.cumsum(workload.fitness.reshape(-1, trials, participants), axis=1)[:, -1] + 0.0
        return Round(workload.participants[::trials], results)

    def total(self, workload: Workload) -> np.ndarray:
        """(candidates,) float64: the sums over the trials of candidates that play by themselves."""
        return self.played(workload).results[:, 0]

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

    # ---- for optimizers outside

    @property
    def genes(self) -> int | None:
        """Numbers of a genome that is a plain vector of them; None where the representation's genomes are something else."""
        return self.representation.genes

    def random(self, count: int, seed: int = 0) -> list[bytes]:
        """Random genomes, as evolution begins with; the same seed gives the same.

        Raises:
            ValueError: a number below 0, or a seed of more than 64 bits.
            TypeError: no whole number.
        """
        check_whole("count", count)
        check_whole("seed", seed)
        return self.representation.random(count, Stream(derive_seed(seed, "random")))

    def genomes(self, candidates: Sequence[bytes] | np.ndarray | Sequence[Any]) -> list[bytes]:
        """Genomes of vectors: (n, genes) numbers, stored as float32; genomes stay as they are.

        Raises:
            ValueError: another shape or length, a number that is not real or not finite in float32, or no vectors are taken.
            TypeError: no list and no array.
        """
        if isinstance(candidates, str | bytes | Mapping) or not hasattr(candidates, "__len__"):
            raise TypeError(f"candidates: expected a list of genomes or an array of numbers, not {type(candidates).__name__}")
        if len(candidates) == 0:
            return []
        if isinstance(candidates, Sequence) and any(isinstance(candidate, bytes) for candidate in candidates):
            if not all(isinstance(candidate, bytes) for candidate in candidates):
                raise ValueError("candidates: expected either genomes as bytes or vectors of numbers, not both")
            genomes = list(candidates)
        elif self.genes is None:
            kind = self.experiment.representation.kind
            raise ValueError(f"candidates: genomes of {kind} are no plain vectors: expected a list of bytes")
        else:
            numbers = _numbers(candidates)
            if numbers.shape != (len(candidates), self.genes):
                raise ValueError(f"candidates: expected shape (n, {self.genes}), not {numbers.shape}")
            with np.errstate(over="ignore"):  # told below
                vectors = numbers.astype("<f4")
            genomes = [vector.tobytes() for vector in vectors]
        self.representation.parameters(genomes)  # refuses what no server could evaluate
        return genomes

    def vectors(self, genomes: Sequence[bytes]) -> np.ndarray:
        """(n, genes) float32, which ``genomes`` makes the same genomes of.

        Raises:
            ValueError: the representation's genomes are no plain vectors.
        """
        if self.genes is None:
            raise ValueError(f"genomes of {self.experiment.representation.kind} are no plain vectors")
        return np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), self.genes).astype(np.float32)

    def _decisive(self) -> dict[str, object]:
        complete = self.experiment
        return {"problem": complete.problem, "representation": complete.representation, "seed": complete.seed}


def check_whole(name: str, value: Any) -> None:
    """Refuse what is no whole number from 0 to 2^64 - 1."""
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name}: expected a whole number, not {value!r:.60}") from None
    if not 0 <= number < 2**64:
        raise ValueError(f"{name}: expected a whole number from 0 to 2^64 - 1, not {number}")


def _numbers(candidates: Any) -> np.ndarray:
    try:
        numbers = np.asarray(candidates)
    except ValueError:
        raise ValueError("candidates: expected vectors of equal length") from None
    if numbers.dtype.kind not in "buif":
        raise ValueError(f"candidates: expected real numbers, not an array of {numbers.dtype}")
    return numbers
