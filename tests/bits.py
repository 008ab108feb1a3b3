"""Digests of what decides a result: the program that ``test_bits.py`` runs as on other processors.

For every simulator with every representation: the outcomes of some trials, and of one in turns; what the representation's
operators make; and what short runs of the optimizers propose, are told and keep. With one partner each is played in all the
ways that its settings name. With ``short``: trials of few steps, for plain Python; with ``few`` few of these, with the partner
only, and no runs.
"""

import contextlib
import hashlib
import json
import sys
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

import msgspec
import numpy as np

from zswarm import draws, evaluate, plugins
from zswarm.draws import Stream
from zswarm.errors import ConfigError
from zswarm.ot.history import History

PARTNERS = "arena", "fully-meshed"
FEW = sys.argv[1:] == ["few"]
STEPS = 25 if sys.argv[1:] else None  # of a trial, if not as many as the simulator's settings say
GENOMES = 2 if FEW else 6
SEEDS = np.array([1] if FEW else [1, 2**63 + 5], np.uint64)
GENERATIONS = 3


def ways(settings: Any) -> Iterator[dict[str, Any]]:
    """The defaults, and each other choice of a settings struct that names its choices."""
    yield {}
    for field in msgspec.structs.fields(settings):
        kind = field.type
        while get_origin(kind) is not None and get_origin(kind) is not Literal:
            kind = get_args(kind)[0]
        choices = get_args(kind) if get_origin(kind) is Literal else (True, False) if kind is bool else ()
        yield from ({field.name: choice} for choice in choices if choice != field.default)


def problems() -> Iterator[tuple[str, Any, Any]]:
    """Every simulator with every representation, and each choice of either with the other's partner."""
    for simulator in plugins.names("simulator"):
        for representation in plugins.names("representation"):
            with_partner = [simulator == PARTNERS[0], representation == PARTNERS[1]]
            if FEW and not any(with_partner):
                continue
            settings = plugins.load("simulator", simulator).settings_type
            of_simulator = [*ways(settings)] if with_partner[1] else [{}]
            of_network = [*ways(plugins.load("representation", representation).settings_type)] if with_partner[0] else [{}]
            for rules, shape in [*((chosen, {}) for chosen in of_simulator), *(({}, chosen) for chosen in of_network[1:])]:
                name = " ".join([simulator, representation, *(f"{key}={value}" for key, value in {**rules, **shape}.items())])
                steps = {"steps": STEPS} if STEPS and hasattr(settings, "steps") else {}
                yield name, *evaluate.build(simulator, rules | steps, representation, shape)


def played(simulator: Any, network: Any) -> bytes:
    """The outcomes of some trials, in a batch and in turns."""
    genomes = network.random(GENOMES, Stream(3))
    if network.genes is None:  # new ones are all of one structure
        stream = Stream(6)
        for _ in range(40):
            genomes = network.mutate(genomes, stream, method=1, severity=0.3, probability=0.7)
    participants = np.array(
        [[(row + i) % GENOMES for i in range(simulator.participants)] for row in range(GENOMES) for _ in SEEDS]
    )
    outcomes = evaluate.evaluate(simulator, network, genomes, participants, np.tile(SEEDS, GENOMES))
    fitness, metrics = np.empty(simulator.participants), np.empty(len(simulator.metrics))
    evaluate.play_in_turns(simulator, network, network.parameters(genomes)[participants[0]], int(SEEDS[0]), fitness, metrics)
    return b"".join(numbers.tobytes() for numbers in (outcomes.fitness, outcomes.metrics, fitness, metrics))


def operated(network: Any) -> bytes:
    """What the operators that optimizers use make of random genomes."""
    stream = Stream(4)
    genomes = network.random(50, stream)
    for method in (1, 2):
        genomes += network.mutate(genomes[:20], stream, method=method, severity=0.3, probability=0.7)
    genomes += [network.crossover(mother, father, stream) for mother, father in zip(genomes[:20], genomes[20:40], strict=True)]
    return b"".join(genomes) + network.parameters(genomes).tobytes() + network.distances(genomes, genomes[::2]).tobytes()


def evolved(optimizer: Any, simulator: Any, network: Any) -> bytes:
    """The history hash of a short run, with the optimizer's state and statistics at its end."""
    history = History()
    for _ in range(GENERATIONS):
        genomes = optimizer.ask()
        participants = np.arange(len(genomes)).reshape(-1, 1)
        outcomes = evaluate.evaluate(simulator, network, genomes, participants, np.full(len(genomes), SEEDS[0]))
        fitness, measures = outcomes.fitness[:, 0], outcomes.metrics[:, : len(optimizer.measures)]
        history.add(genomes, fitness, measures if optimizer.measures else None)
        optimizer.tell(fitness, measures)
    return history.hex().encode() + msgspec.msgpack.encode([optimizer.state(), optimizer.statistics()])


def drawn() -> bytes:
    """Random numbers of every kind."""
    stream = Stream(draws.derive_seed(1, "bits", 2))
    numbers = stream.words(1000), stream.uniform(-2.0, 3.0, 1000), stream.integers(77, 1000), stream.normal(0.0, 1.0, 1000)
    return b"".join(array.tobytes() for array in numbers) + str([stream.integer(1000) for _ in range(100)]).encode()


def results() -> Iterator[tuple[str, bytes]]:
    """Name and bytes of everything."""
    portable = [name for name in plugins.names("optimizer") if not FEW and plugins.load("optimizer", name).portable]
    yield "draws", drawn()
    for name, simulator, network in problems():
        by_default = name.count(" ") == 1
        yield f"{name}: outcomes", played(simulator, network)
        if by_default:
            yield f"{name}: operators", operated(network)
        one, other = name.split(" ")[:2]
        if not by_default or simulator.participants != 1 or (one != "minisim" and other != "fully-meshed"):
            continue  # optimizers with every representation, and on every simulator, but not each with each
        for kind in portable:
            optimizer_class = plugins.load("optimizer", kind)
            for chosen in ways(optimizer_class.settings_type) if one == "minisim" else [{}]:
                given = {"population": 12, "measures": simulator.metrics[:2], **chosen}
                known = {key: value for key, value in given.items() if key in optimizer_class.settings_type.__struct_fields__}
                settings = msgspec.convert(known, optimizer_class.settings_type)
                with contextlib.suppress(ConfigError):  # it does not take such a network
                    if simulator.metrics or "measures" not in known:
                        optimizer = optimizer_class(settings, network, 5)
                        yield f"{name}: {kind} {chosen}", evolved(optimizer, simulator, network)


if __name__ == "__main__":
    json.dump({name: hashlib.blake2b(value, digest_size=8).hexdigest() for name, value in results()}, sys.stdout)
