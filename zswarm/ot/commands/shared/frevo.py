"""Make a run from a result of FREVO: a ``.zre`` file with a population of fully-meshed nets.

FREVO 1.5: github.com/smartgrids-aau/Frevo.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from zswarm import evaluate, experiment
from zswarm.controller import Controller
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.commands.shared import frevo_file as file
from zswarm.ot.problem import Problem
from zswarm.ot.record.writer import Record
from zswarm.plugins.version_hash import version_hash
from zswarm.protocol import keys
from zswarm.system.text import clean

MAX_BYTES = 64 << 20
MAX_STEPS = 100_000  # of all trials, to play the champion
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


class FrevoResult(NamedTuple):
    """The content of a file."""

    experiment: Experiment  # complete
    generation: int  # of the population
    genomes: list[bytes]
    fitness: np.ndarray  # (candidates,) float64
    source: str  # the file and its method, safe to print
    notes: list[str]  # what could not be imported, safe to print


class Imported(NamedTuple):
    """A run that was made from a file."""

    folder: Path
    champion: Controller
    played: float | None  # the champion's fitness here; None: it was not played


def load(path: Path) -> FrevoResult:
    """Read a file.

    Raises:
        ConfigError: it cannot be read, is damaged, or names a problem or a representation that
            zswarm does not have.
    """
    where = clean(str(path))
    try:
        with path.open("rb") as opened:
            body = opened.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{where}: cannot be read: {reason}") from None
    if len(body) > MAX_BYTES:
        raise ConfigError(f"{where}: too large: expected at most {MAX_BYTES >> 20} MiB")
    try:
        return _result(path, body)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def record(result: FrevoResult, out: Path) -> Imported:
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
    return Imported(made.folder, champion, _play(problem, champion.genome))


def _play(problem: Problem, genome: bytes) -> float | None:
    """Return a candidate's fitness here, or None if that would take long."""
    settings = problem.experiment.problem
    if settings.trials * settings.settings["steps"] > MAX_STEPS:
        return None
    work = problem.workload([genome], 0)
    trials = (work.genomes, work.participants, work.seeds)
    work.fitness[:] = evaluate.evaluate(
        problem.simulator, problem.representation, *trials
    ).fitness
    return float(problem.total(work)[0])


def _result(path: Path, body: bytes) -> FrevoResult:
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
    return FrevoResult(complete, generation, genomes, fitness, source, notes)


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
