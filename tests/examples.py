"""Runs of the examples in this process, without servers and records."""

import math
from collections.abc import Sequence

from zswarm import experiment
from zswarm.evaluate import evaluate
from zswarm.ot.build import Parts, build
from zswarm.ot.generation import Assessment


def played(
    name: str,
    changes: Sequence[str],
    evaluations: int = 10**9,
    enough: float = math.inf,
) -> tuple[Parts, int]:
    """Run an example in this process; return its parts and the number of evaluations.

    The run ends with its last generation, or with the first one that reaches the number of
    evaluations or has a candidate whose fitness is enough.
    """
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
        if told >= evaluations or optimizer.best()[1] >= enough:
            break
    return parts, told
