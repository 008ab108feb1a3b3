"""Print digests of all that decides a result; ``test_bits.py`` runs this per processor setting.

Cover every simulator in each of its variants with one network, and every network in each of its
variants with one simulator: outcomes of some trials, played in a batch and turn by turn. Add the
results of the networks' operators, and what short runs of each optimizer variant with each network
propose, receive and store on the smallest problem. Finally, cover every pair of simulator and
network. With ``few``, play few and short trials, for plain Python; with ``versions``, also omit the
pairs, and the runs of the optimizers but for one network, and for the one that ``neat`` needs; with
``brief``, also omit the simulator that takes half of the time to compile; with ``sample``, all
simulators but one and all networks but three.
"""

import contextlib
import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from typing import Any, Literal, get_args, get_origin

import msgspec
import numpy as np

from zswarm import evaluate
from zswarm.errors import ConfigError
from zswarm.kernels import random as draws
from zswarm.kernels.lanes import LANES
from zswarm.kernels.random import Stream
from zswarm.nets.networks import Networks
from zswarm.ot.record.history_hash import History
from zswarm.plugins import registry as plugins
from zswarm.sims.turns import play_turns

BRIEF = sys.argv[1:] == ["brief"]
SAMPLE = sys.argv[1:] == ["sample"]
VERSIONS = BRIEF or SAMPLE or sys.argv[1:] == ["versions"]
FEW = VERSIONS or sys.argv[1:] == ["few"]
# Of a trial, if not as many as the simulator's settings say.
STEPS = 25 if FEW else None
GENOMES = 2 if FEW else 6
SEEDS = np.array([1] if FEW else [1, 2**63 + 5], np.uint64)
GENERATIONS = 3
# Partners: whose metrics show every bit of what is decided, lanes.
SIMULATOR, NETWORK, SMALLEST = "arena", "fully-meshed", "xor"
NETWORKS = ["ctrnn", NETWORK, "neat"] if SAMPLE else plugins.names("representation")
# Networks that optimizers evolve.
EVOLVED = [NETWORK, "neat"] if VERSIONS else NETWORKS
# Environments of other packages have their own bits; trials in ROS have those of turtlebot-exit.
SIMULATORS = [
    name
    for name in plugins.names("simulator")
    if set(plugins.libraries(plugins.source_files("simulator", name))) <= {"pymunk"}
    and name != "turtlebot-exit-ros"
    and not (BRIEF and name == "epuck")
    and (not SAMPLE or name == SIMULATOR)
]
# Settings of short trials in which what genomes do makes a difference.
SMALL: dict[str, dict[str, Any]] = {
    "box-pushing": {
        "robots": 2,
        "rays": 8,
        "side": 1.7,
        "box": 0.5,
        "box_mass": 1.0,
        "goal": 0.4,
        "speed": 2.0,
    },
    "epuck": {"robots": 4, "seconds": 2.5},
    "foraging-physical": {
        "robots": 2,
        "rays": 8,
        "side": 1.6,
        "nest": 0.4,
        "pucks": 5,  # sums of fewer are the same in any version
        "speed": 2.0,
    },
    "turtlebot-exit": {"robots": 2, "rays": 8},
}
# Selected by settings other than the one that names choices.
NEEDED = {("minisim", "teams"): {"defenders": 0}}


def ways(settings: Any) -> Iterator[dict[str, Any]]:
    """Yield the default settings, and each other choice of settings that name their choices."""
    yield {}
    for field in msgspec.structs.fields(settings):
        kind = field.type
        while get_origin(kind) is not None and get_origin(kind) is not Literal:
            kind = get_args(kind)[0]
        choices = (
            get_args(kind)
            if get_origin(kind) is Literal
            else (True, False)
            if kind is bool
            else ()
        )
        yield from ({field.name: choice} for choice in choices if choice != field.default)


def problems() -> Iterator[tuple[str, Any, Any]]:
    """Yield each simulator and network in all ways with a partner, then all pairs by default."""
    for simulator in SIMULATORS:
        for chosen in ways(plugins.load("simulator", simulator).settings_type):
            yield problem(
                simulator, NETWORK, chosen | NEEDED.get((simulator, *chosen), {}), {}
            )
    for network in NETWORKS:
        for chosen in ways(plugins.load("representation", network).settings_type):
            yield problem(SIMULATOR, network, {"robots": LANES}, chosen)
    if not VERSIONS:
        for simulator in SIMULATORS:
            for network in NETWORKS:
                yield problem(simulator, network, {}, {})


def problem(
    simulator: str, network: str, rules: dict[str, Any], shape: dict[str, Any]
) -> tuple[str, Any, Any]:
    """Return the name and both parts of a problem."""
    name = " ".join(
        [
            simulator,
            network,
            *(f"{key}={value}" for key, value in {**rules, **shape}.items()),
        ]
    )
    if STEPS:
        has_steps = hasattr(plugins.load("simulator", simulator).settings_type, "steps")
        steps = {"steps": STEPS} if has_steps else {}
        rules = steps | SMALL.get(simulator, {}) | rules
    return name, *evaluate.build(simulator, rules, network, shape)


def compiling(call: Callable[[], Any]) -> tuple[Any, int]:
    """Return what a call returns, and how many functions it compiles."""
    if "numba" not in sys.modules:
        return call(), 0
    from numba.core import event

    with event.install_recorder("numba:compile") as compiled:
        return call(), len(compiled.buffer)


def played(simulator: Any, network: Any) -> tuple[bytes, int, int]:
    """Return outcomes of a batch and of one trial in turns.

    Also return how many outcomes are distinct, and what the batch compiled after warming up.
    """
    genomes = network.random(GENOMES, Stream(3))
    if network.genes is None:  # new ones are all of one structure
        stream = Stream(6)
        for _ in range(40):
            genomes = network.mutate(
                genomes, stream, method=1, severity=0.3, probability=0.7
            )
    participants = np.array(
        [
            [(row + i) % GENOMES for i in range(simulator.participants)]
            for row in range(GENOMES)
            for _ in SEEDS
        ]
    )
    seeds = np.tile(SEEDS, GENOMES)
    evaluate.warm_up(simulator, network)
    outcomes, later = compiling(
        lambda: evaluate.evaluate(simulator, network, genomes, participants, seeds)
    )
    fitness, metrics = np.empty(simulator.participants), np.empty(len(simulator.metrics))
    controllers = Networks(network, network.parameters(genomes)[participants[0]])
    play_turns(simulator, controllers, int(SEEDS[0]), fitness, metrics)
    numbers = np.concatenate([outcomes.fitness, outcomes.metrics], axis=1)
    different = {row.tobytes() for row in numbers[:: len(SEEDS)]}
    joined = b"".join(array.tobytes() for array in (numbers, fitness, metrics))
    return joined, len(different), later


def operated(network: Any) -> bytes:
    """Return the results of the optimizers' operators on random genomes."""
    stream = Stream(4)
    genomes = network.random(50, stream)
    for method in (1, 2):
        genomes += network.mutate(
            genomes[:20], stream, method=method, severity=0.3, probability=0.7
        )
    genomes += [
        network.crossover(mother, father, stream)
        for mother, father in zip(genomes[:20], genomes[20:40], strict=True)
    ]
    return (
        b"".join(genomes)
        + network.parameters(genomes).tobytes()
        + network.distances(genomes, genomes[::2]).tobytes()
    )


def evolved(optimizer: Any, simulator: Any, network: Any) -> bytes:
    """Return the history hash of a short run, and the optimizer's final state and statistics."""
    history = History()
    for _ in range(GENERATIONS):
        genomes = optimizer.ask()
        participants = np.arange(len(genomes)).reshape(-1, 1)
        outcomes = evaluate.evaluate(
            simulator, network, genomes, participants, np.full(len(genomes), SEEDS[0])
        )
        fitness, measures = (
            outcomes.fitness[:, 0],
            outcomes.metrics[:, : len(optimizer.measures)],
        )
        history.add(genomes, fitness, measures if optimizer.measures else None)
        optimizer.tell(fitness, measures)
    return history.hex().encode() + msgspec.msgpack.encode(
        [optimizer.state(), optimizer.statistics()]
    )


def drawn() -> bytes:
    """Return random numbers of every kind."""
    stream = Stream(draws.derive_seed(1, "bits", 2))
    numbers = (
        stream.words(1000),
        stream.uniform(-2.0, 3.0, 1000),
        stream.integers(77, 1000),
        stream.normal(0.0, 1.0, 1000),
    )
    return (
        b"".join(array.tobytes() for array in numbers)
        + str([stream.integer(1000) for _ in range(100)]).encode()
    )


def results() -> Iterator[tuple[str, bytes | int]]:
    """Yield name and bytes of everything, and the counts of ``played``."""
    yield "draws", drawn()
    for name, simulator, network in problems():
        outcomes, different, later = played(simulator, network)
        yield f"{name}: outcomes", outcomes
        yield f"{name}: different", different
        yield f"{name}: compiled after warming up", later
    for representation in NETWORKS:
        _, simulator, network = problem(SMALLEST, representation, {}, {})
        yield f"{representation}: operators", operated(network)
        for kind in plugins.names("optimizer") if representation in EVOLVED else []:
            optimizer_class = plugins.load("optimizer", kind)
            for chosen in (
                ways(optimizer_class.settings_type) if representation == NETWORK else [{}]
            ):
                given = {"population": 12, "measures": simulator.metrics[:2], **chosen}
                known = {
                    key: value
                    for key, value in given.items()
                    if key in optimizer_class.settings_type.__struct_fields__
                }
                if optimizer_class.portable:
                    # It may not take such a network.
                    with contextlib.suppress(ConfigError):
                        optimizer = optimizer_class(
                            msgspec.convert(known, optimizer_class.settings_type),
                            network,
                            5,
                        )
                        yield (
                            f"{representation}: {kind} {chosen}",
                            evolved(optimizer, simulator, network),
                        )


def digest(value: bytes | int) -> str | int:
    """Return a digest of bytes."""
    return (
        value
        if isinstance(value, int)
        else hashlib.blake2b(value, digest_size=8).hexdigest()
    )


if __name__ == "__main__":
    json.dump({name: digest(value) for name, value in results()}, sys.stdout)
