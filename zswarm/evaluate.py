"""Join a network and a simulator: genomes and trials in, outcomes out.

The same code runs in a server's slots and in the optimizer's own tools. What a simulator decides is
an outcome: fitness and metrics, or NaN where it raised, broke its contract or returned a number
that is not finite (always the same NaN). A process that crashes or hangs, and a lack of memory, are
faults, not outcomes: they are detected outside.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from zswarm.config import ranges
from zswarm.config.decode import convert
from zswarm.errors import ConfigError, EvaluationError
from zswarm.kernels.jit import compile_all
from zswarm.kernels.random import Stream, derive_seed
from zswarm.nets.networks import Networks
from zswarm.nets.representation import Representation
from zswarm.plugins import registry as plugins
from zswarm.protocol.messages import (
    PROBE_GENOMES,
    PROBE_SEEDS,
)
from zswarm.sims.raised import error_text, is_outcome
from zswarm.sims.randomized import Varied
from zswarm.sims.simulator import (
    CompiledSimulator,
    HostingSimulator,
    KernelBatch,
    Simulator,
    Turn,
)
from zswarm.sims.turns import (
    BrokenContractError,
    Controllers,
    fill,
    play_turns,
    take_turns,
)

ControllersOf = Callable[[int], Controllers]  # by the index of a trial


class TrialOutcomes(NamedTuple):
    """Outcomes of trials, in their order; of the first ones, if ``spoiled`` ended the batch."""

    fitness: np.ndarray  # (trials, participants) float64
    metrics: np.ndarray  # (trials, metrics) float64
    error: str  # of the first trial whose fitness is NaN, or ""


class _Played(NamedTuple):
    """How many trials were played, from the first one on."""

    error: str  # of the first trial that failed, or ""
    trials: int
    spoiled: bool = False  # the process is not to play others


def build(
    simulator: str,
    settings: Mapping[str, Any],
    representation: str,
    representation_settings: Mapping[str, Any],
    *,
    hosting: bool = True,
    in_slot: bool = False,
) -> tuple[Simulator, Representation]:
    """Build a simulator and the representation of its controllers, from names and settings.

    Args:
        settings: of the simulator; each trial draws from the ranges in them.
        hosting: let a simulator that can run the network do so.
        in_slot: let trials drive what a file of this machine names, such as robots.

    Raises:
        ConfigError: unknown name or impossible settings, or the simulator refused them.
        EvaluationError: the simulator's program ended.
        MemoryError: there is not enough for it.
    """
    simulator_class = plugins.load("simulator", simulator)
    representation_class = plugins.load("representation", representation)
    # Until the first simulator says how many inputs it has.
    network: Representation | None = None

    def simulator_with(plain: Mapping[str, Any]) -> Simulator:
        what = f"simulator {simulator!r}"
        made: Simulator = _construct(what, simulator_class, plain, "problem.settings")
        if in_slot:
            made.use_machine()
        if network is not None and hosting:
            return _hosting(made, network, representation)
        return made

    if ranges.found(settings):
        settings = ranges.complete(
            settings, simulator_class.settings_type, "problem.settings"
        )
        built: Simulator = Varied(settings, simulator_with)
    else:
        built = simulator_with(settings)
    made: Representation = _construct(
        f"representation {representation!r}",
        representation_class,
        representation_settings,
        "representation",
        *(built.inputs, built.outputs),
    )
    network = made
    return _hosting(built, made, representation) if hosting else built, made


def _hosting(simulator: Simulator, network: Representation, kind: str) -> Simulator:
    """Let the simulator run the network itself if it can."""
    if isinstance(simulator, HostingSimulator):
        settings = msgspec.to_builtins(network.settings)
        if simulator.host(kind, settings):
            simulator.hosted = network
    return simulator


def _construct(
    what: str, loaded: Any, settings: Mapping[str, Any], where: str, *sizes: int
) -> Any:
    configured = convert(settings, loaded.settings_type, where)
    try:
        return loaded(configured, *sizes)
    except (ConfigError, EvaluationError, MemoryError):
        raise
    except (Exception, SystemExit) as error:  # a plug-in's constructor may raise anything
        raise ConfigError(
            f"{what} cannot be set up: {type(error).__name__}: {error}"
        ) from error


class _Assignment(NamedTuple):
    """Trials and who plays them."""

    simulator: Simulator
    representation: Representation
    genomes: Sequence[bytes]
    batch: KernelBatch
    remote: ControllersOf | None
    spoiled: Callable[[], bool]

    def of(self, trials: slice | list[int]) -> KernelBatch:
        """Return some of the trials as a batch with its own progress; a slice fills this one."""
        batch = self.batch
        return batch._replace(
            participants=batch.participants[trials],
            seeds=batch.seeds[trials],
            progress=np.zeros(2, np.int64),
            fitness=batch.fitness[trials],
            metrics=batch.metrics[trials],
        )


def evaluate(
    simulator: Simulator,
    representation: Representation,
    genomes: Sequence[bytes],
    participants: np.ndarray,
    seeds: np.ndarray,
    progress: np.ndarray | None = None,
    remote: ControllersOf | None = None,
    spoiled: Callable[[], bool] = lambda: False,
) -> TrialOutcomes:
    """Play trials in order.

    Args:
        participants: (trials, simulator.participants) int64, indices into genomes.
        seeds: (trials,) uint64.
        progress: (2,) int64, shared with a watcher: [0] is set to the index of the trial that runs,
            or of the first of those that run in parallel; not zero in [1] ends the batch before the
            next one (the outcomes are then worthless).
        remote: returns what decides in a trial instead of the genomes' networks; the trial is
            played in turns.
        spoiled: called after each trial that Python code plays; true ends the batch there.

    Raises:
        ValueError: a genome does not fit the network, or a shape or index does not fit.
        EvaluationError: the simulator's program ended in the trial that ``progress[0]`` names.
        MemoryError: there is not enough for the trial that ``progress[0]`` names.
    """
    expected = len(seeds), simulator.participants
    if participants.shape != expected:
        raise ValueError(f"participants must be {expected}, not {participants.shape}")
    if len(seeds) and not 0 <= participants.min() <= participants.max() < len(genomes):
        raise ValueError(f"a participant is not among the {len(genomes)} genomes")
    if remote is None and len(seeds):
        parameters = representation.parameters(genomes)
    else:
        parameters = np.empty((len(genomes), 0), np.float32)
    batch = KernelBatch(
        state_size=representation.state_size,
        parameters=parameters,
        participants=participants,
        seeds=seeds.astype(np.uint64),
        progress=np.zeros(2, np.int64) if progress is None else progress,
        fitness=np.full(expected, np.nan),
        metrics=np.full((len(seeds), len(simulator.metrics)), np.nan),
    )
    trials = _Assignment(simulator, representation, genomes, batch, remote, spoiled)
    played = _Played("", 0)
    if isinstance(simulator, Varied):
        played = _play_varied(simulator, trials)
    elif len(seeds):
        played = _play_alike(trials)
    count = played.trials
    return TrialOutcomes(batch.fitness[:count], batch.metrics[:count], played.error)


def _play_alike(trials: _Assignment) -> _Played:
    """Play trials of one simulator, in its kernel or each alone."""
    batch = trials.batch
    played = _play_batch(trials) or _play_each(trials)
    finite = np.isfinite(batch.fitness)
    if not finite.all():
        failed = np.flatnonzero(~finite[: played.trials].all(axis=1))
        if len(failed) and not played.error and not batch.progress[1]:
            numbers = batch.fitness[failed[0]].tolist()
            broken = BrokenContractError(f"fitness must be finite, not {numbers}")
            error = error_text(trials.simulator, batch.seeds[failed[0]], broken)
            played = played._replace(error=error)
        batch.fitness[~finite] = np.nan
    batch.metrics[~np.isfinite(batch.metrics)] = np.nan
    return played


def _play_batch(trials: _Assignment) -> _Played | None:
    """Play all trials in one kernel; return None where each must be played alone."""
    if trials.remote is not None or not isinstance(trials.simulator, CompiledSimulator):
        return None
    try:
        _call_kernel(trials.simulator, trials.representation, trials.batch)
    except BaseException as raised:
        if not is_outcome(raised):
            raise
        return None  # which trial raised shows when each is played alone
    return _Played("", len(trials.batch.seeds))


def _play_each(trials: _Assignment) -> _Played:
    """Play trials one after the other, up to one that leaves something behind."""
    batch, error = trials.batch, ""
    for trial, seed in enumerate(batch.seeds):
        batch.progress[0] = trial
        if batch.progress[1]:
            break
        try:
            _play_one(trials, trial)
        except BaseException as raised:
            if not is_outcome(raised):
                raise
            batch.fitness[trial], batch.metrics[trial] = np.nan, np.nan
            error = error or error_text(trials.simulator, seed, raised)
        if trials.spoiled():
            return _Played(error, trial + 1, spoiled=True)
    return _Played(error, len(batch.seeds))


def _play_one(trials: _Assignment, trial: int) -> None:
    simulator, network, batch = trials.simulator, trials.representation, trials.batch
    seed, players = int(batch.seeds[trial]), batch.participants[trial]
    filled = batch.fitness[trial], batch.metrics[trial]
    if trials.remote is not None:
        play_turns(simulator, trials.remote(trial), seed, *filled)
    elif isinstance(simulator, CompiledSimulator):
        _call_kernel(simulator, network, trials.of(slice(trial, trial + 1)))
    elif isinstance(simulator, HostingSimulator) and simulator.hosted is network:
        genomes = [trials.genomes[player] for player in players]
        fill(simulator.play_alone(genomes, seed), *filled)
    else:
        play_turns(simulator, Networks(network, batch.parameters[players]), seed, *filled)


def _play_varied(varied: Varied, trials: _Assignment) -> _Played:
    """Play trials with the same settings together; in a kernel for some milliseconds at once.

    Starting a kernel costs as much as a short trial, and some kernels play eight trials in
    parallel. A spoiled process ends it; what was played after a trial that was not is dropped.
    """
    batch, error = trials.batch, ""
    waiting = np.ones(len(batch.seeds), bool)
    for alike in varied.alike(batch.seeds.tolist()):
        played, seed = 0, int(batch.seeds[alike[0]])
        while played < len(alike):
            first = batch.progress[0] = alike[played]
            if batch.progress[1]:
                return _Played(error, len(batch.seeds))
            try:
                simulator = varied.of(seed)
            except ConfigError as refused:  # an outcome, like any error of a simulator
                error = error or error_text(varied.first, seed, refused)
                waiting[alike[played:]] = False
                break
            in_kernel = isinstance(simulator, CompiledSimulator) and trials.remote is None
            some = alike[played : played + (varied.together if in_kernel else 1)]
            part = trials._replace(
                simulator=simulator,
                batch=trials.of(some),
                remote=trials.remote and _of_trial(trials.remote, first),
            )
            begin = time.process_time()
            found = _play_alike(part)
            varied.took(time.process_time() - begin)
            batch.fitness[some] = part.batch.fitness
            batch.metrics[some] = part.batch.metrics
            error = error or found.error
            played += len(some)
            waiting[some] = False
            if found.spoiled:
                return _Played(
                    error, int(np.append(waiting, True).argmax()), spoiled=True
                )
    return _Played(error, len(batch.seeds))


def _of_trial(remote: ControllersOf, trial: int) -> ControllersOf:
    return lambda _: remote(trial)


def _call_kernel(
    simulator: CompiledSimulator, network: Representation, batch: KernelBatch
) -> None:
    if network.step_lanes is None:
        simulator.play(network.step, batch)
    else:
        simulator.play_lanes(network.step_lanes, network.step, batch)


def warm_up(
    simulator: Simulator, representation: Representation, *, in_turns: bool = False
) -> TrialOutcomes:
    """Compile or load all that a trial needs, and return the outcomes of the probe's first trial.

    A trial that is played in turns needs no kernel.
    """
    if not in_turns:
        compile_all()
    return play_probe(simulator, representation, slice(1), in_turns=in_turns)


def play_probe(
    simulator: Simulator, network: Representation, some: slice, *, in_turns: bool
) -> TrialOutcomes:
    """Return the outcomes of some trials of the probe."""
    genomes = network.random(PROBE_GENOMES, Stream(derive_seed(0, "probe")))
    first = np.repeat(np.arange(PROBE_GENOMES), PROBE_SEEDS)[some]
    participants = (first[:, None] + np.arange(simulator.participants)) % PROBE_GENOMES
    each = [derive_seed(0, "probe", seed) for seed in range(PROBE_SEEDS)]
    seeds = np.array(each * PROBE_GENOMES, np.uint64)[some]
    parameters = network.parameters(genomes)

    def controllers(trial: int) -> Controllers:
        return Networks(network, parameters[participants[trial]])

    remote = controllers if in_turns else None
    return evaluate(simulator, network, genomes, participants, seeds, remote=remote)


def turns(
    simulator: Simulator,
    representation: Representation,
    parameters: np.ndarray,
    seed: int,
) -> Iterator[Turn]:
    """Play a trial, and yield each turn before its agents act.

    Args:
        parameters: (participants, P) float32.
    """
    return take_turns(simulator, Networks(representation, parameters), seed)
