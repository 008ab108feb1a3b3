"""A problem that candidates are evaluated on, and the kind of network they are."""

import operator
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from zswarm import evaluate
from zswarm.champion.controller import Controller
from zswarm.config.decode import convert
from zswarm.errors import ConfigError, RemoteProtocolError
from zswarm.experiment import Experiment
from zswarm.kernels.random import Stream, derive_seed
from zswarm.ot.assessment import racing
from zswarm.ot.rankings.ranking import Ranking, Round
from zswarm.ot.workload import Workload
from zswarm.plugins import registry as plugins
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    MAX_GENOME,
    MAX_GENOMES,
    MAX_MESSAGE,
    MAX_SETTINGS,
    Requirements,
)

CHECKED_BYTES = 16 << 20  # of genomes that are checked at once
OTHER_BYTES = 1000  # of a message, besides genomes, for each of them and once more


class Problem:
    """The simulator, the representation and the ranking of a complete experiment, built.

    Raises:
        ConfigError: one of them refuses its settings, or they do not fit together.
    """

    def __init__(self, complete: Experiment) -> None:
        self.experiment = complete
        problem = complete.problem
        network = complete.representation
        ranking = complete.ranking
        self.simulator, self.representation = evaluate.build(
            problem.simulator, problem.settings, network.kind, network.settings
        )
        loaded = plugins.load("ranking", ranking.kind)
        settings = convert(ranking.settings, loaded.settings_type, "ranking")
        self.ranking: Ranking = loaded(settings, self.simulator.participants)
        self._check_limits()

    def _check_limits(self) -> None:
        """Refuse what could not be sent to a server; genomes that grow are not known yet."""
        problem, network = self.experiment.problem, self.experiment.representation
        for where, sent in (
            ("problem.settings", problem.settings),
            ("representation", network.settings),
        ):
            try:
                codec.decode_request(codec.encode(Requirements(settings=sent)))
            except RemoteProtocolError as error:
                raise ConfigError(
                    f"{where}: cannot be sent to servers: {error}"
                ) from None
        sizes = [
            len(msgspec.msgpack.encode(sent))
            for sent in (problem.settings, network.settings)
        ]
        if sum(sizes) > MAX_SETTINGS:
            raise ConfigError(
                f"problem.settings and representation: {sizes[0]:,} and {sizes[1]:,} bytes as they"
                f" are sent; at most {MAX_SETTINGS:,} together can be sent to servers"
            )
        participants = self.simulator.participants
        if participants > MAX_GENOMES:
            raise ConfigError(
                f"problem.simulator: {problem.simulator} has {participants:,} participants in a"
                f" trial; at most {MAX_GENOMES:,} can be sent to a server"
            )
        if self.genes is None or self.experiment.cluster.controller == "optimizer":
            return
        size = 4 * self.genes
        genome = (
            f"representation: {network.kind} has {self.genes:,} parameters with these"
        )
        genome += f" settings, a genome of {size:,} bytes"
        if size > MAX_GENOME:
            raise ConfigError(f"{genome}; at most {MAX_GENOME:,} can be sent to a server")
        if participants * size > MAX_MESSAGE - OTHER_BYTES * (participants + 1):
            raise ConfigError(
                f"{genome}, and a trial of {problem.simulator} has {participants}"
                f" participants; at most {MAX_MESSAGE:,} bytes can be sent to a server"
            )

    def __eq__(self, other: object) -> bool:
        """Return whether the same genomes have the same outcomes."""
        return isinstance(other, Problem) and self._decisive() == other._decisive()

    def __hash__(self) -> int:
        return hash(msgspec.json.encode(self._decisive(), order="sorted"))

    def __repr__(self) -> str:
        problem, kind = self.experiment.problem, self.experiment.representation.kind
        genes = f", {self.genes} genes" if self.genes is not None else ""
        trials = f"{problem.trials} trial{'s' if problem.trials != 1 else ''}"
        return f"<zswarm.Problem: {problem.simulator}, {trials}; {kind}{genes}>"

    def trial_seeds(self, generation: int, trials: int | None = None) -> np.ndarray:
        """Return the seeds of a generation's trials, (trials,) uint64; of more if it is given.

        They are the simulator's own if it fixes them; else they come from the run's seed, and from
        the generation if they are to be fresh.
        """
        problem, seed = self.experiment.problem, self.experiment.seed
        fresh = (generation,) if problem.seeds == "fresh" else ()
        trials = problem.trials if trials is None else trials
        seeds = None if fresh else self.simulator.fixed_seeds(trials)
        if seeds is None:
            seeds = [derive_seed(seed, "trial", n, *fresh) for n in range(trials)]
        return np.array(seeds, np.uint64)

    def workload(
        self,
        genomes: list[bytes],
        generation: int,
        seeds: np.ndarray | None = None,
        games: np.ndarray | None = None,
    ) -> Workload:
        """Return every game on every trial's seed, game after game.

        Args:
            seeds: (trials,) uint64, instead of the generation's.
            games: (games, participants) indices into genomes; by default one of each genome.
        """
        seeds = self.trial_seeds(generation) if seeds is None else seeds
        games = np.arange(len(genomes)).reshape(-1, 1) if games is None else games
        participants = np.repeat(games, len(seeds), axis=0)
        trials = np.tile(seeds, len(games))
        return Workload(genomes, participants, trials, len(self.simulator.metrics))

    def trials_at_once(self, candidates: int | None) -> int | None:
        """Return the trials in the first round of some candidates; None if that is unknown."""
        games = None if candidates is None else self.ranking.next_games(candidates, ())
        trials = self.experiment.problem.trials
        if self.experiment.assessment.racing:
            trials = racing.rounds(trials)[0]
        return None if games is None else len(games) * trials

    def played(self, workload: Workload) -> Round:
        """Return the games of a workload with the sums over their trials, added in trial order."""
        trials, participants = self.experiment.problem.trials, self.simulator.participants
        sums = np.cumsum(workload.fitness.reshape(-1, trials, participants), axis=1)[
            :, -1
        ]
        # SQLite drops the sign of -0.0.
        return Round(workload.participants[::trials], sums + 0.0)

    def total(self, workload: Workload) -> np.ndarray:
        """Return the sums over the trials of candidates that play alone, (candidates,) float64."""
        return self.played(workload).results[:, 0]

    @property
    def fitness_trials(self) -> int:
        """Trials whose sum a candidate's fitness is; 1 for a score, which covers all its games."""
        return 1 if self.ranking.relative else self.experiment.problem.trials

    def controller(self, genome: bytes, fitness: float, run: str) -> Controller:
        """Return a genome with all that is needed to run it."""
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
            trials=self.fitness_trials,
            run=run,
            robot=simulator.robot,
        )

    # ---- for a user's optimizer

    @property
    def genes(self) -> int | None:
        """Numbers of a genome that is a plain vector; None if genomes are something else."""
        return self.representation.genes

    def random(self, count: int, seed: int = 0) -> list[bytes]:
        """Return random genomes, as evolution begins with; the same seed gives the same.

        Raises:
            ValueError: a number below 0, or a seed of more than 64 bits.
            TypeError: an argument that is not a whole number.
        """
        check_whole("count", count)
        check_whole("seed", seed)
        return self.representation.random(count, Stream(derive_seed(seed, "random")))

    def genomes(
        self, candidates: Sequence[bytes] | np.ndarray | Sequence[Any]
    ) -> list[bytes]:
        """Return genomes of vectors, (n, genes) numbers stored as float32, or genomes as they are.

        Raises:
            ValueError: another shape or length, a number that is not real or not finite in float32,
                or a representation without vectors.
            TypeError: neither a list nor an array.
        """
        if isinstance(candidates, str | bytes | Mapping) or not hasattr(
            candidates, "__len__"
        ):
            raise TypeError(
                "candidates: expected a list of genomes or an array of numbers,"
                f" not {type(candidates).__name__}"
            )
        if len(candidates) == 0:
            return []
        listed = isinstance(candidates, Sequence)
        as_bytes = sum(isinstance(one, bytes) for one in candidates) if listed else 0
        if as_bytes == len(candidates):
            genomes = list(candidates)
        elif as_bytes:
            raise ValueError(
                "candidates: expected either genomes as bytes or vectors, not both"
            )
        else:
            genomes = [vector.tobytes() for vector in self._float32(candidates)]
        at_once = max(1, CHECKED_BYTES // max(1, *map(len, genomes)))
        for first in range(
            0, len(genomes), at_once
        ):  # refuses what no server could evaluate
            self.representation.parameters(genomes[first : first + at_once])
        return genomes

    def vectors(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return the vectors of genomes, (n, genes) float32: the inverse of ``genomes``.

        Raises:
            ValueError: the representation's genomes are not plain vectors.
        """
        if self.genes is None:
            kind = self.experiment.representation.kind
            raise ValueError(f"genomes of {kind} are not plain vectors")
        numbers = np.frombuffer(b"".join(genomes), "<f4").astype(np.float32)
        return numbers.reshape(len(genomes), self.genes)

    def _float32(self, candidates: Any) -> np.ndarray:
        if self.genes is None:
            kind = self.experiment.representation.kind
            text = f"genomes of {kind} are not plain vectors: expected a list of bytes"
            raise ValueError(f"candidates: {text}")
        try:
            numbers = np.asarray(candidates)
        except ValueError:
            raise ValueError("candidates: expected vectors of equal length") from None
        if numbers.dtype.kind not in "buif":
            raise ValueError(
                f"candidates: expected real numbers, not an array of {numbers.dtype}"
            )
        if numbers.shape != (len(candidates), self.genes):
            raise ValueError(
                f"candidates: expected shape (n, {self.genes}), not {numbers.shape}"
            )
        with np.errstate(over="ignore"):  # infinite numbers are refused as parameters
            return numbers.astype("<f4")

    def _decisive(self) -> dict[str, object]:
        names = ("problem", "representation", "seed")
        return {name: getattr(self.experiment, name) for name in names}


def check_whole(name: str, value: Any) -> None:
    """Raise an error unless a value is a whole number from 0 to 2^64 - 1."""
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name}: expected a whole number, not {value!r:.60}") from None
    if not 0 <= number < 2**64:
        raise ValueError(
            f"{name}: expected a whole number from 0 to 2^64 - 1, not {number}"
        )
