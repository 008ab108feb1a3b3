"""A run: ask, dispatch, tell, record, until the last generation."""

import getpass
import secrets
import time
from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np

from zswarm import evaluate, experiment, plugins
from zswarm.draws import derive_seed
from zswarm.errors import ConfigError, EvaluationError
from zswarm.experiment import Experiment
from zswarm.nets.representation import Representation
from zswarm.ot.cluster import Cluster, Item
from zswarm.ot.controller import Controller
from zswarm.ot.dispatch import Counted, Disputed, Note, ProbeDisputed, ProbeSettled, Retracted, Settled
from zswarm.ot.local import LocalServer
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.ot.record import Record
from zswarm.ot.requests import Wanted, Who
from zswarm.ot.workload import Workload
from zswarm.protocol import keys, messages
from zswarm.security import keyring
from zswarm.session import Reach
from zswarm.sims.simulator import Simulator
from zswarm.strict import convert
from zswarm.version_hash import version_hash

WAIT_FOR_SERVERS_S = 10.0  # for the number of servers asked for
PREPARING_S = 1.0  # of a server, before the user is told
PAUSE_S = 3.0  # without any server, before the user is told


class Generation(NamedTuple):
    """A generation that ended."""

    generation: int
    best: float
    mean: float
    evaluations: int
    servers: int
    slots: int


class Result(NamedTuple):
    """A run that ended."""

    run: str
    generations: int
    best: float
    evaluations: int
    requeued: int
    history_hash: str
    seconds: float
    faulted: int
    doubtful: int  # trials of a server that was later proved to compute wrong


class Reporter(Protocol):
    """Where a run tells how it goes."""

    def say(self, text: str) -> None:
        """A line for the user."""

    def progress(self, generation: int, counted: int, trials: int) -> None:
        """Trials of a generation that are counted."""

    def generation(self, generation: Generation) -> None:
        """A generation ended."""


class Parts(NamedTuple):
    """What an experiment names, built."""

    simulator: Simulator
    representation: Representation
    optimizer: Optimizer


class Course(NamedTuple):
    """A run under way."""

    complete: Experiment
    parts: Parts
    record: Record
    local: LocalServer | None
    reporter: Reporter
    cluster: Cluster


def build(complete: Experiment) -> Parts:
    """The parts of a complete experiment.

    Raises:
        ConfigError: a part refuses its settings, or they do not fit together.
    """
    problem = complete.problem
    simulator, representation = evaluate.build(
        problem.simulator, problem.settings, complete.representation.kind, complete.representation.settings
    )
    if simulator.participants != 1:
        raise ConfigError(
            f"{problem.simulator} is played by {simulator.participants} participants; a run evolves problems of one"
        )
    loaded = plugins.load("optimizer", complete.optimizer.kind)
    settings = convert(complete.optimizer.settings, loaded.settings_type, "optimizer")
    optimizer = loaded(settings, representation, derive_seed(complete.seed, "optimizer"))
    return Parts(simulator, representation, optimizer)


def reach(options: experiment.Cluster) -> Reach:
    """How a run's servers are reached, with the keys that are installed.

    Raises:
        ConfigError: the keys cannot be used.
    """
    if options.servers == "local":
        return Reach((), multicast=False)
    return Reach(options.connect, options.multicast, options.through_router, keyring.installed("ot"))


def run(
    complete: Experiment, parts: Parts, record: Record, local: LocalServer | None, reach: Reach, reporter: Reporter
) -> Result:
    """Evolve to the last generation, from wherever the record is.

    Raises:
        EvaluationError: trials cannot be evaluated.
        NoServers: the number of servers asked for was not there in time.
    """
    begin = time.monotonic()
    record.say = reporter.say
    resumed = record.resumed()
    if resumed.state is not None:
        parts.optimizer.restore(resumed.state)
        _keep_champion(complete, parts, record)  # the end may have come between a generation and its champion
    history, improved = record.history(), parts.optimizer.best()[1]
    with _cluster(complete, parts, record, local, reach) as cluster:
        course = Course(complete, parts, record, local, reporter, cluster)
        if isinstance(complete.cluster.servers, int):
            for early in cluster.wait(complete.cluster.servers, WAIT_FOR_SERVERS_S):
                _take(early, course)
        for generation in range(resumed.generation, complete.generations):
            genomes = parts.optimizer.ask()
            workload = _workload(complete, parts.simulator, genomes, generation)
            record.begin(generation, workload)
            if generation == resumed.generation:
                record.restore(workload)
            for item in _evaluate(workload, course):
                _take(item, course, workload)
                reporter.progress(generation, int(workload.counted.sum()), len(workload.seeds))
            fitness = _total(workload, complete.problem.trials)
            parts.optimizer.tell(fitness)
            history.add(genomes, fitness)
            statistics = parts.optimizer.statistics()
            record.finish(generation, genomes, fitness, statistics, parts.optimizer.state())
            if parts.optimizer.best()[1] > improved:
                improved = parts.optimizer.best()[1]
                _keep_champion(complete, parts, record)
            if cluster.standing.probe and not record.meta("probe"):
                record.set_meta("probe", cluster.standing.probe)
            reporter.generation(
                Generation(
                    generation, statistics["best"], statistics["mean"], record.evaluations(),
                    len(cluster.standing.serving), cluster.standing.slots,
                )
            )  # fmt: skip
        record.end()
        for late in cluster.rest():
            _take(late, course)
    record.set_meta("history_hash", history.hex())
    return Result(
        str(record.folder), complete.generations, improved, record.evaluations(), record.requeued(), history.hex(),
        round(time.monotonic() - begin, 3), record.faulted(), record.doubtful(),
    )  # fmt: skip


def trial_seeds(complete: Experiment, simulator: Simulator, generation: int) -> np.ndarray:
    """(trials,) uint64: the problem's own where it fixes them; otherwise from the run's seed, and the generation if fresh."""
    count = complete.problem.trials
    if complete.problem.seeds == "fresh":
        seeds = [derive_seed(complete.seed, "trial", trial, generation) for trial in range(count)]
    else:
        fixed = simulator.fixed_seeds(count)
        seeds = list(fixed) if fixed is not None else [derive_seed(complete.seed, "trial", trial) for trial in range(count)]
    return np.array(seeds, np.uint64)


def _workload(complete: Experiment, simulator: Simulator, genomes: list[bytes], generation: int) -> Workload:
    """Every candidate on every trial's seed, candidate after candidate."""
    seeds = trial_seeds(complete, simulator, generation)
    participants = np.repeat(np.arange(len(genomes)), len(seeds)).reshape(-1, 1)
    return Workload(genomes, participants, np.tile(seeds, len(genomes)), len(simulator.metrics))


def _total(workload: Workload, trials: int) -> np.ndarray:
    """(candidates,) float64: the sum over a candidate's trials, added in trial order; never -0.0, which SQLite does not keep."""
    return np.cumsum(workload.fitness[:, 0].reshape(-1, trials), axis=1)[:, -1] + 0.0


def _cluster(complete: Experiment, parts: Parts, record: Record, local: LocalServer | None, reach: Reach) -> Cluster:
    problem, options = complete.problem, complete.cluster
    who = Who(
        options.realm,
        reach.keyring.name if reach.keyring else keys.fold(getpass.getuser()),
        record.meta("run_id"),
        record.meta("epoch"),
        secrets.token_bytes(16),
    )
    wanted = Wanted(
        simulator=messages.Part(problem.simulator, problem.settings),
        representation=messages.Part(complete.representation.kind, complete.representation.settings),
        version_hash=version_hash(problem.simulator, complete.representation.kind),
        participants=parts.simulator.participants,
        metrics=len(parts.simulator.metrics),
        trial_timeout_s=options.trial_timeout_s,
        trial_memory_mb=options.trial_memory_mb,
        slots=min(complete.optimizer.settings.get("population", messages.MAX_SLOTS) * problem.trials, messages.MAX_SLOTS),
        quarantine=options.on_fault == "quarantine",
        verify=options.verify,
        probe=record.meta("probe") or b"",
    )
    return Cluster(
        who,
        wanted,
        reach=reach,
        local=local.endpoint if local is not None else "",
    )


def _take(item: Item | None, course: Course, workload: Workload | None = None) -> None:
    """Do what something that happened asks for; outcomes and disputes are of the workload."""
    record, simulator, representation = course.record, course.parts.simulator, course.parts.representation
    match item:
        case Counted() if workload is not None:
            record.add(item, workload)
        case Disputed() if workload is not None:
            outcomes = evaluate.evaluate(simulator, representation, *workload.batch(np.array([item.trial])))
            course.cluster.settle(Settled(item.trial, outcomes.fitness[0], outcomes.metrics[0]))
        case ProbeDisputed():
            course.cluster.settle(ProbeSettled(evaluate.probe(simulator, representation).digest))
        case Retracted():
            record.retract(item.server)
        case Note():
            _tell(item, course)
        case None:
            record.flush()


def _evaluate(workload: Workload, course: Course) -> Iterator[Item | None]:
    """``cluster.evaluate``, watching that somebody computes."""
    cluster, local, reporter, problem = course.cluster, course.local, course.reporter, course.complete.problem.simulator
    last_served, told = time.monotonic(), ""
    for item in cluster.evaluate(workload):
        yield item
        idle = time.monotonic() - last_served
        if cluster.standing.serving:
            last_served, told = time.monotonic(), ""
        elif local is not None and (words := local.ended()):
            raise EvaluationError(f"the slots of this machine ended: {words}")
        elif (preparing := cluster.standing.preparing) and idle > PREPARING_S and not told:
            told = f"{', '.join(preparing)}: compiling {problem}; done once for this version of zswarm"
            reporter.say(told)
        elif not preparing and idle > PAUSE_S and not told:
            told = "no server computes now: waiting for one (Ctrl-C stops; nothing is lost)"
            reporter.say(told)
            if local is None:
                cluster.diagnose()


TOLD = {
    "diagnosis": "{text}",
    "server_joined": "{server} joined with {slots}",
    "server_left": "{server} left; {text}",
    "server_lost": "{server} is gone",
    "server_back": "{server} is back",
    "server_mismatch": "{server} is not used: {text}",
    "server_refused": "{server} refused: {text}",
    "server_differs": "{server} is not used: {text}",
    "server_faulty": "{server} is put aside for ten minutes: {text}",
    "server_wrong": "{server} is used no more: {text}; what it did in this generation is evaluated again, "
    "and marked as doubtful in earlier ones",
    "unverified": "trials are counted unverified: {text}",
    "server_silent": "{server} does not answer ({text}); it is asked again in a while",
    "lease_lost": "{server}: {text}; reserving anew",
    "lease_waiting": "{server} is busy for others: waiting for a slot",
    "fault": "{server}: {text}",
    "malformed": "{server} sent something that is no answer: {text}",
    "simulator_raised": "the simulator raised on {server}: {text} ({count} trials)",
}


def _tell(note: Note, course: Course) -> None:
    record, reporter, cluster, local = course.record, course.reporter, course.cluster, course.local
    record.note(note)
    if note.event in TOLD:
        slots = f"{note.count} slot{'s' if note.count != 1 else ''}"
        reporter.say(TOLD[note.event].format(server=note.server, text=note.text, count=note.count, slots=slots))
    local_refused = note.event in ("server_refused", "server_mismatch") and local is not None and note.server.startswith("local-")
    if local_refused and not cluster.standing.serving:
        raise EvaluationError(note.text)


def _keep_champion(complete: Experiment, parts: Parts, record: Record) -> None:
    genome, fitness = parts.optimizer.best()
    if not genome:
        return  # no candidate was evaluated without a fault yet
    champion = Controller(
        simulator=complete.problem.simulator,
        simulator_settings=complete.problem.settings,
        representation=complete.representation.kind,
        representation_settings=complete.representation.settings,
        inputs=parts.simulator.inputs,
        outputs=parts.simulator.outputs,
        sensors=list(parts.simulator.sensors),
        actuators=list(parts.simulator.actuators),
        genome=genome,
        fitness=fitness,
        run=record.meta("run_id"),
    )
    record.champion(champion)
