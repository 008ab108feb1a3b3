"""Evolve as ``runs.py`` in one process, without servers or record: ``alone.py FIELD GENERATIONS``.

Prints simulations per second.
"""

import sys
import time

from runs import FIELDS

from zswarm import evaluate, experiment
from zswarm.ot.build import build


def simulations_per_s(field: str, generations: int) -> float:
    """Evolve as ``runs.py`` does, and return simulations per second."""
    example = experiment.find(FIELDS[field])
    problem, optimizer = build(
        experiment.complete(experiment.load(example), str(example))
    )
    simulator, representation = problem.simulator, problem.representation
    simulations = 0
    begin = time.perf_counter()
    for generation in range(generations):
        if generation == 1:
            simulations, begin = 0, time.perf_counter()  # kernels are compiled
        workload = problem.workload(optimizer.ask(), generation)
        played = evaluate.evaluate(
            simulator,
            representation,
            workload.genomes,
            workload.participants,
            workload.seeds,
        )
        workload.fitness[:] = played.fitness
        optimizer.tell(problem.total(workload))
        simulations += len(workload.seeds)
    return simulations / (time.perf_counter() - begin)


if __name__ == "__main__":
    print(simulations_per_s(sys.argv[1], int(sys.argv[2])))
