"""A run: ask, dispatch, tell, record, until the last generation."""

import contextlib
import threading
import time
from collections.abc import Generator, Iterator
from typing import NamedTuple

import msgspec

from zswarm import plugins
from zswarm.controller import Controller
from zswarm.draws import derive_seed
from zswarm.errors import ConfigError, ZswarmError
from zswarm.experiment import Experiment
from zswarm.ot.assessment import Assessment
from zswarm.ot.connection import Connection
from zswarm.ot.dispatch import Counted, Note, Retracted
from zswarm.ot.evaluations import Evaluations, Happened
from zswarm.ot.logger import Generation, Logger, Result, Started
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.ot.problem import Problem
from zswarm.ot.record import Record
from zswarm.ot.workload import Workload
from zswarm.protocol import messages
from zswarm.strict import convert


class Parts(NamedTuple):
    """What an experiment names, built."""

    problem: Problem
    optimizer: Optimizer


def build(complete: Experiment) -> Parts:
    """The parts of a complete experiment.

    Raises:
        ConfigError: a part refuses its settings, or they do not fit together.
    """
    problem = Problem(complete)
    kind, simulator = complete.optimizer.kind, problem.simulator
    loaded = plugins.load("optimizer", kind)
    settings = convert(complete.optimizer.settings, loaded.settings_type, "optimizer")
    optimizer: Optimizer = loaded(settings, problem.representation, derive_seed(complete.seed, "optimizer"))
    for name in optimizer.measures:
        if name not in simulator.metrics:
            known = ", ".join(simulator.metrics) or "none"
            raise ConfigError(f"optimizer: measures: {complete.problem.simulator} has no metric {name!r}; it has: {known}")
    if problem.ranking.relative and not optimizer.competes:
        raise ConfigError(
            f"optimizer: {kind} compares fitness from generation to generation, and scores of {complete.ranking.kind} compare "
            f"within one; those that take them: {', '.join(_competing())}"
        )
    optimizer.relative = problem.ranking.relative
    if optimizer.candidates is not None and optimizer.candidates < simulator.participants:
        raise ConfigError(
            f"optimizer: {kind} asks for {optimizer.candidates} candidates, and a game of {complete.problem.simulator} takes "
            f"{simulator.participants}"
        )
    return Parts(problem, optimizer)


def _competing() -> list[str]:
    """Optimizers that take fitness which compares within a generation only; of those installed that can be imported."""
    found = []
    for name in plugins.names("optimizer"):
        with contextlib.suppress(ZswarmError):
            found += [name] * plugins.load("optimizer", name).competes
    return found


def evolve(
    parts: Parts, record: Record, connection: Connection, logger: Logger, stop: threading.Event
) -> Generator[Generation, None, Result]:
    """Evolve to the last generation, from wherever the record is; yields each generation once it is recorded.

    Servers have the next one by then: it is evaluated while this one is recorded and whoever iterates looks at it.

    Args:
        stop: ends the run within a moment when it is set; closing the generator ends it, too. Nothing is lost.

    Raises:
        EvaluationError: trials cannot be evaluated.
        NoServers: the number of servers asked for was not there in time.
        Stopped: ``stop`` was set.
    """
    begin = time.monotonic()
    (problem, optimizer), complete = parts, parts.problem.experiment
    record.say = logger.on_say
    run_id, probe, resumed = record.meta("run_id"), record.meta("probe") or b"", record.resumed()
    if resumed.state is not None:
        optimizer.restore(resumed.state, record.told())
        if optimizer.best()[0]:
            _keep_champion(parts, record, run_id)  # the end may have come between a generation and its champion
    history, improved, candidates = record.history(), optimizer.best()[1], record.evaluations()
    record.note(Note("began", count=record.meta("epoch")))
    logger.on_start(Started(record.folder, complete, resumed.generation))
    logger.on_say(f"{complete.name}: {connection.who_computes()}")
    if (asked := connection.options).controller == "optimizer":
        logger.on_say(f"the controllers stay in this program: servers ask it, a question for each {asked.messages}")
    if optimizer.strayed is not None:
        otherwise = f"would have proposed other candidates from generation {optimizer.strayed} on"
        logger.on_say(f"{complete.optimizer.kind} {otherwise}; it goes on from those that were recorded")
    evaluations = Evaluations(
        problem,
        connection,
        run=run_id,
        epoch=record.meta("epoch"),
        slots=problem.trials_at_once(optimizer.candidates) or messages.MAX_SLOTS,
        probe=probe,
        logger=logger,
        stop=stop,
    )
    with evaluations:
        for early in evaluations.wait():
            _record(early, record)
        if resumed.generation < complete.generations:
            assessment = Assessment(problem, optimizer.ask(), resumed.generation)
            record.begin(resumed.generation, assessment.workload)
            if not optimizer.portable and (others := record.forget_others()):
                logger.on_say(f"generation {resumed.generation} was begun with other candidates: {others} trials are forgotten")
            record.restore(assessment.workload)
            happening = evaluations.evaluate(assessment.workload)
        for generation in range(resumed.generation, complete.generations):
            for happened in _rounds(assessment, happening, evaluations, record, resumed.generation):
                workload = assessment.workload
                _record(happened, record, workload)
                logger.on_progress(generation, workload.first + int(workload.counted.sum()), workload.first + len(workload.seeds))
            genomes, fitness = assessment.genomes, assessment.fitness()
            measures = assessment.measures(optimizer.measures)
            optimizer.tell(fitness, measures)
            state = msgspec.Raw(msgspec.msgpack.encode(optimizer.state()))  # as it is before the next ask
            last = generation + 1 == complete.generations
            if not last:  # the servers have work while this generation is recorded and told
                assessment = Assessment(problem, optimizer.ask(), generation + 1)
                happening = evaluations.evaluate(assessment.workload)
            history.add(genomes, fitness, measures)
            statistics = optimizer.statistics()
            record.finish(generation, genomes, fitness, statistics, state, measures)
            genome, best = optimizer.best()
            if best > improved or (optimizer.relative and genome):  # scores of two generations do not compare
                improved = best
                logger.on_champion(_keep_champion(parts, record, run_id))
            if evaluations.probe and not probe:
                probe = evaluations.probe
                record.set_meta("probe", probe)
            candidates += len(genomes)
            ended = Generation(
                generation, statistics["best"], statistics["mean"], candidates, evaluations.servers, evaluations.slots,
                statistics,
            )  # fmt: skip
            logger.on_generation(ended)
            yield ended
            if not last:
                record.begin(generation + 1, assessment.workload)
        record.end()
        for late in evaluations.rest():
            _record(late, record)
    record.set_meta("history_hash", history.hex())
    return Result(
        str(record.folder), complete.generations, optimizer.best()[1], candidates, record.requeued(), history.hex(),
        round(time.monotonic() - begin, 3), record.faulted(), record.doubtful(), optimizer.relative,
    )  # fmt: skip


def _rounds(
    assessment: Assessment, happening: Iterator[Happened | None], evaluations: Evaluations, record: Record, resumed: int
) -> Iterator[Happened | None]:
    """What happens in all rounds of a generation; what was recorded of the one resumed is not played again."""
    yield from happening
    while assessment.advance():
        record.begin(assessment.generation, assessment.workload)
        if assessment.generation == resumed:
            record.restore(assessment.workload)
        yield from evaluations.evaluate(assessment.workload)


def _record(happened: Happened | None, record: Record, workload: Workload | None = None) -> None:
    """Outcomes are of the workload."""
    match happened:
        case Counted() if workload is not None:
            record.add(happened, workload)
        case Retracted():
            record.retract(happened.server)
        case Note():
            record.note(happened)
        case None:
            record.flush()


def _keep_champion(parts: Parts, record: Record, run_id: str) -> Controller:
    champion = parts.problem.controller(*parts.optimizer.best(), run_id)
    record.champion(champion)
    return champion
