"""Read a controller of ARGoS: a genome of ARGoS3-NEAT, or a machine of AutoMoDe-Chocolate."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.nets.chocolate import encoded
from zswarm.ot.importing.imported import ImportedFile, play
from zswarm.ot.problem import Problem
from zswarm.protocol import keys
from zswarm.robots.argos import genome, machine
from zswarm.system.text import clean

OVERRIDABLE = ("problem.settings.", "problem.trials=", "name=", "seed=")
GENERATIONS = 200
TRIALS = 10  # as EvoStick's runs of a genome
# EvoStick: an elite of 20 in 100; all others are its mutants.
EVOSTICK = {
    "kind": "nnga",
    "population": 100,
    "random": 0.0,
    "mutation": 0.8,
    "crossover": 0.0,
    "renew": 0.0,
    "mutation_method": 1,
    "severity": 0.2,
}


def is_controller(body: bytes) -> bool:
    """Return whether a file holds a controller of ARGoS, also a damaged one."""
    begin = body[:10_000].split()
    return begin[:1] in ([b"/*"], [b"genomestart"]) or machine.BEGIN.encode() in begin


def read(path: Path, body: bytes, overrides: Sequence[str]) -> ImportedFile:
    """Return a controller from the content of a file, with an experiment that can go on from it.

    Raises:
        ConfigError: it is damaged, of another robot or reference model, or an override does not
            fit.
    """
    text = body.decode(errors="replace")
    if machine.BEGIN in text:
        model, found = "1.2-machine", encoded(machine.read(_options(text)))
        representation: dict[str, Any] = {"kind": "chocolate"}
        what = "AutoMoDe's machine"
    else:
        network = genome.read(text)
        model = genome.MODELS[len(network.inputs)]
        representation, found = genome.build(network)
        what = "NEAT's genome"
    mapping = {
        "name": keys.fold(path.stem),
        "seed": 1,
        "generations": GENERATIONS,
        "problem": {
            "simulator": "epuck",
            "trials": TRIALS,
            "settings": {"reference_model": model},
        },
        "representation": representation,
        "optimizer": {"kind": "neat"} if representation["kind"] == "neat" else EVOSTICK,
    }
    if strange := [each for each in overrides if not each.startswith(OVERRIDABLE)]:
        raise ConfigError(
            f"--set {clean(strange[0])}: expected a setting of its mission, such as "
            "problem.settings.mission=foraging"
        )
    experiment.override(mapping, overrides)
    checked = experiment.check(mapping, "its experiment")
    complete = experiment.complete(checked, "its experiment")
    if complete.problem.settings["reference_model"] != model:
        raise ConfigError(
            f"--set: expected reference_model={model}, which its controller has"
        )
    problem = Problem(complete)
    fitness = np.array([play(problem, found)])
    source = clean(f"{path.name}: {what} of ARGoS")
    return ImportedFile(complete, 0, [found], fitness, source, [])


def _options(text: str) -> str:
    """Return the options of a machine, which comments may precede as lines that begin with #."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return " ".join(lines)
