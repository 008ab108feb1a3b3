"""Make a run of a file that another program wrote: a population, or a single controller."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from zswarm import evaluate
from zswarm.champion.controller import Controller
from zswarm.experiment import Experiment
from zswarm.ot.problem import Problem
from zswarm.ot.record.writer import Record
from zswarm.plugins.version_hash import version_hash

MAX_STEPS = 100_000  # of all trials, to play the champion


class ImportedFile(NamedTuple):
    """The content of a file.

    Attributes:
        experiment: complete.
        generation: of the population.
        fitness: (candidates,) float64, according to the file, or as played here.
        source: the file and its method, safe to print.
        notes: what could not be imported, safe to print.
    """

    experiment: Experiment
    generation: int
    genomes: list[bytes]
    fitness: np.ndarray
    source: str
    notes: list[str]


class Imported(NamedTuple):
    """A run that was made from a file."""

    folder: Path
    champion: Controller
    played: float | None  # the champion's fitness here; None: it was not played


def record(result: ImportedFile, out: Path) -> Imported:
    """Make a run's folder, with the population as generation 0, and play the champion to compare.

    Raises:
        ConfigError: the folder cannot be made below ``out``.
    """
    complete, genomes, fitness = result.experiment, result.genomes, result.fitness
    problem = Problem(complete)
    best = int(np.nanargmax(fitness))
    code = version_hash(complete.problem.simulator, complete.representation.kind)
    metrics = problem.simulator.metrics
    with Record.create(out, complete, code, metrics, imported_from=result.source) as made:
        statistics = {"best": float(fitness[best]), "mean": float(np.nanmean(fitness))}
        made.finish(0, genomes, fitness, statistics, None)
        run = made.meta("run_id")
        champion = problem.controller(genomes[best], float(fitness[best]), run)
        made.champion(champion)
        made.set_meta("history_hash", made.history().hex())
    settings = complete.problem.settings
    steps = complete.problem.trials * settings.get("steps", MAX_STEPS)
    played = None if steps > MAX_STEPS else play(problem, champion.genome)
    return Imported(made.folder, champion, played)


def play(problem: Problem, genome: bytes) -> float:
    """Return a candidate's fitness here: the sum over the experiment's trials."""
    work = problem.workload([genome], 0)
    trials = (work.genomes, work.participants, work.seeds)
    work.fitness[:] = evaluate.evaluate(
        problem.simulator, problem.representation, *trials
    ).fitness
    return float(problem.total(work)[0])
