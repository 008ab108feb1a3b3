"""Write a run folder whose outcomes are those of real trials, without servers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zswarm import evaluate, experiment
from zswarm.kernels.random import Stream
from zswarm.ot.cluster.events import Counted
from zswarm.ot.problem import Problem
from zswarm.ot.record.writer import Record
from zswarm.plugins.version_hash import version_hash

SHORT = (
    "problem.settings.steps=30",
    "problem.settings.width=10",
    "problem.settings.robots=3",
)


def played(
    out: Path,
    example: str = "minisim",
    overrides: Sequence[str] = SHORT,
    *,
    generations: int = 2,
    candidates: int = 4,
    version: str | None = None,
    games: np.ndarray | None = None,
) -> Path:
    """Play a run of random candidates; games as in ``Problem.workload``."""
    complete = experiment.complete(
        experiment.load(
            experiment.find(example),
            [*overrides, f"generations={generations}", f"name={example}"],
        ),
        "test",
    )
    problem = Problem(complete)
    version = version or version_hash(
        complete.problem.simulator, complete.representation.kind
    )
    with Record.create(out, complete, version, problem.simulator.metrics) as record:
        for generation in range(generations):
            genomes = problem.representation.random(candidates, Stream(generation))
            work = problem.workload(genomes, generation, games=games)
            outcomes = evaluate.evaluate(
                problem.simulator,
                problem.representation,
                genomes,
                work.participants,
                work.seeds,
            )
            work.fitness[:], work.metrics[:] = outcomes.fitness, outcomes.metrics
            record.begin(generation, work)
            record.add(Counted(np.arange(len(work.seeds)), "lab-1-0123abcd", 0.01), work)
            told = (
                np.arange(candidates, dtype=float)
                if games is not None
                else problem.total(work)
            )
            best = float(told.max())
            record.finish(
                generation, genomes, told, {"best": best, "mean": float(told.mean())}, {}
            )
        return record.folder
