"""The experiment and optimization loop that all designs share."""

import contextlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from zswarm import experiment
from zswarm.experiment import Experiment
from zswarm.ot.build import build
from zswarm.ot.generation import Assessment
from zswarm.ot.problem import Problem
from zswarm.ot.record.history_hash import History
from zswarm.ot.workload import Workload
from zswarm.plugins import registry as plugins

BENCHMARKS = Path(__file__).resolve().parents[1]
EXPERIMENT = """
name = "paper"
seed = 1
generations = {generations}
[problem]
simulator = "paced"
trials = {trials}
[problem.settings]
world = "{world}"
agents = {agents}
steps = {steps}
step_s = {step_s}
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = {population}
"""


class World(NamedTuple):
    """A problem; by default FREVO's emergency exit, as fast as it can be."""

    world: str = "emergency-exit"
    agents: int = 8
    steps: int = 50
    step_s: float = 0.0


class Size(NamedTuple):
    """Sizes of an optimization; by default those of the paper's Figure 4."""

    generations: int = 4
    population: int = 4
    trials: int = 1  # n_eval


class Optimized(NamedTuple):
    """The cost and the result of an optimization."""

    seconds: float
    simulations: int
    history: str  # hash of all genomes and fitness: equal where two designs did the same


Play = Callable[[Problem, Workload], None]  # fills the fitness of each trial


def forget_installed() -> None:
    """Let installed parts be read anew."""
    plugins.entry_points.cache_clear()
    plugins._installed.cache_clear()


@contextlib.contextmanager
def installed() -> Iterator[None]:
    """Register the simulator ``paced`` for this process and its children, without keys."""
    with tempfile.TemporaryDirectory() as name:
        metadata = Path(name) / "zswarm_paper-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(
            "Metadata-Version: 2.1\nName: zswarm-paper\nVersion: 1.0\n"
        )
        (metadata / "entry_points.txt").write_text(
            "[zswarm.simulators]\npaced = paper.paced:Paced\n"
        )
        before = {key: os.environ.get(key) for key in ("PYTHONPATH", "ZSWARM_KEYS")}
        sys.path[:0] = paths = [name, str(BENCHMARKS)]
        os.environ["PYTHONPATH"] = os.pathsep.join(
            [*paths, os.environ.get("PYTHONPATH", "")]
        )
        os.environ["ZSWARM_KEYS"] = "none"
        forget_installed()  # they were asked for while modules were imported
        try:
            yield
        finally:
            for path in paths:
                sys.path.remove(path)
            forget_installed()
            for key, value in before.items():
                os.environ.pop(key) if value is None else os.environ.update({key: value})


def load(world: World, size: Size, *cluster: str) -> Experiment:
    """Return the complete experiment with overrides such as ``cluster.servers=2``."""
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "paper.toml"
        file.write_text(EXPERIMENT.format(**world._asdict(), **size._asdict()))
        return experiment.complete(experiment.load(file, list(cluster)), str(file))


def optimize(loaded: Experiment, play: Play) -> Optimized:
    """Evolve to the last generation, evaluating by ``play``; building is not timed."""
    problem, optimizer = build(loaded)
    history, simulations = History(), 0
    begin = time.perf_counter()
    for generation in range(loaded.generations):
        assessment = Assessment(problem, optimizer.ask(), generation)
        play(problem, assessment.workload)
        simulations += len(assessment.workload.seeds)
        if assessment.advance():
            raise RuntimeError("a generation is one round here")
        optimizer.tell(assessment.fitness())
        history.add(assessment.genomes, assessment.fitness())
    return Optimized(time.perf_counter() - begin, simulations, history.hex())
