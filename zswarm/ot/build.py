"""Build the parts that an experiment names."""

import contextlib
from typing import NamedTuple

from zswarm.config.decode import convert
from zswarm.errors import ConfigError, ZswarmError
from zswarm.experiment import Experiment
from zswarm.kernels.random import derive_seed
from zswarm.ot.assessment import contest, racing
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.ot.problem import Problem
from zswarm.plugins import registry


class Parts(NamedTuple):
    """The problem and the optimizer of a run."""

    problem: Problem
    optimizer: Optimizer


def build(complete: Experiment) -> Parts:
    """Build the parts of a complete experiment.

    Raises:
        ConfigError: a part refuses its settings, or they do not fit together.
    """
    problem = Problem(complete)
    kind = complete.optimizer.kind
    name = complete.problem.simulator
    simulator = problem.simulator
    loaded = registry.load("optimizer", kind)
    settings = convert(complete.optimizer.settings, loaded.settings_type, "optimizer")
    seed = derive_seed(complete.seed, "optimizer")
    optimizer: Optimizer = loaded(settings, problem.representation, seed)
    _check_optimizer(problem, optimizer)
    stop = complete.stop
    if problem.ranking.relative and (stop.fitness != "none" or stop.stagnation):
        raise ConfigError(
            "stop: fitness and stagnation need fitness that compares between generations; scores "
            f"of {complete.ranking.kind} do not"
        )
    optimizer.relative = problem.ranking.relative
    if complete.problem.seeds == "fresh" and simulator.fixed_seeds(1) is not None:
        raise ConfigError(
            f'problem: seeds: expected "fixed": {name} determines the seeds of its trials with '
            "these settings (`zswarm-ot describe` explains which)"
        )
    if complete.problem.seeds == "fresh" and not optimizer.relative:
        optimizer.use_fresh_seeds()
    if optimizer.resamples and (why := contest.unfit(problem)):
        raise ConfigError(f"optimizer: evaluations: expected 1: {why}")
    if optimizer.candidates is not None and optimizer.candidates < simulator.participants:
        raise ConfigError(
            f"optimizer: {kind} asks for {optimizer.candidates} candidates, but a game of {name} "
            f"takes {simulator.participants}"
        )
    contest.check(problem, optimizer.candidates)
    if complete.assessment.racing:
        _check_racing(problem, optimizer)
    return Parts(problem, optimizer)


def _check_optimizer(problem: Problem, optimizer: Optimizer) -> None:
    complete, simulator = problem.experiment, problem.simulator
    kind, name = complete.optimizer.kind, complete.problem.simulator
    for measure in optimizer.measures:
        if measure not in simulator.metrics:
            known = ", ".join(simulator.metrics) or "none"
            raise ConfigError(
                f"optimizer: measures: {name} has no metric {measure!r}; it has: {known}"
            )
    if problem.ranking.relative and not optimizer.competes:
        raise ConfigError(
            f"optimizer: {kind} compares fitness between generations, but scores of "
            f"{complete.ranking.kind} compare only within one; optimizers that take them: "
            f"{', '.join(_competing())}"
        )
    if optimizer.replays and complete.record.genomes != "all":
        raise ConfigError(
            f'record: genomes: expected "all" with the optimizer {kind}: a resume tells it all '
            "genomes again"
        )


def _check_racing(problem: Problem, optimizer: Optimizer) -> None:
    """Refuse racing where trials of a candidate cannot stop early."""
    complete = problem.experiment
    where = "assessment: racing: expected"
    if why := contest.unfit(problem):
        raise ConfigError(f"{where} false: {why}")
    if (trials := complete.problem.trials) < racing.LEAST:
        raise ConfigError(
            f"{where} problem.trials of at least {racing.LEAST}, not {trials}: with fewer there "
            "is nothing to stop"
        )
    if optimizer.survivors is None:
        raise ConfigError(
            f"{where} an optimizer that uses the order of fitness only, such as nnga with one "
            f"island, cmaes or random: {complete.optimizer.kind} needs the fitness of all "
            "candidates with these settings"
        )


def _competing() -> list[str]:
    """Return the installed optimizers that take scores, which compare within a generation only."""
    found = []
    for name in registry.names("optimizer"):
        with contextlib.suppress(ZswarmError):
            found += [name] * registry.load("optimizer", name).competes
    return found
