"""Record champions of the examples: evolving all of them takes minutes.

``python -m tests.sims.champions NAME...`` evolves them anew and writes them to
``champions.json``. A name is that of an example, and after a space a setting that differs from it.
"""

import json
import sys
from pathlib import Path

import numpy as np

from tests.examples import played
from zswarm import experiment
from zswarm.evaluate import TrialOutcomes, evaluate
from zswarm.ot.build import build
from zswarm.ot.problem import Problem

FILE = Path(__file__).with_name("champions.json")


def problem(name: str) -> Problem:
    """Return the problem of an example."""
    example, *settings = name.split(" ")
    loaded = experiment.load(experiment.find(example), settings)
    return build(experiment.complete(loaded, example)).problem


def champion(name: str) -> bytes:
    """Return the genome of a recorded champion."""
    return np.array(json.loads(FILE.read_text())[name], "<f4").tobytes()


def on_seeds(of: Problem, genome: bytes, seeds: np.ndarray) -> TrialOutcomes:
    """Evaluate a genome that acts alone in a trial of each seed."""
    alone = np.zeros((len(seeds), 1), np.int64)
    return evaluate(of.simulator, of.representation, [genome], alone, seeds)


def evolve(name: str) -> bytes:
    """Run the example and return the genome with the greatest fitness."""
    example, *settings = name.split(" ")
    parts, _ = played(example, settings)
    return parts.optimizer.best()[0]


def main(names: list[str]) -> None:
    """Evolve champions and write them, each on a line, beside those of other names."""
    all_of_them = json.loads(FILE.read_text()) if FILE.exists() else {}
    for name in names:
        numbers = np.frombuffer(evolve(name), "<f4")
        all_of_them[name] = [float(str(number)) for number in numbers]
    lines = [f"{json.dumps(name)}: {all_of_them[name]}" for name in sorted(all_of_them)]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
