"""The check that a representation keeps its contract."""

import os
from collections import Counter
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from zswarm.config.decode import convert
from zswarm.kernels.jit import PLAIN, STEP_SIGNATURE, Compiled, Step, interpreted
from zswarm.kernels.lanes import LANES
from zswarm.kernels.random import Stream
from zswarm.nets.representation import Representation
from zswarm.testing.rules import checking, require, require_accepted, require_raises

NAN = b"\xff"  # repeated: NaN as float32 or float64, and an index beyond any table
DECISIONS = 5
MUTATIONS = 50  # after which some genome has changed, however small the mutations
GUARD = 64  # NaN before and behind each array that a decision gets
MUTATION = {"severity": 0.3, "probability": 0.5}


def check_representation(
    representation_class: type[Representation],
    settings: Mapping[str, Any] | None = None,
    *,
    inputs: int = 5,
    outputs: int = 2,
) -> None:
    """Check the contract of ``Representation`` with some random genomes.

    - ``genes``, ``ranges``, ``state_size``, and the shape of the parameters are as documented.
    - ``parameters`` refuses genomes of a wrong length or with NaN. A genome's row is the same in
      every batch, but for trailing zeros.
    - ``step`` is compiled, gives the same bits in plain Python, repeats them, fills the output, and
      touches nothing outside its arrays. ``step_lanes`` gives the same bits.
    - Operators draw from their stream only, make valid genomes, and change something.
    - Distances are symmetric, zero to the genome itself, and the same in every batch.
    - ``graph`` has every input and output, and edges between its nodes.

    Args:
        representation_class: the class to check.
        settings: as in ``[representation]`` without ``kind``; defaults where omitted.
        inputs: numbers that the network observes.
        outputs: numbers that the network sets.

    Raises:
        AssertionError: a rule is broken; the text names it.
    """
    converted = convert(settings or {}, representation_class.settings_type, "settings")
    network = representation_class(converted, inputs, outputs)
    with checking(representation_class.__name__):
        genomes = network.random(6, Stream(1))
        require(
            len(genomes) == 6, f".random(6, ...) must make 6 genomes, not {len(genomes)}"
        )
        other = network.random(6, Stream(2))
        require(other != genomes, ".random makes the same genomes from another stream")
        with checking(".random"):
            _check_genomes(network, genomes)
        if network.genes is None:
            require(network.ranges is None, ".ranges must be None where genes is")
        else:
            _check_genes(network, network.genes)
        valid = isinstance(network.state_size, int) and network.state_size >= 0
        require(valid, ".state_size must be an int >= 0")
        _check_operators(network, genomes)
        _check_changes(network, genomes)
        _check_distances(network, genomes)
        _check_refusals(network, genomes[0])
        _check_parameters(network, genomes)
        _check_decisions(network, genomes)
        _check_graph(network, genomes[0])


def _check_genomes(network: Representation, genomes: list[bytes]) -> None:
    length = network.genome_bytes
    for genome in genomes:
        require(
            isinstance(genome, bytes), f" must make bytes, not {type(genome).__name__}"
        )
        fits = length in (None, len(genome))
        require(fits, f": a genome must be {length} bytes, not {len(genome)}")


def _check_genes(network: Representation, count: int) -> None:
    length, ranges = network.genome_bytes, network.ranges
    require(
        length == 4 * count, f".genes: {count} float32 numbers are not {length} bytes"
    )
    found = (
        f"{ranges.shape} {ranges.dtype}"
        if isinstance(ranges, np.ndarray)
        else repr(ranges)
    )
    expected = f"{(count,)} float64"
    require(found == expected, f".ranges must be a {expected} array, not {found}")
    assert ranges is not None  # noqa: S101  checked above
    require(
        (np.isfinite(ranges) & (ranges > 0)).all(), ".ranges must be finite and above 0"
    )
    drawn = np.frombuffer(b"".join(network.random(64, Stream(5))), "<f4").reshape(
        64, count
    )
    reach = np.abs(drawn).max(axis=0) / ranges
    most, least = int(reach.argmax()), int(reach.argmin())
    require(reach[most] <= 1 + 1e-6, f".random: number {most} is beyond its range")
    uniform = f".random: number {least} is not uniform in plus or minus its range"
    require(reach[least] > 0.5, uniform)
    for number in (0.0, -1e30, 1e30):
        genome = np.full(count, number, "<f4").tobytes()
        text = f".genes: any finite numbers must be a genome, also all {number}"
        require_accepted(network, [genome], text)


def _check_operators(network: Representation, genomes: list[bytes]) -> None:
    operators: dict[str, Callable[[Stream], list[bytes]]] = {
        "random": lambda stream: network.random(4, stream),
        "mutate, method 1": lambda stream: network.mutate(
            genomes, stream, method=1, **MUTATION
        ),
        "mutate, method 2": lambda stream: network.mutate(
            genomes, stream, method=2, **MUTATION
        ),
        "crossover": lambda stream: [
            network.crossover(a, b, stream) for a, b in pairwise(genomes)
        ],
    }
    none = (
        network.random(0, Stream(3)),
        network.mutate([], Stream(3), method=1, **MUTATION),
    )
    require(none == ([], []), ": random of 0 and mutate of no genomes must make none")
    for operator, apply in operators.items():
        with checking(f".{operator}"):
            made = apply(Stream(3))
            repeats = made == apply(Stream(3))
            require(repeats, ": the same stream gives other genomes; draw only from it")
            if operator.startswith("mutate"):
                same = len(made) == len(genomes)
                require(same, f": {len(genomes)} genomes gave {len(made)}")
            _check_genomes(network, made)
            require_accepted(network, made, ": makes genomes that parameters refuses")


def _check_changes(network: Representation, genomes: list[bytes]) -> None:
    for method in (1, 2):
        stream, mutants = Stream(7), genomes
        for _ in range(MUTATIONS):
            mutants = network.mutate(
                mutants, stream, method=method, severity=0.3, probability=1.0
            )
        text = f".mutate, method {method}: all genomes are the same after {MUTATIONS} mutations"
        require(mutants != genomes, text)
    stream = Stream(8)
    children = [network.crossover(a, b, stream) for a, b in pairwise(genomes)]
    text = ".crossover: a child equals its mother and has nothing of its father"
    require(children != genomes[:-1], text)
    if network.crossover_draws is not None:
        text = f".crossover_draws: expected {network.crossover_draws} words for each crossover"
        expected = len(children) * network.crossover_draws
        require(stream.position == expected, f"{text}, not {stream.position} for all")


def _check_distances(network: Representation, genomes: list[bytes]) -> None:
    distances, count = network.distances(genomes, genomes), len(genomes)
    found = f"{distances.shape} {distances.dtype}"
    expected = f"({count}, {count}) float64"
    require(found == expected, f".distances must be {expected}, not {found}")
    require(not distances.diagonal().any(), ".distances: a genome differs from itself")
    require(np.array_equal(distances, distances.T), ".distances are not symmetric")
    require((distances >= 0).all(), ".distances: one is negative or NaN")
    for left, right in ((2, count), (count, 1), (1, 1)):
        some = network.distances(genomes[:left], genomes[-right:])
        text = ".distances: a pair's distance depends on the other genomes; "
        text += "numpy may add in another order"
        require(np.array_equal(some, distances[:left, -right:]), text)
    pairs = np.arange(count)[:, None]
    for columns in (1, 3):
        others = (pairs + 1 + np.arange(columns)) % count
        some = network.distances_between(genomes, pairs[:, 0], others)
        text = ".distances_between: other bits than .distances"
        require(np.array_equal(some, distances[pairs, others]), text)


def _check_refusals(network: Representation, genome: bytes) -> None:
    for fault, wrong in (
        ("one byte short", genome[:-1]),
        ("one byte long", genome + b"\0"),
        ("empty", b""),
        ("full of NaN", NAN * len(genome)),
    ):
        text = f".parameters of a genome that is {fault}"
        require_raises(ValueError, lambda w=wrong: network.parameters([genome, w]), text)  # type: ignore[misc]


def _check_parameters(network: Representation, genomes: list[bytes]) -> None:
    table = network.parameters(genomes)
    valid = table.dtype == np.float32 and table.ndim == 2 and len(table) == len(genomes)
    found = f"{table.shape} {table.dtype}"
    require(valid, f".parameters must be ({len(genomes)}, P) float32, not {found}")
    require(table.flags.c_contiguous, ".parameters must be C-contiguous")
    for genome, row in zip(genomes, table, strict=True):
        alone = network.parameters([genome])[0]
        same = np.array_equal(alone, row[: len(alone)]) and not row[len(alone) :].any()
        text = ".parameters: a genome's row depends on the other genomes; only zeros may follow it"
        require(same, text)


def _check_decisions(network: Representation, genomes: list[bytes]) -> None:
    compiled = not PLAIN and os.environ.get("NUMBA_DISABLE_JIT", "0") == "0"
    if compiled:
        _check_compiled(network)
    observations = _observations(network)
    rows = network.parameters(genomes)
    agents = [_Agent(network, network.step, row) for row in rows]
    with checking(".step"):
        decided = [agent.play(observations) for agent in agents]
        again = [agent.play(observations) for agent in reversed(agents)]
        text = (
            ": the same parameters and observations give another decision the second time"
        )
        require(decided == again[::-1], text)
        _check_state(agents, observations, decided)
        for genome, expected in zip(genomes, decided, strict=True):
            alone = _Agent(network, network.step, network.parameters([genome])[0])
            text = ": a genome decides differently alone and among longer ones"
            require(alone.play(observations) == expected, text)
        if compiled:
            with interpreted(), np.errstate(all="ignore"):
                plain = agents[0].play(observations)
            text = ": plain Python and the compiled form decide differently; type all constants, "
            text += "such as np.float32(0.5), and take functions from portable.py"
            require(plain == decided[0], text)
    if network.step_lanes is not None:
        _check_lanes(network, network.step_lanes, rows, observations)


def _check_compiled(network: Representation) -> None:
    for name in ("step", "step_lanes"):
        function = getattr(network, name)
        declared = isinstance(function, Compiled) and function.signature == STEP_SIGNATURE
        compiled = function is None or declared
        require(compiled, f".{name} must be compiled with jit.STEP_SIGNATURE")


def _check_state(
    agents: "list[_Agent]", observations: np.ndarray, expected: list[bytes]
) -> None:
    """Check that agents that decide in turn do as each does alone."""
    for agent in agents:
        agent.restart()
    turns = [[agent.act(observation) for agent in agents] for observation in observations]
    found = [b"".join(actions) for actions in zip(*turns, strict=True)]
    text = ": agents that decide in turn decide differently than alone; "
    text += "everything that is remembered must be in the state"
    require(found == expected, text)


def _check_lanes(
    network: Representation, step_lanes: Step, rows: np.ndarray, observations: np.ndarray
) -> None:
    """Check eight agents in one call, each with other parameters and observations."""
    chosen = rows[np.arange(LANES) % len(rows)]
    seen = [np.roll(observations, -lane, axis=0) for lane in range(LANES)]
    # Number k of a lane stands at 8 k + lane.
    together = np.stack(seen, axis=-1).reshape(len(observations), -1)
    with checking(".step_lanes"):
        played = _Agent(network, step_lanes, chosen.T.reshape(-1), LANES).play(together)
    decided = np.frombuffer(played, np.float32).reshape(-1, network.outputs, LANES)
    for lane in range(LANES):
        with checking(".step"):
            alone = _Agent(network, network.step, chosen[lane]).play(seen[lane])
        text = ".step_lanes: an agent decides differently than with step"
        require(decided[:, :, lane].tobytes() == alone, text)


def _check_graph(network: Representation, genome: bytes) -> None:
    nodes, edges = network.graph(genome)
    kinds = Counter(node.kind for node in nodes)
    parts = 1 + max((node.part for node in nodes), default=0)
    inputs, outputs = network.inputs, network.outputs
    complete = (kinds["input"], kinds["output"]) == (parts * inputs, parts * outputs)
    text = f".graph must have {inputs} inputs and {outputs} outputs per part, or states, "
    require(kinds["state"] or complete, f"{text}not {dict(kinds)}")
    for edge in edges:
        valid = 0 <= edge.source < len(nodes) and 0 <= edge.target < len(nodes)
        text = f".graph: an edge leads from {edge.source} to {edge.target}, of {len(nodes)} nodes"
        require(valid, text)
        require(np.isfinite(edge.weight), f".graph: a weight is {edge.weight}")
        require(nodes[edge.target].kind != "input", ".graph: an edge leads to an input")


def _observations(network: Representation) -> np.ndarray:
    drawn = Stream(4).uniform(-3.0, 3.0, DECISIONS * network.inputs)
    return drawn.reshape(DECISIONS, network.inputs).astype(np.float32)


class _Agent:
    """An agent whose arrays are surrounded by NaN, which a decision must neither read nor change.

    Args:
        lanes: agents that decide in one call.
    """

    def __init__(
        self, network: Representation, step: Step, parameters: np.ndarray, lanes: int = 1
    ) -> None:
        per_agent = (network.state_size, network.inputs, network.outputs)
        sizes = [len(parameters), *(lanes * size for size in per_agent)]
        self.guarded = [np.full(size + 2 * GUARD, np.nan, np.float32) for size in sizes]
        self.arrays = [whole[GUARD:-GUARD] for whole in self.guarded]
        self.arrays[0][:] = parameters
        self.unchanged = parameters.copy()
        self.step = step

    def restart(self) -> None:
        """Begin a trial."""
        self.arrays[1][:] = 0

    def act(self, observation: np.ndarray) -> bytes:
        """Make one decision and check it."""
        parameters, _, seen, output = self.arrays
        seen[:] = observation
        output[:] = np.nan
        self.step(*self.arrays)
        text = " leaves an output unset or sets NaN, or reads outside its arrays"
        require(not np.isnan(output).any(), text)
        outside = [
            np.concatenate([whole[:GUARD], whole[-GUARD:]]) for whole in self.guarded
        ]
        require(
            np.isnan(outside).all(),
            " writes outside its arrays: is state_size too small?",
        )
        same = np.array_equal(parameters, self.unchanged) and np.array_equal(
            seen, observation
        )
        require(same, " must change only state and output")
        return output.tobytes()

    def play(self, observations: np.ndarray) -> bytes:
        """Return a trial's decisions."""
        self.restart()
        return b"".join(map(self.act, observations))
