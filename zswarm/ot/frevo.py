"""Results of FREVO (github.com/smartgrids-aau/Frevo, version 1.5): a ``.zre`` file of fully-meshed nets becomes a run's folder.

FREVO writes XML: the settings of problem, method and representation, then the population with its weights and fitness. The
file is of somebody else: no entity is expanded, nothing it names is fetched, size and depth are bounded.
"""

import math
import re
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from zswarm import evaluate, experiment
from zswarm.controller import Controller
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.history import History
from zswarm.ot.problem import Problem
from zswarm.ot.record import Record
from zswarm.protocol import keys
from zswarm.protocol.codec import clean
from zswarm.version_hash import version_hash

MAX_BYTES = 64 << 20
MAX_DEPTH = 32
MAX_ROUNDS = 100_000  # of all trials, to play the champion
PROBLEM, METHOD, REPRESENTATION = "emergencyexit.EmergencyExit", "nnga.NNGA", "fullyMeshedNet.FullyMeshedNet"
NET, NET_DEPTH = "FullyMeshedNet", 4  # frevo/populations/population/FullyMeshedNet
STADIUM = "Stadium.ser"
ACTIVATIONS = {"LINEAR": "clamp", "SIGMOID": "sigmoid", "RELU": "relu"}
# What a file may leave out, as in FREVO's own descriptions of these components.
PROBLEM_DEFAULTS = {
    "fieldsource": "FIELD_FROM_FILE", "Filename": STADIUM, "steps": "50", "width": "20", "height": "20",
    "seedforEmergencyExits": "0", "NumberofAgents": "10", "NumberofEmergencyExits": "5", "NumberofBlockades": "20",
    "NumberofEvaluations": "10",
}  # fmt: skip
METHOD_DEFAULTS = {
    "populationsize": "50", "populationnumber": "1", "generations": "200", "percentage_random": "0.10f",
    "percentage_mutate": "0.40f", "percentage_renew": "0.05f", "percentage_xover": "0.30f", "interXover_frequency": "10",
    "mutationMethod": "1", "mutationseverity": "0.3f", "mutationprobability": "1f",
}  # fmt: skip
INTEGER = re.compile(r"[+-]?\d{1,18}")
NUMBER = re.compile(r"[+-]?(\d{1,400}\.?\d{0,400}|\.\d{1,400})([eE][+-]?\d{1,4})?[fFdD]?")


class Result(NamedTuple):
    """What a file says."""

    experiment: Experiment  # complete
    generation: int  # that the population is of
    genomes: list[bytes]
    fitness: np.ndarray  # (candidates,) float64
    source: str  # the file and who wrote it, safe to show
    notes: list[str]  # what could not be taken over, safe to show


class Imported(NamedTuple):
    """What was made of it."""

    folder: Path
    champion: Controller
    played: float | None  # the champion's fitness here; None: it was not played


class _Net(NamedTuple):
    """A network, and what it has to have in common with the others."""

    shape: tuple[int, int, int]  # inputs, outputs, nodes
    settings: dict[str, Any]
    genome: bytes
    fitness: float


def load(path: Path) -> Result:
    """Read a file.

    Raises:
        ConfigError: it cannot be read, is damaged, or of a problem or a representation that zswarm does not have.
    """
    where = clean(str(path))
    try:
        with path.open("rb") as file:
            body = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{where}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(body) > MAX_BYTES:
        raise ConfigError(f"{where}: too large: a result of FREVO of at most {MAX_BYTES >> 20} MiB is read")
    try:
        return _result(path, body)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def record(result: Result, out: Path) -> Imported:
    """Make a run's folder below ``out``: the population is its generation 0. The champion is played once, to compare.

    Raises:
        ConfigError: the folder cannot be made.
    """
    complete, fitness = result.experiment, result.fitness
    problem = Problem(complete)
    best = int(np.nanargmax(fitness))
    history = History()
    history.add(result.genomes, fitness)
    code = version_hash(complete.problem.simulator, complete.representation.kind)
    with Record.create(out, complete, code, problem.simulator.metrics, imported_from=result.source) as made:
        statistics = {"best": float(fitness[best]), "mean": float(np.nanmean(fitness))}
        made.finish(0, result.genomes, fitness, statistics, None)
        champion = problem.controller(result.genomes[best], float(fitness[best]), made.meta("run_id"))
        made.champion(champion)
        made.set_meta("history_hash", history.hex())
    return Imported(made.folder, champion, _play(problem, champion.genome))


def _play(problem: Problem, genome: bytes) -> float | None:
    """A candidate's fitness here; None where that would take long."""
    complete = problem.experiment
    if complete.problem.trials * complete.problem.settings["steps"] > MAX_ROUNDS:
        return None
    workload = problem.workload([genome], 0)
    workload.fitness[:] = evaluate.evaluate(
        problem.simulator, problem.representation, workload.genomes, workload.participants, workload.seeds
    ).fitness
    return float(problem.total(workload)[0])


# ---- the file


def _result(path: Path, body: bytes) -> Result:
    nets: list[_Net] = []
    root = _parse(body, lambda element: nets.append(_net(element)))
    if root.tag != "frevo":
        raise ConfigError(f"no result of FREVO: its outermost element is {clean(root.tag)!r}")
    _only(root, "problem", PROBLEM, "of the problem")
    _only(root, "representation", REPRESENTATION, "of networks of the kind")
    populations = root.find("populations")
    if populations is None or not nets:
        raise ConfigError("damaged, or no result of FREVO: it holds no population")
    if _integer(populations.get("count", ""), "populations: count") != len(populations.findall("population")):
        raise ConfigError("damaged: it does not hold as many populations as it says")
    shape, settings = nets[0].shape, nets[0].settings
    if any((net.shape, net.settings) != (shape, settings) for net in nets):
        raise ConfigError("its networks are not all of one kind: expected the same nodes, activation function and ranges")
    inputs, outputs, nodes = shape
    notes: list[str] = []
    mapping = {
        "name": keys.fold(_entry(root, "sessionconfig", "CustomName", "frevo")),
        "seed": _integer(_entry(root, "sessionconfig", "StartingSeed", "12345"), "StartingSeed"),
        "generations": _integer(_entry(root, "method", "generations", METHOD_DEFAULTS["generations"]), "method: generations"),
        "problem": _problem(root),
        "representation": {
            "kind": "fully-meshed",
            "hidden": nodes - inputs - outputs,
            "iterations": _integer(_entry(root, "representation", "iterations", "2"), "representation: iterations"),
            **settings,
        },
        "optimizer": _optimizer(root, len(nets), notes),
    }
    complete = experiment.complete(experiment.check(mapping, "its settings"), "its settings")
    problem = Problem(complete)
    if (inputs, outputs) != (problem.simulator.inputs, problem.simulator.outputs):
        raise ConfigError(
            f"its networks have {inputs} inputs and {outputs} outputs; "
            f"{complete.problem.simulator} has {problem.simulator.inputs} and {problem.simulator.outputs}"
        )
    fitness = np.array([net.fitness for net in nets]) + 0.0
    if np.isnan(fitness).all():
        raise ConfigError("none of its networks has a fitness")
    generation = _integer(populations.get("generation", ""), "populations: generation")
    source = clean(f"{path.name}: generation {generation} of FREVO's {root.find('method').get('class', '?')}")  # type: ignore[union-attr]
    return Result(complete, generation, [net.genome for net in nets], fitness, source, notes)


def _parse(body: bytes, on_net: Callable[[ElementTree.Element], None]) -> ElementTree.Element:
    """The elements of an XML text, but for networks: each is told when it ends, and forgotten."""
    parser, builder, depth = expat.ParserCreate(), ElementTree.TreeBuilder(), 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise ConfigError(f"no result of FREVO: nested deeper than {MAX_DEPTH}")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        element = builder.end(tag)
        if depth == NET_DEPTH:
            on_net(element)
            element.clear()
        depth -= 1

    def doctype(_name: str, _system: str | None, _public: str | None, has_own_part: int) -> None:
        if has_own_part:  # FREVO's names ISave.dtd, which is not read
            raise ConfigError("no result of FREVO: it declares a document type of its own")

    def entity(*_declaration: object) -> None:
        raise ConfigError("no result of FREVO: it declares entities")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = begin, end, builder.data
    parser.StartDoctypeDeclHandler, parser.EntityDeclHandler = doctype, entity
    parser.buffer_text = True
    try:
        parser.Parse(body, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise ConfigError(f"damaged, or no XML: {clean(str(error))}") from None
    return builder.close()


def _net(element: ElementTree.Element) -> _Net:
    """A network as ``FullyMeshedNet.exportToXmlElement`` writes it."""
    if element.tag != NET:
        raise ConfigError(f"it holds {clean(element.tag)!r}; only results of {NET} can be imported")
    counts = [_integer(element.get(name, ""), f"{NET}: {name}") for name in ("input_nodes", "output_nodes", "nodes")]
    inputs, outputs, nodes = counts
    elements = element.findall("nodes/node")
    found = {_integer(node.get("nr", ""), "node: nr"): node for node in elements}
    if not 0 < inputs <= inputs + outputs <= nodes == len(elements) or sorted(found) != list(range(nodes)):
        raise ConfigError("damaged: a network does not hold the nodes that it says")
    if element.get("random_source", "false").lower() == "true":
        raise ConfigError("its networks have a random source (noise on the biases), which zswarm's do not have")
    activation = element.get("activation_function", "LINEAR")
    if activation not in ACTIVATIONS:
        raise ConfigError(f"unknown activation function {clean(activation)!r}; known are: {', '.join(ACTIVATIONS)}")
    rows = []  # not larger than the text is, whatever it says
    for number in range(inputs, nodes):
        weights = found[number].findall("weights/weight")
        if [_integer(weight.get("from", ""), "weight: from") for weight in weights] != list(range(nodes)):
            raise ConfigError(f"damaged: node {number} of a network does not have one weight from each of its {nodes} nodes")
        rows.append(_singles([*(weight.text for weight in weights), found[number].findtext("bias")], "a weight or bias"))
    fitness = element.get("fitness", "").strip()
    return _Net(
        (inputs, outputs, nodes),
        {
            "activation": ACTIVATIONS[activation],
            **{name: _number(element.get(name, "2.0"), f"{NET}: {name}") for name in ("weight_range", "bias_range")},
        },
        b"".join(row.astype("<f4").tobytes() for row in rows),
        float("nan") if fitness == "NaN" else _number(fitness, f"{NET}: fitness"),
    )


# ---- settings


def _problem(root: ElementTree.Element) -> dict[str, Any]:
    def entry(name: str) -> str:
        return _entry(root, "problem", name, PROBLEM_DEFAULTS[name])

    def whole(name: str) -> int:
        return _integer(entry(name), f"problem: {name}")

    source = entry("fieldsource")
    if source not in ("FIELD_FROM_FILE", "RANDOM_FIELD"):
        raise ConfigError(f"problem: fieldsource: expected FIELD_FROM_FILE or RANDOM_FIELD, not {clean(source)!r}")
    if source == "FIELD_FROM_FILE" and re.split(r"[\\/]", entry("Filename"))[-1] != STADIUM:
        raise ConfigError(f"its field is the file {clean(entry('Filename'))!r}; zswarm has {STADIUM} and random fields")
    stadium = source == "FIELD_FROM_FILE"
    settings = {
        "field": "stadium" if stadium else "random",
        "steps": whole("steps"),
        "width": whole("width"),
        "height": whole("height"),
        "agents": whole("NumberofAgents"),
        "exits": whole("NumberofEmergencyExits"),
        "blockades": whole("NumberofBlockades"),
        "seed": whole("seedforEmergencyExits"),
    }
    trials = 1 if stadium else whole("NumberofEvaluations")
    return {"simulator": "emergency-exit", "trials": trials, "settings": settings}


def _optimizer(root: ElementTree.Element, candidates: int, notes: list[str]) -> dict[str, Any]:
    method = root.find("method")
    if method is None:
        raise ConfigError("damaged, or no result of FREVO: it names no method")
    if (name := method.get("class", "")) != METHOD:
        notes.append(f"zswarm does not have the method {clean(name)!r}: experiment.toml names nnga, with its default settings")
        return {"kind": "nnga", "population": max(candidates, 2)}

    def entry(name: str) -> str:
        return _entry(root, "method", name, METHOD_DEFAULTS[name])

    def whole(name: str) -> int:
        return _integer(entry(name), f"method: {name}")

    def share(name: str) -> float:
        return _number(entry(name), f"method: {name}")

    return {
        "kind": "nnga",
        "population": whole("populationsize"),
        "islands": whole("populationnumber"),
        "exchange_interval": whole("interXover_frequency"),
        "random": share("percentage_random"),
        "mutation": share("percentage_mutate"),
        "crossover": share("percentage_xover"),
        "renew": share("percentage_renew"),
        "mutation_method": whole("mutationMethod"),
        "severity": share("mutationseverity"),
        "probability": share("mutationprobability"),
    }


def _only(root: ElementTree.Element, part: str, known: str, what: str) -> None:
    element = root.find(part)
    if element is None:
        raise ConfigError(f"damaged, or no result of FREVO: it names no {part}")
    if (name := element.get("class", "")) != known:
        raise ConfigError(f"it is {what} {clean(name)!r}; only results of {known} can be imported")


def _entry(root: ElementTree.Element, part: str, key: str, default: str) -> str:
    """The value of a setting."""
    for entry in root.iterfind(f"{part}/*"):
        if entry.get("key") == key:
            return entry.get("value", "").strip()
    return default


def _integer(text: str, what: str) -> int:
    if not INTEGER.fullmatch(text.strip()):
        raise ConfigError(f"{what}: expected a whole number, not {clean(text)!r}")
    return int(text)


def _number(text: str | None, what: str) -> float:
    """A number as Java writes and reads it, such as ``-1.0E-4`` or ``0.3f``."""
    text = (text or "").strip()
    if not NUMBER.fullmatch(text) or not math.isfinite(value := float(text.rstrip("fFdD"))):
        raise ConfigError(f"{what}: expected a finite number, not {clean(text)!r}")
    return value


def _singles(texts: list[str | None], what: str) -> np.ndarray:
    """(numbers,) float32, each nearest to its decimal digits: the one that Java wrote."""
    values = np.array([_number(text, what) for text in texts])
    with np.errstate(over="ignore"):
        near = values.astype(np.float32)
    if not np.isfinite(near).all():
        raise ConfigError(f"{what}: expected a number of 32 bits, not {values[~np.isfinite(near)][0]:g}")
    other = np.nextafter(near, np.where(values > near, np.inf, -np.inf).astype(np.float32))
    middles = (near.astype(float) + other.astype(float)) / 2
    for index in np.flatnonzero((values != near) & (values == middles)):  # 64 bits rounded to the middle: the digits decide
        exact, middle = Decimal((texts[index] or "").strip().rstrip("fFdD")), Decimal(values[index].item())
        if exact != middle:
            near[index] = (max if exact > middle else min)(near[index], other[index])
    return near
