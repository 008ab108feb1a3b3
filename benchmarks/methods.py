"""Compare search methods by learning curves over seeds, on three problems.

All methods evolve the same network from the same seeds, with the settings that they have by
default; `neat` has its own kind of network. The best fitness so far is taken after each evaluation.
Runs are played in processes of this program, one per core,
without servers and record: no time is measured.
"""

import argparse
import itertools
import json
import multiprocessing
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import machine
import numpy as np
import tables

SEEDS = 10
POINTS = 60  # of a curve


def measures(**told: tuple[float, float, int]) -> dict[str, Any]:
    """Return settings of methods with measures: metrics, each with low, high and cells."""
    lows, highs, cells = zip(*told.values(), strict=True)
    return {
        "measures": list(told),
        "lows": list(lows),
        "highs": list(highs),
        "cells": list(cells),
    }


class Task(NamedTuple):
    """A problem: an example, evaluations per run, and settings of methods with measures."""

    example: str
    evaluations: int
    measures: dict[str, Any]


TASKS = {
    "stadium": Task("stadium", 10_000, measures(escaped=(0, 72, 24), rounds=(0, 50, 25))),
    "xor": Task("xor", 10_000, measures(output_01=(0, 1, 20), output_11=(0, 1, 20))),
    "aggregation": Task(
        "arena-aggregation", 2_000, measures(spread=(0, 2, 20), neighbours=(0, 15, 15))
    ),
}
# Of methods that search another kind of network than the example's.
NETWORKS = {"neat": {"kind": "neat"}}


class Run(NamedTuple):
    """One of a method on a task."""

    task: str
    method: str
    seed: int
    evaluations: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--seeds", type=int, default=SEEDS, help=f"runs of each method [default: {SEEDS}]"
    )
    parser.add_argument(
        "--only", help="methods, with commas between [default: all that are bundled]"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one seed, thirty evaluations: whether it works",
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    options = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # in processes: as many as cores
    begin = time.monotonic()
    names = options.only.split(",") if options.only else methods()
    seeds = 1 if options.quick else options.seeds
    runs = [
        Run(task, method, seed, 30 if options.quick else TASKS[task].evaluations)
        for task in TASKS
        for method in names
        for seed in range(1, seeds + 1)
    ]
    found: dict[tuple[str, str], list[np.ndarray]] = {}
    with multiprocessing.get_context("spawn").Pool(
        1 if options.quick else len(os.sched_getaffinity(0))
    ) as pool:
        for number, (run, curve) in enumerate(pool.imap(learn, runs), 1):
            found.setdefault((run.task, run.method), []).append(curve)
            if number % seeds == 0:
                print(
                    f"{run.task}, {run.method}: {number} of {len(runs)} runs, "
                    f"{time.monotonic() - begin:.0f} s",
                    flush=True,
                )
    rows = [
        row(task, method, np.array(curves)) for (task, method), curves in found.items()
    ]
    packages = ("cmaes", "ribs")
    seconds = round(time.monotonic() - begin)
    file = machine.write(
        "methods", rows, packages, folder=options.folder, seeds=seeds, seconds=seconds
    )
    print(f"{tables.methods(json.loads(file.read_text()))}\n{file}, {seconds} s")


def methods() -> list[str]:
    """Return all bundled methods."""
    from zswarm.plugins import registry as plugins

    return list(plugins.BUNDLED["optimizer"])


def row(task: str, method: str, curves: np.ndarray) -> dict[str, Any]:
    """Return quartiles over seeds, denser at the beginning; curves are (seeds, evaluations)."""
    at = np.unique(np.geomspace(10, curves.shape[1], POINTS).astype(int))
    low, median, high = np.percentile(curves[:, at - 1], (25, 50, 75), axis=0)
    return {
        "task": task,
        "method": method,
        "evaluations": at.tolist(),
        "median": median.tolist(),
        "q25": low.tolist(),
        "q75": high.tolist(),
        "last": curves[:, -1].tolist(),
    }


def learn(run: Run) -> tuple[Run, np.ndarray]:
    """Return the best fitness after each evaluation: (evaluations,) float64."""
    return run, np.maximum.accumulate(
        np.fromiter(fitness_of(run), float, run.evaluations)
    )


def fitness_of(run: Run) -> Iterator[float]:
    """Yield each candidate's fitness without end; minus infinity for a failed one."""
    from zswarm.evaluate import evaluate
    from zswarm.ot.build import build
    from zswarm.ot.generation import Assessment

    problem, optimizer = build(of(run))
    for generation in itertools.count():
        assessment, more = Assessment(problem, optimizer.ask(), generation), True
        while more:
            workload = assessment.workload
            played = evaluate(
                problem.simulator,
                problem.representation,
                workload.genomes,
                workload.participants,
                workload.seeds,
            )
            workload.fitness[:], workload.metrics[:] = played.fitness, played.metrics
            more = assessment.advance()
        fitness = assessment.fitness()
        optimizer.tell(fitness, assessment.measures(optimizer.measures))
        yield from np.where(np.isnan(fitness), -np.inf, fitness).tolist()


def of(run: Run) -> Any:
    """Return its complete experiment."""
    from zswarm import experiment
    from zswarm.config import decode as strict
    from zswarm.plugins import registry as plugins

    task = TASKS[run.task]
    file = experiment.find(task.example)
    settings = plugins.load("optimizer", run.method).settings_type.__struct_fields__
    mapping = dict(strict.read(file))
    mapping["seed"], mapping["optimizer"] = run.seed, {"kind": run.method}
    mapping["optimizer"] |= {
        key: value for key, value in task.measures.items() if key in settings
    }
    mapping["representation"] = NETWORKS.get(run.method, mapping["representation"])
    return experiment.complete(experiment.check(mapping, str(file)), str(file))


if __name__ == "__main__":
    main()
