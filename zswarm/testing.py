"""Checks that a simulator, representation or optimizer keeps its contract, and a clock for tests of state machines.

Run them over a part of your own in its tests::

    from zswarm.testing import check_simulator

    def test_my_simulator_keeps_the_contract():
        check_simulator(MySimulator)

Each check raises ``AssertionError`` with a text that names what is wrong; what the part itself raises passes through.
"""

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np

from zswarm.draws import Stream
from zswarm.jit import PLAIN, STEP_SIGNATURE, Step
from zswarm.lanes import LANES
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.simulator_checks import check_simulator, fully_meshed, require
from zswarm.strict import convert

NOT_A_NUMBER = b"\xff"  # repeated, it is NaN in float32 and float64, and beyond any table in an integer
DECISIONS = 5
__all__ = ["FakeClock", "check_optimizer", "check_representation", "check_simulator"]
MUTATIONS = 50  # after which some genome is another, also where a mutation changes little
GUARD = 64  # numbers before and behind an array that a decision gets


class FakeClock:
    """A clock that stands still until it is moved; call it for the time in seconds."""

    def __init__(self, start: float = 1000.0) -> None:
        self.now = start

    def __call__(self) -> float:
        """The time, in seconds."""
        return self.now

    def advance(self, seconds: float) -> float:
        """Move on by some seconds, never back; the new time."""
        if not seconds >= 0:
            raise ValueError(f"a clock goes forward: seconds must be at least 0, not {seconds}")
        self.now += seconds
        return self.now


# ---- representations ----------------------------------------------------------------------------------------------


def check_representation(
    representation_class: type[Representation],
    settings: Mapping[str, Any] | None = None,
    *,
    inputs: int = 5,
    outputs: int = 2,
) -> None:
    """Check the contract of ``Representation`` with some random genomes.

    Checked are: ``genes`` and ``ranges``; shape and dtype of the parameters; that genomes of a wrong length or with NaN are
    refused; that a genome's row is the same in every batch, but for zeros behind it; that a decision is compiled and does the
    same in plain Python, fills its output, repeats bit for bit, begins with a state of zeros, and touches nothing beside its
    arrays; that ``step_lanes`` decides as ``step``; that each operator gives the same for the same stream, and genomes that fit;
    that mutations and crossovers make something else of a genome; that distances are symmetric, zero to itself, and the same in
    every batch; that ``graph`` has every input and output, and edges between its nodes.

    Args:
        representation_class: the class to check.
        settings: as in ``[representation]`` without ``kind``; the defaults where left out.
        inputs: numbers the network observes.
        outputs: numbers it sets.

    Raises:
        AssertionError: a rule is broken; the text says which.
    """
    name = representation_class.__name__
    network = representation_class(convert(settings or {}, representation_class.settings_type, "settings"), inputs, outputs)
    genomes = network.random(6, Stream(1))
    require(len(genomes) == 6, f"{name}.random(6, ...) must make 6 genomes, not {len(genomes)}")
    require(network.random(6, Stream(2)) != genomes, f"{name}.random makes the same of another stream")
    _check_numbers(name, network, genomes)
    require(isinstance(network.state_size, int) and network.state_size >= 0, f"{name}.state_size must be an int >= 0")
    _check_operators(name, network, genomes)
    _check_refusals(name, network, genomes[0])
    _check_decisions(name, network, genomes)
    _check_graph(name, network, genomes[0])


def _check_numbers(name: str, network: Representation, genomes: list[bytes]) -> None:
    """``genome_bytes``, ``genes`` and ``ranges``."""
    length = network.genome_bytes
    for genome in genomes:
        require(isinstance(genome, bytes), f"{name}.random must make bytes, not {type(genome).__name__}")
        require(length in (None, len(genome)), f"{name}.random: a genome must be {length} bytes, not {len(genome)}")
    if network.genes is None:
        require(network.ranges is None, f"{name}.ranges must be None where genes is")
        return
    count, ranges = network.genes, network.ranges
    require(length == 4 * count, f"{name}.genes: {count} float32 numbers are not {length} bytes")
    given = f"{ranges.shape} {ranges.dtype}" if isinstance(ranges, np.ndarray) else repr(ranges)
    require(given == f"{(count,)} float64", f"{name}.ranges must be a {(count,)} float64 array, not {given}")
    assert ranges is not None  # noqa: S101  checked
    require(bool((np.isfinite(ranges) & (ranges > 0)).all()), f"{name}.ranges must be finite and above 0")
    numbers = np.abs(np.frombuffer(b"".join(network.random(64, Stream(5))), "<f4").reshape(64, count))
    reach = numbers.max(axis=0) / ranges
    require(bool((reach <= 1 + 1e-6).all()), f"{name}.random: number {int(reach.argmax())} is beyond its range")
    require(bool((reach > 0.5).all()), f"{name}.random: number {int(reach.argmin())} is not uniform in plus or minus its range")
    for number in (0.0, -1e30, 1e30):
        try:
            network.parameters([np.full(count, number, "<f4").tobytes()])
        except ValueError as error:
            raise AssertionError(f"{name}.genes: any finite numbers must be a genome, also all {number}: {error}") from error


def _check_operators(name: str, network: Representation, genomes: list[bytes]) -> None:
    operators: dict[str, Callable[[Stream], list[bytes]]] = {
        "random": lambda stream: network.random(4, stream),
        "mutate, method 1": lambda stream: network.mutate(genomes, stream, method=1, severity=0.3, probability=0.5),
        "mutate, method 2": lambda stream: network.mutate(genomes, stream, method=2, severity=0.3, probability=0.5),
        "crossover": lambda stream: [network.crossover(a, b, stream) for a, b in pairwise(genomes)],
    }
    none = [network.random(0, Stream(3)), network.mutate([], Stream(3), method=1, severity=0.3, probability=0.5)]
    require(none == [[], []], f"{name}: random of 0 and mutate of no genomes must make none")
    for operator, apply in operators.items():
        children = apply(Stream(3))
        require(children == apply(Stream(3)), f"{name}.{operator}: the same stream gives other genomes; draw only from it")
        if operator.startswith("mutate"):
            require(len(children) == len(genomes), f"{name}.{operator}: {len(genomes)} genomes gave {len(children)}")
        for child in children:
            require(
                isinstance(child, bytes) and network.genome_bytes in (None, len(child)),
                f"{name}.{operator}: a genome must be {network.genome_bytes} bytes, not {len(child)}",
            )
        try:
            network.parameters(children)
        except ValueError as error:
            raise AssertionError(f"{name}.{operator}: makes genomes that parameters refuses: {error}") from error

    for method in (1, 2):
        stream, mutants = Stream(7), genomes
        for _ in range(MUTATIONS):
            mutants = network.mutate(mutants, stream, method=method, severity=0.3, probability=1.0)
        require(mutants != genomes, f"{name}.mutate, method {method}: all genomes are the same after {MUTATIONS} mutations")
    stream = Stream(8)
    children = [network.crossover(a, b, stream) for a, b in pairwise(genomes)]
    require(children != genomes[:-1], f"{name}.crossover: a child is its mother and has nothing of its father")

    distances = network.distances(genomes, genomes)
    count = len(genomes)
    require(
        distances.shape == (count, count) and distances.dtype == np.float64,
        f"{name}.distances must be ({count}, {count}) float64, not {distances.shape} {distances.dtype}",
    )
    require(not distances.diagonal().any(), f"{name}.distances: a genome differs from itself")
    require(np.array_equal(distances, distances.T), f"{name}.distances are not symmetric")
    require(bool((distances >= 0).all()), f"{name}.distances: one is negative or NaN")
    for left, right in ((2, count), (count, 1), (1, 1)):
        some = network.distances(genomes[:left], genomes[-right:])
        same = np.array_equal(some, distances[:left, -right:])
        require(same, f"{name}.distances: a pair's distance depends on the other genomes; numpy may add in another order")


def _check_refusals(name: str, network: Representation, genome: bytes) -> None:
    for what, wrong in (
        ("one byte short", genome[:-1]),
        ("one byte long", genome + b"\0"),
        ("empty", b""),
        ("full of NaN", NOT_A_NUMBER * len(genome)),
    ):
        try:
            network.parameters([genome, wrong])
        except ValueError:
            continue
        raise AssertionError(f"{name}.parameters must refuse a genome that is {what} with ValueError")


def _check_decisions(name: str, network: Representation, genomes: list[bytes]) -> None:
    parameters = network.parameters(genomes)
    require(
        parameters.dtype == np.float32 and parameters.ndim == 2 and len(parameters) == len(genomes),
        f"{name}.parameters must be ({len(genomes)}, P) float32, not {parameters.shape} {parameters.dtype}",
    )
    require(parameters.flags.c_contiguous, f"{name}.parameters must be C-contiguous")
    for genome, row in zip(genomes, parameters, strict=True):
        alone = network.parameters([genome])[0]
        require(
            len(alone) <= len(row) and np.array_equal(alone, row[: len(alone)]) and not row[len(alone) :].any(),
            f"{name}.parameters: a genome's row depends on the other genomes; only zeros may be added behind it",
        )
    step, step_lanes = network.step, network.step_lanes
    compiled = not PLAIN and os.environ.get("NUMBA_DISABLE_JIT", "0") == "0"
    if compiled:
        for what, function in (("step", step), ("step_lanes", step_lanes)):
            signatures = () if function is None else getattr(function, "signatures", ())
            require(
                function is None or STEP_SIGNATURE.args in signatures, f"{name}.{what} must be compiled with jit.STEP_SIGNATURE"
            )

    observations = Stream(4).uniform(-3.0, 3.0, DECISIONS * network.inputs).reshape(DECISIONS, network.inputs).astype(np.float32)
    agents = [_Agent(network, row) for row in parameters]
    decided = [agent.decide(f"{name}.step", step, observations) for agent in agents]
    again = [agent.decide(f"{name}.step", step, observations) for agent in reversed(agents)]
    require(decided == again[::-1], f"{name}.step: the same parameters and observations decide otherwise the second time")
    for agent in agents:
        agent.restart()
    turns = [[agent.act(f"{name}.step", step, observation) for agent in agents] for observation in observations]
    require(
        [b"".join(actions) for actions in zip(*turns, strict=True)] == decided,
        f"{name}.step: agents that take turns decide otherwise than alone; all that is remembered must stand in the state",
    )
    for genome, expected in zip(genomes, decided, strict=True):
        agent = _Agent(network, network.parameters([genome])[0])
        same = agent.decide(f"{name}.step", step, observations) == expected
        require(same, f"{name}.step: a genome alone decides otherwise than among longer ones")
    if compiled:
        with np.errstate(all="ignore"):
            plain = agents[0].decide(f"{name}.step", step.py_func, observations)  # type: ignore[attr-defined]  # of numba's
        require(
            plain == decided[0],
            f"{name}.step: plain Python decides otherwise than the compiled form; type all constants, such as np.float32(0.5), "
            "and take functions from portable.py",
        )
    if step_lanes is not None:
        _check_lanes(name, network, parameters, observations)


def _check_graph(name: str, network: Representation, genome: bytes) -> None:
    graph = network.graph(genome)
    kinds = Counter(node.kind for node in graph.nodes)
    parts = 1 + max((node.part for node in graph.nodes), default=0)
    require(
        bool(kinds["state"]) or (kinds["input"], kinds["output"]) == (parts * network.inputs, parts * network.outputs),
        f"{name}.graph must have {network.inputs} inputs and {network.outputs} outputs a part, or states, not {dict(kinds)}",
    )
    for edge in graph.edges:
        there = 0 <= edge.source < len(graph.nodes) and 0 <= edge.target < len(graph.nodes)
        require(there, f"{name}.graph: an edge leads from {edge.source} to {edge.target}, of {len(graph.nodes)} nodes")
        require(bool(np.isfinite(edge.weight)), f"{name}.graph: a weight is {edge.weight}")
        require(graph.nodes[edge.target].kind != "input", f"{name}.graph: an edge leads to an input")


class _Agent:
    """An agent that decides, with arrays among numbers that nobody may read or change."""

    def __init__(self, network: Representation, parameters: np.ndarray, together: int = 1) -> None:
        sizes = len(parameters), *(together * size for size in (network.state_size, network.inputs, network.outputs))
        self.guarded = [np.full(size + 2 * GUARD, np.nan, np.float32) for size in sizes]
        self.parameters, self.state, self.observation, self.output = (
            whole[GUARD : GUARD + size] for whole, size in zip(self.guarded, sizes, strict=True)
        )
        self.parameters[:] = parameters
        self.kept = parameters.copy()

    def restart(self) -> None:
        """A trial begins."""
        self.state[:] = 0

    def act(self, where: str, step: Step, observation: np.ndarray) -> bytes:
        """One decision, checked."""
        self.observation[:], self.output[:] = observation, np.nan
        step(self.parameters, self.state, self.observation, self.output)
        require(
            not np.isnan(self.output).any(),
            f"{where} leaves an output unset, or sets NaN; it does so, too, where it reads what is not in its arrays",
        )
        outside = [np.concatenate([whole[:GUARD], whole[-GUARD:]]) for whole in self.guarded]
        require(bool(np.isnan(outside).all()), f"{where} writes beside its arrays: is state_size too small?")
        require(
            np.array_equal(self.parameters, self.kept) and np.array_equal(self.observation, observation),
            f"{where} must change only state and output",
        )
        return self.output.tobytes()

    def decide(self, where: str, step: Step, observations: np.ndarray) -> bytes:
        """A trial's decisions."""
        self.restart()
        return b"".join(self.act(where, step, observation) for observation in observations)


def _check_lanes(name: str, network: Representation, parameters: np.ndarray, observations: np.ndarray) -> None:
    """Eight agents side by side, each with other parameters and observations."""
    assert network.step_lanes is not None  # noqa: S101  asked before
    where = f"{name}.step_lanes"
    rows = [row % len(parameters) for row in range(LANES)]
    seen = [np.roll(observations, -lane, axis=0) for lane in range(LANES)]
    eight = _Agent(network, parameters[rows].T.reshape(-1), LANES)  # number k of a lane at 8 k + lane
    together = np.stack(seen, axis=-1).reshape(len(observations), -1)
    decided = np.frombuffer(eight.decide(where, network.step_lanes, together), np.float32).reshape(-1, network.outputs, LANES)
    for lane in range(LANES):
        alone = _Agent(network, parameters[rows[lane]]).decide(f"{name}.step", network.step, seen[lane])
        require(decided[:, :, lane].tobytes() == alone, f"{where}: an agent decides otherwise than with step")


# ---- optimizers ---------------------------------------------------------------------------------------------------


class _Toy:
    """A problem for every kind of network.

    Fitness is minus the sum of the squares of a genome's float32 numbers, or of how far decisions are from 1/4 where genomes are
    no plain numbers: at most 0. Measures are the first of these numbers.
    """

    def __init__(self, network: Representation) -> None:
        self._network = network

    def _numbers(self, genomes: Sequence[bytes]) -> np.ndarray:
        """(genomes, n) float64."""
        network = self._network
        try:
            network.parameters(genomes)
        except ValueError as error:
            raise AssertionError(f"an ask gives genomes that {type(network).__name__}.parameters refuses: {error}") from error
        if network.genes is not None:
            return np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), -1).astype(np.float64)
        observations = Stream(4).uniform(-1.0, 1.0, DECISIONS * network.inputs).reshape(DECISIONS, -1).astype(np.float32)
        actions = np.zeros((len(genomes), DECISIONS, network.outputs), np.float32)
        for row, decided in zip(network.parameters(genomes), actions, strict=True):
            state = np.zeros(network.state_size, np.float32)
            for observation, action in zip(observations, decided, strict=True):
                type(network).step(row, state, observation, action)
        return actions.reshape(len(genomes), -1).astype(np.float64) - 0.25

    def fitness(self, genomes: Sequence[bytes]) -> np.ndarray:
        numbers = self._numbers(genomes)
        return -np.cumsum(numbers * numbers, axis=1)[:, -1]

    def measures(self, genomes: Sequence[bytes], count: int) -> np.ndarray:
        return self._numbers(genomes)[:, :count]


def check_optimizer(
    optimizer_class: type[Optimizer],
    settings: Mapping[str, Any] | None = None,
    *,
    representation: Representation | None = None,
    generations: int = 25,
) -> None:
    """Evolve small networks towards zero weights and check the contract of ``Optimizer``.

    Checked are: the order of ask and tell; that a seed gives the same genomes again and another one others; that
    ``state`` survives msgpack and ``restore`` goes on with the same genomes; that an ask gives no more than ``candidates``
    and changes neither ``best`` nor ``statistics``; that a tell changes nothing of what was asked and told; that NaN fitness does
    no harm; that somebody is asked also where all are equally good; that ``best`` is the best of all told, and improves, or that
    measures reach further. Where ``competes`` says so, all of this with relative fitness, too: what was
    told of earlier generations must not count.

    Args:
        optimizer_class: the class to check.
        settings: as in ``[optimizer]`` without ``kind``; the defaults where left out. An optimizer with the setting ``measures``
            gets two, unless they are named here.
        representation: what to evolve, for optimizers that do not take every kind; else a small fully-meshed network. Where
            its genomes are no plain numbers, decisions near 1/4 are good instead of weights near zero.
        generations: after which the best fitness must have improved.

    Raises:
        AssertionError: a rule is broken; the text says which.
    """
    name = optimizer_class.__name__
    network = representation or fully_meshed(3, 1)
    toy = _Toy(network)
    named = {"measures": ["first", "second"]} if "measures" in optimizer_class.settings_type.__struct_fields__ else {}

    def new(seed: int = 1, *, relative: bool = False) -> Optimizer:
        converted = convert({**named, **(settings or {})}, optimizer_class.settings_type, "settings")
        optimizer = optimizer_class(converted, network, seed)
        optimizer.relative = relative
        return optimizer

    require(isinstance(optimizer_class.portable, bool), f"{name}.portable must be True or False")
    _check_order(name, new(), toy)
    _check_repeats(name, new, toy)
    _check_not_a_number(name, new(), toy)
    _check_equals(name, new())
    _check_improvement(name, new(), toy, generations)
    if optimizer_class.competes:
        _check_repeats(f"{name}, relative", partial(new, relative=True), toy)
        _check_relative(name, new(relative=True), toy, generations)


def _check_order(name: str, optimizer: Optimizer, toy: _Toy) -> None:
    genome, fitness = optimizer.best()
    require(genome == b"" and not np.isfinite(fitness), f"{name}.best before the first tell must be without a genome")
    _require_raises(RuntimeError, lambda: optimizer.tell(np.zeros(1)), f"{name}.tell before an ask")
    genomes = optimizer.ask()
    measures = toy.measures(genomes, len(optimizer.measures))
    require(bool(genomes), f"{name}.ask must give a genome at least")
    require(all(type(genome) is bytes for genome in genomes), f"{name}.ask must give bytes, not {type(genomes[0]).__name__}")
    _require_raises(RuntimeError, optimizer.ask, f"{name}.ask before the last one was told")
    for wrong in (np.zeros(len(genomes) + 1), np.zeros((len(genomes), 1))):
        _require_raises(ValueError, lambda wrong=wrong: optimizer.tell(wrong, measures), f"{name}.tell with shape {wrong.shape}")  # type: ignore[misc]
    require(optimizer.generation == 0, f"{name}.generation counts a tell that was refused")
    if optimizer.measures:
        _require_raises(ValueError, lambda: optimizer.tell(toy.fitness(genomes)), f"{name}.tell without its measures")
    optimizer.tell(toy.fitness(genomes), measures)
    require(optimizer.generation == 1, f"{name}.generation must be 1 after the first tell, not {optimizer.generation}")
    _require_raises(RuntimeError, lambda: optimizer.tell(np.zeros(len(genomes)), measures), f"{name}.tell a second time")


def _check_repeats(name: str, new: Callable[[int], Optimizer], toy: _Toy) -> None:
    first, again = new(1), new(1)
    before: list[Told] = []
    for generation in range(6):
        revived = new(1)
        revived.restore(msgspec.msgpack.decode(msgspec.msgpack.encode(first.state())), before)
        where = f"in generation {generation}"
        require(revived.generation == first.generation, f"{name}.restore: another generation {where}")
        require(_same(revived.best(), first.best()), f"{name}.restore: another best {where}")
        if generation:
            require(_same(revived.statistics(), first.statistics()), f"{name}.restore: other statistics {where}")
            told = (first.best(), first.statistics())
        genomes = first.ask()
        if generation:
            require(_same((first.best(), first.statistics()), told), f"{name}.ask changes best or statistics {where}")
        most = first.candidates
        require(most is None or len(genomes) <= most, f"{name}.ask gives {len(genomes)} genomes; candidates says {most} {where}")
        require(again.ask() == genomes, f"{name}: the same seed asks other genomes {where}")
        require(revived.ask() == genomes, f"{name}: state and restore change what is asked {where}")
        if generation == 0:
            require(new(2).ask() != genomes, f"{name}: another seed asks the same genomes")
        fitness, measures = toy.fitness(genomes), toy.measures(genomes, len(first.measures))
        for optimizer in (first, again, revived):
            optimizer.tell(fitness, measures)
        before.append(Told(genomes, fitness, measures))
        require(
            msgspec.msgpack.encode(revived.state()) == msgspec.msgpack.encode(first.state()),
            f"{name}: a restored optimizer told the same has another state {where}",
        )


def _check_not_a_number(name: str, optimizer: Optimizer, toy: _Toy) -> None:
    failed = len(optimizer.ask())
    optimizer.tell(np.full(failed, np.nan), np.full((failed, len(optimizer.measures)), np.nan))
    best = float("-inf")
    for generation in range(4):
        genomes = optimizer.ask()
        fitness = toy.fitness(genomes)
        if generation % 2 and len(fitness) > 1:
            fitness[::2] = np.nan
        measures = toy.measures(genomes, len(optimizer.measures))
        measures[np.isnan(fitness)] = np.nan
        asked, told = list(genomes), fitness.tobytes() + measures.tobytes()
        optimizer.tell(fitness, measures)
        same = fitness.tobytes() + measures.tobytes() == told
        require(same, f"{name}.tell changes the fitness or measures that it gets; the run goes on with them")
        require(genomes == asked, f"{name}.tell changes the list that ask gave; the run goes on with it")
        best = max(best, float(np.nanmax(fitness, initial=float("-inf"))))
        require(optimizer.best()[1] == best, f"{name}.best after NaN fitness must be {best}, not {optimizer.best()[1]}")
        statistics = optimizer.statistics()
        for what in ("best", "mean"):
            require(what in statistics, f"{name}.statistics: {what} is missing")
            require(bool(np.isfinite(statistics[what])), f"{name}.statistics: {what} must leave NaN fitness out")


def _check_equals(name: str, optimizer: Optimizer) -> None:
    """All are equally good, as on a problem where nobody succeeds at first."""
    for generation in range(5):
        count = len(optimizer.ask())
        require(count > 0, f"{name}.ask gives no genome in generation {generation} where all are equally good")
        optimizer.tell(np.zeros(count), np.zeros((count, len(optimizer.measures))))


def _check_improvement(name: str, optimizer: Optimizer, toy: _Toy, generations: int) -> None:
    history: list[float] = []
    reached: list[float] = []  # how far from zero the measures came
    told = float("-inf")
    for _ in range(generations):
        genomes = optimizer.ask()
        fitness, measures = toy.fitness(genomes), toy.measures(genomes, len(optimizer.measures))
        optimizer.tell(fitness, measures)
        told = max([told, *fitness.tolist()])
        genome, best = optimizer.best()
        require(best == told, f"{name}.best must be the best of all told, {told}, not {best}")
        require(toy.fitness([genome])[0] == best, f"{name}.best: the genome is not the one of that fitness")
        history.append(best)
        reached.append(float(np.abs(measures).max(initial=0.0)))
    require(
        history[-1] > history[0] or max(reached) > reached[0],
        f"{name}: the best of {generations} generations is no better than the first: {history[0]}"
        + ("; nor do measures reach further" if optimizer.measures else ""),
    )


def _check_relative(name: str, optimizer: Optimizer, toy: _Toy, generations: int) -> None:
    """Every generation is told that it is far worse than the one before, as if others had become so good."""
    reached: list[float] = []
    for generation in range(generations):
        genomes = optimizer.ask()
        worth = toy.fitness(genomes)
        fitness = worth - 1e6 * generation
        optimizer.tell(fitness, toy.measures(genomes, len(optimizer.measures)))
        genome, best = optimizer.best()
        where = f"where fitness is relative, in generation {generation}"
        require(
            best == fitness.max(), f"{name}.best must be the best of the last generation {where}: {fitness.max()}, not {best}"
        )
        require(genome == genomes[int(np.argmax(fitness))], f"{name}.best: another genome than the first of the best {where}")
        mean = optimizer.statistics()["mean"]
        require(
            bool(fitness.min() - 1.0 <= mean <= fitness.max() + 1.0),
            f"{name}: the mean, {mean}, has fitness of earlier generations in it {where}; all that compete must be asked again",
        )
        reached.append(float(worth.max()))
    require(reached[-1] > reached[0], f"{name}: with relative fitness generation {generations} is no better than the first")


def _same(left: object, right: object) -> bool:
    """Equal, where NaN equals NaN."""
    return msgspec.msgpack.encode(left) == msgspec.msgpack.encode(right)


def _require_raises(kind: type[Exception], call: Callable[[], object], what: str) -> None:
    try:
        call()
    except kind:
        return
    raise AssertionError(f"{what} must raise {kind.__name__}")
