"""Runs of the examples in this process, without servers and records."""

from collections.abc import Sequence

from zswarm import experiment
from zswarm.evaluate import evaluate
from zswarm.ot.build import Parts, build
from zswarm.ot.generation import Assessment


def played(
    name: str, changes: Sequence[str], evaluations: int = 10**9
) -> tuple[Parts, int]:
    """Run an example in this process; return its parts and the number of evaluations."""
    loaded = experiment.load(experiment.find(name), list(changes))
    complete = experiment.complete(loaded, name)
    parts, told = build(complete), 0
    problem, optimizer = parts
    for generation in range(complete.generations):
        assessment, more = Assessment(problem, optimizer.ask(), generation), True
        while more:
            workload = assessment.workload
            outcomes = evaluate(
                problem.simulator,
                problem.representation,
                workload.genomes,
                workload.participants,
                workload.seeds,
            )
            workload.fitness[:], workload.metrics[:] = outcomes.fitness, outcomes.metrics
            more = assessment.advance()
        optimizer.tell(assessment.fitness(), assessment.measures(optimizer.measures))
        told += len(assessment.genomes)
        if told >= evaluations:
            break
    return parts, told
