"""A run: ask, dispatch, tell, record, until the last generation."""

import threading
import time
from collections.abc import Generator
from typing import NamedTuple

import msgspec

from zswarm import plugins
from zswarm.draws import derive_seed
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.connection import Connection
from zswarm.ot.controller import Controller
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
    loaded = plugins.load("optimizer", complete.optimizer.kind)
    settings = convert(complete.optimizer.settings, loaded.settings_type, "optimizer")
    optimizer = loaded(settings, problem.representation, derive_seed(complete.seed, "optimizer"))
    for name in optimizer.measures:
        if name not in problem.simulator.metrics:
            known = ", ".join(problem.simulator.metrics) or "none"
            raise ConfigError(f"optimizer: measures: {complete.problem.simulator} has no metric {name!r}; it has: {known}")
    return Parts(problem, optimizer)


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
    logger.on_start(Started(record.folder, complete, resumed.generation))
    logger.on_say(f"{complete.name}: {connection.who_computes()}")
    evaluations = Evaluations(
        problem,
        connection,
        run=run_id,
        epoch=record.meta("epoch"),
        slots=(optimizer.candidates or messages.MAX_SLOTS) * complete.problem.trials,
        probe=probe,
        logger=logger,
        stop=stop,
    )
    with evaluations:
        for early in evaluations.wait():
            _record(early, record)
        if resumed.generation < complete.generations:
            workload = problem.workload(optimizer.ask(), resumed.generation)
            record.begin(resumed.generation, workload)
            record.restore(workload)
            happening = evaluations.evaluate(workload)
        for generation in range(resumed.generation, complete.generations):
            for happened in happening:
                _record(happened, record, workload)
                logger.on_progress(generation, int(workload.counted.sum()), len(workload.seeds))
            genomes, fitness = workload.genomes, problem.total(workload)
            measures = problem.measures(workload, optimizer.measures)
            optimizer.tell(fitness, measures)
            state = msgspec.Raw(msgspec.msgpack.encode(optimizer.state()))  # as it is before the next ask
            last = generation + 1 == complete.generations
            if not last:  # the servers have work while this generation is recorded and told
                workload = problem.workload(optimizer.ask(), generation + 1)
                happening = evaluations.evaluate(workload)
            history.add(genomes, fitness, measures)
            statistics = optimizer.statistics()
            record.finish(generation, genomes, fitness, statistics, state, measures)
            if optimizer.best()[1] > improved:
                improved = optimizer.best()[1]
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
                record.begin(generation + 1, workload)
        record.end()
        for late in evaluations.rest():
            _record(late, record)
    record.set_meta("history_hash", history.hex())
    return Result(
        str(record.folder), complete.generations, improved, candidates, record.requeued(), history.hex(),
        round(time.monotonic() - begin, 3), record.faulted(), record.doubtful(),
    )  # fmt: skip


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
