"""Joins a network and a simulator: genomes and trials in, outcomes out.

The same code runs in a server's slots and in the optimizer's own tools. What a simulator decides is an outcome: fitness
and metrics, or NaN where it raised, broke its contract or returned a number that is not finite (always the same NaN). A process
that ends or hangs is a fault and shows outside, as does a lack of memory.
"""

import hashlib
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np

from zswarm import plugins, ranges
from zswarm.draws import Stream, derive_seed
from zswarm.errors import ConfigError, EvaluationError
from zswarm.nets.networks import Networks
from zswarm.nets.representation import Representation
from zswarm.protocol.messages import PROBE_GENOMES, PROBE_SEEDS
from zswarm.sims.simulator import MAX_TURNS, Batch, CompiledSimulator, HostingSimulator, Outcome, Simulator, Turn
from zswarm.strict import convert
from zswarm.varied import Varied

MAX_ERROR_TEXT = 300


class Outcomes(NamedTuple):
    """Outcomes of trials, in their order."""

    fitness: np.ndarray  # (trials, participants) float64
    metrics: np.ndarray  # (trials, metrics) float64
    error: str  # what was wrong with the first trial whose fitness is NaN, or ""


class Controllers(Protocol):
    """Decides for the agents of one trial."""

    def decide(self, agents: Sequence[int], participants: Sequence[int], observations: np.ndarray) -> np.ndarray:
        """See ``Networks``."""


class BrokenContractError(Exception):
    """A simulator did not do what ``Simulator`` asks for; the text says what was expected, and what came."""


class Probe(NamedTuple):
    """What a machine makes of the trials that all play."""

    digest: bytes  # of the outcomes
    trial_s: float  # time of one of the trials


def build(
    simulator: str,
    settings: Mapping[str, Any],
    representation: str,
    representation_settings: Mapping[str, Any],
    *,
    hosting: bool = True,
) -> tuple[Simulator, Representation]:
    """A simulator and the representation of its controllers, from names and settings.

    Args:
        settings: of the simulator; a range in them is drawn from in each trial.
        hosting: a simulator that can decide for the network itself does so.

    Raises:
        ConfigError: unknown name or impossible settings, or the simulator refused them.
        EvaluationError: the simulator's program ended.
        MemoryError: there is not enough for it.
    """
    simulator_class = plugins.load("simulator", simulator)
    representation_class = plugins.load("representation", representation)
    network: Representation | None = None  # until a first simulator says how many inputs it has

    def simulator_with(plain: Mapping[str, Any]) -> Simulator:
        configured = convert(plain, simulator_class.settings_type, "problem.settings")
        made: Simulator = _construct(f"simulator {simulator!r}", simulator_class, configured)
        return made if network is None or not hosting else _hosting(made, network, representation)

    if ranges.found(settings):
        built: Simulator = Varied(ranges.complete(settings, simulator_class.settings_type, "problem.settings"), simulator_with)
    else:
        built = simulator_with(settings)
    network_settings = convert(representation_settings, representation_class.settings_type, "representation")
    network = _construct(
        f"representation {representation!r}", representation_class, network_settings, built.inputs, built.outputs
    )
    assert network is not None  # noqa: S101  it was constructed
    return _hosting(built, network, representation) if hosting else built, network


def _hosting(simulator: Simulator, network: Representation, kind: str) -> Simulator:
    """A simulator that decides for the network itself if it can."""
    if isinstance(simulator, HostingSimulator) and simulator.host(kind, msgspec.to_builtins(network.settings)):
        simulator.hosted = network
    return simulator


def _construct(what: str, loaded: Any, *arguments: Any) -> Any:
    try:
        return loaded(*arguments)
    except (ConfigError, EvaluationError, MemoryError):
        raise
    except (Exception, SystemExit) as error:  # a plug-in's constructor may raise anything
        raise ConfigError(f"{what} cannot be set up: {type(error).__name__}: {error}") from error


def evaluate(
    simulator: Simulator,
    representation: Representation,
    genomes: Sequence[bytes],
    participants: np.ndarray,
    seeds: np.ndarray,
    progress: np.ndarray | None = None,
    elsewhere: Callable[[int], Controllers] | None = None,
) -> Outcomes:
    """Play trials in order.

    Args:
        participants: (trials, simulator.participants) int64, indices into genomes.
        seeds: (trials,) uint64.
        progress: (2,) int64, shared with a watcher: [0] is set to the index of the trial that runs, or of the first of some that
            run side by side, and not zero in [1] ends the batch before the next one (the outcomes are then worthless).
        elsewhere: gives what decides in a trial, by its index, instead of the genomes' networks; it is played in turns.

    Raises:
        ValueError: a genome does not fit the network, or a shape or index does not fit.
        EvaluationError: the simulator's program ended in the trial that ``progress[0]`` names.
        MemoryError: there is not enough for the trial that ``progress[0]`` names.
    """
    if participants.shape != (len(seeds), simulator.participants):
        raise ValueError(f"participants must be ({len(seeds)}, {simulator.participants}), not {participants.shape}")
    if participants.size and not 0 <= participants.min() <= participants.max() < len(genomes):
        raise ValueError(f"a participant is not among the {len(genomes)} genomes")
    if not len(seeds):
        return Outcomes(np.empty(participants.shape), np.empty((0, len(simulator.metrics))), "")
    parameters = representation.parameters(genomes) if elsewhere is None else np.empty((len(genomes), 0), np.float32)
    progress = np.zeros(2, np.int64) if progress is None else progress
    if isinstance(simulator, Varied):
        return _varied(simulator, representation, genomes, parameters, participants, seeds, progress, elsewhere)
    return _outcomes(simulator, representation, genomes, parameters, participants, seeds, progress, elsewhere)


def _outcomes(
    simulator: Simulator,
    representation: Representation,
    genomes: Sequence[bytes],
    parameters: np.ndarray,
    participants: np.ndarray,
    seeds: np.ndarray,
    progress: np.ndarray,
    elsewhere: Callable[[int], Controllers] | None,
) -> Outcomes:
    fitness = np.full(participants.shape, np.nan)
    metrics = np.full((len(seeds), len(simulator.metrics)), np.nan)
    error = ""
    batch = Batch(representation.state_size, parameters, participants, seeds.astype(np.uint64), progress, fitness, metrics)
    one_by_one = elsewhere is not None or not isinstance(simulator, CompiledSimulator)
    if isinstance(simulator, CompiledSimulator) and elsewhere is None:
        try:
            _play(simulator, representation, batch)
        except BaseException as raised:
            if not _decided(raised):
                raise
            one_by_one = True  # each trial by itself tells of which it was, whatever they are beside
    if one_by_one:
        for trial, seed in enumerate(seeds):
            progress[0] = trial
            if progress[1]:
                break
            try:
                if elsewhere is not None:
                    _play_with(elsewhere(trial), simulator, int(seed), fitness[trial], metrics[trial])
                    continue
                if isinstance(simulator, CompiledSimulator):
                    _play(simulator, representation, _alone(batch, trial))
                    continue
                if isinstance(simulator, HostingSimulator) and simulator.hosted is representation:
                    players = [genomes[each] for each in participants[trial]]
                    play_alone(simulator, players, int(seed), fitness[trial], metrics[trial])
                    continue
                play_in_turns(
                    simulator,
                    representation,
                    parameters[participants[trial]],
                    int(seed),
                    fitness[trial],
                    metrics[trial],
                )
            except BaseException as raised:
                if not _decided(raised):
                    raise
                fitness[trial], metrics[trial] = np.nan, np.nan
                error = error or _in_words(simulator, seed, raised)
    failed = np.flatnonzero(~np.isfinite(fitness).all(axis=1))
    if not error and len(failed) and not progress[1]:
        trial = int(failed[0])
        error = _in_words(simulator, seeds[trial], BrokenContractError(f"fitness must be finite, not {fitness[trial].tolist()}"))
    fitness[~np.isfinite(fitness)] = np.nan
    metrics[~np.isfinite(metrics)] = np.nan
    return Outcomes(fitness, metrics, error)


def _varied(
    varied: Varied,
    representation: Representation,
    genomes: Sequence[bytes],
    parameters: np.ndarray,
    participants: np.ndarray,
    seeds: np.ndarray,
    progress: np.ndarray,
    elsewhere: Callable[[int], Controllers] | None,
) -> Outcomes:
    """Trials with the same settings one after another; in a kernel as many at once as take some milliseconds.

    A kernel's start costs as much as a short trial, and some kernels play eight of a batch side by side.
    """
    fitness = np.full(participants.shape, np.nan)
    metrics = np.full((len(seeds), len(varied.metrics)), np.nan)
    error = ""
    for alike in varied.alike(seeds.tolist()):
        played = 0
        while played < len(alike):
            progress[0] = alike[played]
            if progress[1]:
                return Outcomes(fitness, metrics, error)
            try:
                simulator = varied.of(int(seeds[alike[0]]))
            except ConfigError as refused:  # an outcome, as whatever a simulator raises
                error = error or _in_words(varied.first, seeds[alike[0]], refused)
                break
            together = varied.together if isinstance(simulator, CompiledSimulator) and elsewhere is None else 1
            some = alike[played : played + together]
            begin = time.process_time()
            alone, there = np.zeros(2, np.int64), elsewhere and _of_trial(elsewhere, some[0])
            part = _outcomes(simulator, representation, genomes, parameters, participants[some], seeds[some], alone, there)
            varied.took(time.process_time() - begin)
            fitness[some], metrics[some], error = part.fitness, part.metrics, error or part.error
            played += len(some)
    return Outcomes(fitness, metrics, error)


def _of_trial(elsewhere: Callable[[int], Controllers], trial: int) -> Callable[[int], Controllers]:
    return lambda _: elsewhere(trial)


def _play(simulator: CompiledSimulator, representation: Representation, batch: Batch) -> None:
    if representation.step_lanes is None:
        simulator.play(representation.step, batch)
    else:
        simulator.play_lanes(representation.step_lanes, representation.step, batch)


def _alone(batch: Batch, trial: int) -> Batch:
    """A trial of a batch as a batch of its own, which tells nobody how far it is."""
    one = slice(trial, trial + 1)
    return batch._replace(
        participants=batch.participants[one],
        seeds=batch.seeds[one],
        progress=np.zeros(2, np.int64),
        fitness=batch.fitness[one],
        metrics=batch.metrics[one],
    )


def _decided(raised: BaseException) -> bool:
    """Whether it is a simulator's decision, and so the trial's outcome, as is all that its code raises.

    Not so the machine's faults and limits, and Ctrl-C, which no slot hears.
    """
    if isinstance(raised, KeyboardInterrupt):
        return signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    return not isinstance(raised, (EvaluationError, MemoryError))


def _in_words(simulator: Simulator, seed: int, raised: BaseException) -> str:
    """What was wrong with a trial."""
    what = str(raised) if isinstance(raised, BrokenContractError) else f"{type(raised).__name__}: {raised}"
    if not isinstance(raised, Exception):
        what += " (a simulator ends a trial by returning None, and never its process)"
    return f"{type(simulator).__name__}, trial seed {seed}: {what}"[:MAX_ERROR_TEXT]


def warm_up(simulator: Simulator, representation: Representation, *, in_turns: bool = False) -> None:
    """Compile or load all that a trial needs; in turns that is no kernel."""
    _play_probe(simulator, representation, slice(1), in_turns=in_turns)


def probe(simulator: Simulator, representation: Representation, *, in_turns: bool = False) -> Probe:
    """Play the trials that every machine plays, to compare: four random genomes, each on two seeds. Warms up, too."""
    first = _play_probe(simulator, representation, slice(1), in_turns=in_turns)
    begin = time.perf_counter()
    rest = _play_probe(simulator, representation, slice(1, None), in_turns=in_turns)
    elapsed = time.perf_counter() - begin
    digest = hashlib.blake2b(digest_size=16)
    for outcomes in (first, rest):
        digest.update(outcomes.fitness.astype("<f8").tobytes() + outcomes.metrics.astype("<f8").tobytes())
    return Probe(digest.digest(), elapsed / len(rest.fitness))


def _play_probe(simulator: Simulator, representation: Representation, some: slice, *, in_turns: bool) -> Outcomes:
    genomes = representation.random(PROBE_GENOMES, Stream(derive_seed(0, "probe")))
    participants = np.array(
        [
            [(genome + i) % PROBE_GENOMES for i in range(simulator.participants)]
            for genome in range(PROBE_GENOMES)
            for _ in range(PROBE_SEEDS)
        ]
    )[some]
    seeds = np.array([derive_seed(0, "probe", trial % PROBE_SEEDS) for trial in range(PROBE_GENOMES * PROBE_SEEDS)], np.uint64)
    parameters = representation.parameters(genomes)
    here = (lambda trial: Networks(representation, parameters[participants[trial]])) if in_turns else None
    return evaluate(simulator, representation, genomes, participants, seeds[some], elsewhere=here)


def play_in_turns(
    simulator: Simulator,
    representation: Representation,
    parameters: np.ndarray,
    seed: int,
    fitness: np.ndarray,
    metrics: np.ndarray,
) -> None:
    """One trial through the simulator's turns.

    Args:
        parameters: (participants, P) float32.
        fitness: (participants,) float64, filled.
        metrics: (metrics,) float64, filled.
    """
    _play_with(Networks(representation, parameters), simulator, seed, fitness, metrics)


def _play_with(controllers: Controllers, simulator: Simulator, seed: int, fitness: np.ndarray, metrics: np.ndarray) -> None:
    for _ in _turns(simulator, controllers, seed):
        pass
    _take(simulator.outcome(), fitness, metrics)


def play_alone(
    simulator: HostingSimulator, genomes: Sequence[bytes], seed: int, fitness: np.ndarray, metrics: np.ndarray
) -> None:
    """One trial whose simulator decides for the controllers.

    Args:
        genomes: of the participants.
        fitness: (participants,) float64, filled.
        metrics: (metrics,) float64, filled.
    """
    _take(simulator.play_alone(genomes, seed), fitness, metrics)


def _take(outcome: Outcome, fitness: np.ndarray, metrics: np.ndarray) -> None:
    if not isinstance(outcome, Outcome):
        raise BrokenContractError(f"outcome must return an Outcome, not {outcome!r:.80}")
    if len(outcome.fitness) != len(fitness) or len(outcome.metrics) != len(metrics):
        raise BrokenContractError(
            f"an outcome must have {len(fitness)} fitness numbers and {len(metrics)} metrics, "
            f"not {len(outcome.fitness)} and {len(outcome.metrics)}"
        )
    fitness[:] = outcome.fitness
    metrics[:] = outcome.metrics


def turns(simulator: Simulator, representation: Representation, parameters: np.ndarray, seed: int) -> Iterator[Turn]:
    """Play a trial; yields each turn before its agents act.

    Args:
        parameters: (participants, P) float32.
    """
    return _turns(simulator, Networks(representation, parameters), seed)


def _turns(simulator: Simulator, controllers: Controllers, seed: int) -> Iterator[Turn]:
    turn: Turn | None = simulator.reset(seed)
    if turn is None:
        raise BrokenContractError("reset must return a Turn: somebody must act")
    owners = simulator.owners  # only now: they may differ by trial
    for _ in range(MAX_TURNS):
        yield turn
        observations = _observations(simulator, turn)
        if not all(0 <= agent < len(owners) for agent in turn.agents):
            raise BrokenContractError(f"agents must be in {range(len(owners))}, not {list(turn.agents)}")
        turn = simulator.step(controllers.decide(turn.agents, [owners[agent] for agent in turn.agents], observations))
        if turn is None:
            return
    raise BrokenContractError(f"the trial goes on after {MAX_TURNS:,} turns: step must return None when it is over")


def _observations(simulator: Simulator, turn: Turn) -> np.ndarray:
    """Those of a turn, checked: (agents, inputs) float32."""
    if not isinstance(turn, Turn):
        raise BrokenContractError(f"reset and step must return a Turn, and step None at the end; not {turn!r:.80}")
    if not len(turn.agents):
        raise BrokenContractError("a turn must name an agent; a trial that is over returns None")
    observations = np.ascontiguousarray(turn.observations, np.float32)
    if observations.shape != (len(turn.agents), simulator.inputs):
        raise BrokenContractError(f"observations must be ({len(turn.agents)}, {simulator.inputs}), not {observations.shape}")
    if not np.isfinite(observations).all():
        row, number = np.argwhere(~np.isfinite(observations))[0]
        name = f" ({simulator.sensors[number]})" if simulator.sensors else ""
        agent, value = turn.agents[row], observations[row, number]
        raise BrokenContractError(f"observations must be finite; number {number}{name} of agent {agent} is {value}")
    return observations
