"""Bytes written and memory of an optimizer whose genomes are large.

    python benchmarks/large_genomes.py [POPULATION GENES GENERATIONS OPTIMIZER KEPT]

It evolves without servers, and prints a line of JSON: bytes written by a program as its share of
the genomes' bytes, its most memory, and the seconds of all and of a generation, record included.
"""

import contextlib
import itertools
import json
import math
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from zswarm import experiment
from zswarm.config.sections import ClusterConfig
from zswarm.ot import run
from zswarm.ot.build import build
from zswarm.ot.cluster.events import Counted
from zswarm.ot.cluster.remote_server import Standing
from zswarm.ot.logger import Logger
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload

EXPERIMENT = """
name = "large"
seed = 1
generations = {generations}
[problem]
simulator = "emergency-exit"
[representation]
kind = "feed-forward"
hidden = [{hidden}, {hidden}]
[optimizer]
kind = "{kind}"
population = {population}
[record]
genomes = {kept}
"""


class Nobody:
    """A connection that gives every candidate the first of its genes as fitness."""

    standing = Standing(serving=["lab-1"], slots=2, probe=b"digest")
    options = ClusterConfig()

    @contextlib.contextmanager
    def cluster(self, *_args: object, **_asked: Any) -> "Iterator[Nobody]":
        """Return itself."""
        yield self

    def who_computes(self) -> str:
        """Return nobody."""
        return "nobody"

    def wait(self, *_cluster: object) -> Iterator[None]:
        """Return nothing."""
        return iter(())

    rest = wait

    def evaluate(self, workload: Workload) -> Iterator[Counted]:
        """Count all trials at once."""
        trials = np.flatnonzero(~workload.counted)
        genes = np.array([np.frombuffer(one[:4], "<f4")[0] for one in workload.genomes])
        workload.fitness[trials] = genes[workload.participants[trials]]
        workload.metrics[trials] = 0.0
        workload.counted[trials] = True
        yield Counted(trials, "lab-1-0123abcd", 0.01)


def written() -> int:
    """Return the bytes that this program has had written to the disk."""
    lines = Path("/proc/self/io").read_text(encoding="ascii").splitlines()
    return int(dict(line.split(": ") for line in lines)["write_bytes"])


def most_memory_kb() -> int:
    """Return the most memory of this program; ``getrusage`` has that of what started it, too."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return int(dict(line.split(":") for line in lines)["VmHWM"].split()[0])


def measure(
    population: int, genes: int, generations: int, kind: str, kept: str, folder: Path
) -> dict[str, Any]:
    """Evolve, and return the numbers."""
    file = folder / "large.toml"
    hidden = max(1, math.isqrt(genes) - 6)  # 10 inputs, 2 outputs and biases besides
    file.write_text(
        EXPERIMENT.format(
            generations=generations,
            hidden=hidden,
            kind=kind,
            population=population,
            kept=kept if kept.isdigit() else f'"{kept}"',
        ),
        encoding="utf-8",
    )
    complete = experiment.complete(experiment.load(file), str(file))
    parts = build(complete)
    size = parts.problem.representation.genes or 0
    before, ends = written(), [time.perf_counter()]
    with Record.create(folder, complete, "0" * 32) as record:
        evolution = run.evolve(parts, record, Nobody(), Logger(), threading.Event())  # type: ignore[arg-type]
        ends += [time.perf_counter() for _ in evolution]
        genomes = 4 * size * record.evaluations()
    seconds = time.perf_counter() - ends[0]
    later = [end - last for last, end in itertools.pairwise(ends[1:])]
    return {
        "genes": size,
        "genomes_mb": round(genomes / 1e6, 1),
        "written": round((written() - before) / genomes, 3),
        "memory_mb": most_memory_kb() >> 10,
        "seconds": round(seconds, 1),
        "generation_s": round(statistics.median(later), 3),
    }


def main() -> None:
    """Measure what the arguments name, by default 400 genomes of 100,000 numbers."""
    given = [*sys.argv[1:], *["400", "100000", "2", "nnga", "all"][len(sys.argv) - 1 :]]
    population, genes, generations = map(int, given[:3])
    with tempfile.TemporaryDirectory(dir=".") as folder:
        numbers = measure(
            population, genes, generations, given[3], given[4], Path(folder)
        )
    sys.stdout.write(json.dumps(numbers) + "\n")


if __name__ == "__main__":
    main()
