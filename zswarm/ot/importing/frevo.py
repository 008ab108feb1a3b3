"""Read a result of FREVO: a ``.zre`` file with a population of fully-meshed nets.

FREVO 1.5: github.com/smartgrids-aau/Frevo.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.importing import frevo_file as file
from zswarm.ot.importing.imported import ImportedFile
from zswarm.ot.problem import Problem
from zswarm.protocol import keys
from zswarm.system.text import clean

PROBLEM = "emergencyexit.EmergencyExit"
METHOD = "nnga.NNGA"
REPRESENTATION = "fullyMeshedNet.FullyMeshedNet"
STADIUM = "Stadium.ser"
# By section: our key, FREVO's key, and the default in FREVO's description of the component.
SESSION_SETTINGS = {"seed": ("StartingSeed", 12345)}
RUN_SETTINGS = {"generations": ("generations", 200)}
REPRESENTATION_SETTINGS = {"iterations": ("iterations", 2)}
PROBLEM_SETTINGS = {
    "steps": ("steps", 50),
    "width": ("width", 20),
    "height": ("height", 20),
    "agents": ("NumberofAgents", 10),
    "exits": ("NumberofEmergencyExits", 5),
    "blockades": ("NumberofBlockades", 20),
    "seed": ("seedforEmergencyExits", 0),
}
TRIALS = {"trials": ("NumberofEvaluations", 10)}  # in random fields
METHOD_SETTINGS = {
    "population": ("populationsize", 50),
    "islands": ("populationnumber", 1),
    "exchange_interval": ("interXover_frequency", 10),
    "random": ("percentage_random", 0.1),
    "mutation": ("percentage_mutate", 0.4),
    "crossover": ("percentage_xover", 0.3),
    "renew": ("percentage_renew", 0.05),
    "mutation_method": ("mutationMethod", 1),
    "severity": ("mutationseverity", 0.3),
    "probability": ("mutationprobability", 1.0),
}


def read(path: Path, body: bytes) -> ImportedFile:
    """Return a population from the content of a file.

    Raises:
        ConfigError: it is damaged, or names a problem or a representation that zswarm does not
            have.
    """
    root, nets = file.parse(body)
    _check_class(root, "problem", PROBLEM, "of the problem")
    _check_class(root, "representation", REPRESENTATION, "of networks of the kind")
    populations = root.find("populations")
    if populations is None or not nets:
        raise ConfigError("damaged, or not a result of FREVO: it holds no population")
    count = file.integer(populations.get("count", ""), "populations: count")
    if count != len(populations.findall("population")):
        raise ConfigError("damaged: it does not hold as many populations as it states")
    inputs, outputs, nodes = shape = nets[0].shape
    if any((net.shape, net.settings) != (shape, nets[0].settings) for net in nets):
        raise ConfigError(
            "its networks are not all of one kind: expected the same nodes, activation function "
            "and ranges"
        )
    notes: list[str] = []
    mapping = {
        "name": keys.fold(file.entries(root, "sessionconfig").get("CustomName", "frevo")),
        **_settings(root, "sessionconfig", SESSION_SETTINGS),
        **_settings(root, "method", RUN_SETTINGS),
        "problem": _problem(root),
        "representation": {
            "kind": "fully-meshed",
            "hidden": nodes - inputs - outputs,
            **_settings(root, "representation", REPRESENTATION_SETTINGS),
            **nets[0].settings,
        },
        "optimizer": _optimizer(root, len(nets), notes),
    }
    complete = experiment.complete(
        experiment.check(mapping, "its settings"), "its settings"
    )
    simulator = Problem(complete).simulator
    if (inputs, outputs) != (simulator.inputs, simulator.outputs):
        raise ConfigError(
            f"its networks have {inputs} inputs and {outputs} outputs; "
            f"{complete.problem.simulator} has {simulator.inputs} and {simulator.outputs}"
        )
    fitness = np.array([net.fitness for net in nets]) + 0.0
    if np.isnan(fitness).all():
        raise ConfigError("none of its networks has a fitness")
    generation = file.integer(
        populations.get("generation", ""), "populations: generation"
    )
    method = root.find("method").get("class", "?")  # type: ignore[union-attr]  # _optimizer checked it
    source = clean(f"{path.name}: generation {generation} of FREVO's {method}")
    genomes = [net.genome for net in nets]
    return ImportedFile(complete, generation, genomes, fitness, source, notes)


def _problem(root: Element) -> dict[str, Any]:
    entries = file.entries(root, "problem")
    source = entries.get("fieldsource", "FIELD_FROM_FILE")
    name = entries.get("Filename", STADIUM)
    if source not in ("FIELD_FROM_FILE", "RANDOM_FIELD"):
        raise ConfigError(
            f"problem: fieldsource: expected FIELD_FROM_FILE or RANDOM_FIELD, not {clean(source)!r}"
        )
    stadium = source == "FIELD_FROM_FILE"
    if stadium and name.replace("\\", "/").rpartition("/")[2] != STADIUM:
        raise ConfigError(
            f"its field is the file {clean(name)!r}; zswarm has {STADIUM} and random fields"
        )
    settings = {"field": "stadium" if stadium else "random"}
    settings |= _settings(root, "problem", PROBLEM_SETTINGS)
    trials = {"trials": 1} if stadium else _settings(root, "problem", TRIALS)
    return {"simulator": "emergency-exit", **trials, "settings": settings}


def _optimizer(root: Element, candidates: int, notes: list[str]) -> dict[str, Any]:
    method = root.find("method")
    if method is None:
        raise ConfigError("damaged, or not a result of FREVO: it names no method")
    if (name := method.get("class", "")) == METHOD:
        return {"kind": "nnga", **_settings(root, "method", METHOD_SETTINGS)}
    notes.append(
        f"zswarm does not have the method {clean(name)!r}: experiment.toml names nnga, with its "
        "default settings"
    )
    return {"kind": "nnga", "population": max(candidates, 2)}


def _settings(
    root: Element, part: str, known: Mapping[str, tuple[str, Any]]
) -> dict[str, Any]:
    """Read settings; a default that is a whole number stands for a setting that is one."""
    entries, settings = file.entries(root, part), {}
    for name, (key, default) in known.items():
        read = file.integer if isinstance(default, int) else file.number
        settings[name] = (
            read(entries[key], f"{part}: {key}") if key in entries else default
        )
    return settings


def _check_class(root: Element, part: str, known: str, what: str) -> None:
    element = root.find(part)
    if element is None:
        raise ConfigError(f"damaged, or not a result of FREVO: it names no {part}")
    if (name := element.get("class", "")) != known:
        raise ConfigError(
            f"it is {what} {clean(name)!r}; only results of {known} can be imported"
        )
