"""Fully-meshed recurrent network, exactly FREVO's ``FullyMeshedNet`` (github.com/smartgrids-aau/Frevo, version 1.5).

Nodes are numbered inputs, hidden, outputs; every non-input node hears every node, itself included. One decision repeats
``iterations`` times: clamp the inputs, compute all activations from the previous outputs, then set all outputs. Outputs
last from one decision to the next. FREVO's random source (noise on the biases) is not offered: it is off by default there.
``tanh`` is an activation that FREVO does not have.

Genome: per non-input node (hidden, then outputs) the weights from nodes 0..N-1, then its bias; float32, little-endian.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream
from zswarm.jit import STEP_SIGNATURE, float32, inline, kernel
from zswarm.lanes import LANES, fill, load, select, store
from zswarm.nets.representation import Representation
from zswarm.portable import sigmoid, tanh

ACTIVATIONS = ("clamp", "sigmoid", "relu", "tanh")
CLAMP, SIGMOID, RELU, TANH = range(4)
BLOCK = 64_000  # differences of genes that are held at once: 256 kB stay in the processor's cache
HEADER = 4  # iterations, activation, neurons, 0
ZERO, ONE = np.float32(0), np.float32(1)


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[representation]`` with ``kind = "fully-meshed"``."""

    hidden: Annotated[int, Meta(ge=0, le=1000, description="nodes beside inputs and outputs")] = 2
    iterations: Annotated[int, Meta(ge=1, le=100, description="updates of all nodes in one decision")] = 2
    activation: Annotated[
        Literal["clamp", "sigmoid", "relu", "tanh"],
        Meta(description="clamp: cut to 0..1; sigmoid: 1 / (1 + e^-x); relu: negative is 0; tanh: -1..1, within 3.7e-5"),
    ] = "clamp"
    weight_range: Annotated[
        float,
        Meta(gt=0, le=1e6, description="new weights are uniform in plus or minus this; method 1 of mutation scales with it"),
    ] = 2.0
    bias_range: Annotated[float, Meta(gt=0, le=1e6, description="the same of biases")] = 2.0


@inline
def activate(activation, state, at, to, wanted):  # type: ignore[no-untyped-def]  # compiled
    """Eight outputs from eight sums, of which so many are wanted."""
    sums = load(state, at)
    if activation == CLAMP:
        positive = select(sums < ZERO, ZERO, sums)
        store(state, to, select(positive > ONE, ONE, positive))
    elif activation == RELU:
        store(state, to, select(sums < ZERO, ZERO, sums))
    elif activation == TANH:
        store(state, to, tanh(sums))
    else:
        for lane in range(wanted):
            state[to + lane] = float32(sigmoid(np.float64(state[at + lane])))


@inline
def take(array, at):  # type: ignore[no-untyped-def]  # compiled
    """What four neurons have, eight agents each."""
    return load(array, at), load(array, at + LANES), load(array, at + 2 * LANES), load(array, at + 3 * LANES)


@inline
def put(sums, array, at):  # type: ignore[no-untyped-def]  # compiled
    """Write it."""
    for neuron in range(4):
        store(array, at + neuron * LANES, sums[neuron])


@inline
def add(sums, parameters, at, value):  # type: ignore[no-untyped-def]  # compiled
    """Add what one source gives to four neurons."""
    weights = take(parameters, at)
    return (
        sums[0] + weights[0] * value,
        sums[1] + weights[1] * value,
        sums[2] + weights[2] * value,
        sums[3] + weights[3] * value,
    )


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """One decision; the sums run over the sources in order, eight neurons side by side.

    The inputs do not change between iterations, so what they add is summed once and each iteration goes on from there:
    the same additions in the same order as FREVO's.
    """
    iterations, activation, neurons = int(parameters[0]), int(parameters[1]), int(parameters[2])
    padded = state.shape[0] // 3
    from_inputs, fresh = padded, 2 * padded  # behind the outputs
    inner = HEADER + observation.shape[0] * padded
    biases = inner + neurons * padded
    for first in range(0, padded, LANES):
        sums = fill(ZERO)
        for source in range(observation.shape[0]):
            sums = sums + load(parameters, HEADER + source * padded + first) * observation[source]
        store(state, from_inputs + first, sums)
    for _ in range(iterations):
        for first in range(0, padded, LANES):
            sums = load(state, from_inputs + first)
            for neuron in range(neurons):
                sums = sums + load(parameters, inner + neuron * padded + first) * state[neuron]
            store(state, fresh + first, load(parameters, biases + first) + sums)
        for first in range(0, padded, LANES):
            activate(activation, state, fresh + first, first, min(LANES, neurons - first))
    for index in range(output.shape[0]):
        output[index] = state[neurons - output.shape[0] + index]


@kernel(STEP_SIGNATURE)
def step_lanes(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """``step`` of eight agents, one in each lane; the sums of four neurons at a time, for they wait for one another."""
    iterations, activation, neurons = int(parameters[0]), int(parameters[LANES]), int(parameters[2 * LANES])
    row = state.shape[0] // 3  # the numbers of all neurons
    from_inputs, fresh = row, 2 * row
    inputs, outputs = observation.shape[0] // LANES, output.shape[0] // LANES
    inner = HEADER * LANES + inputs * row
    biases = inner + neurons * row
    for first in range(0, neurons * LANES, 4 * LANES):
        sums = fill(ZERO), fill(ZERO), fill(ZERO), fill(ZERO)
        for source in range(inputs):
            sums = add(sums, parameters, HEADER * LANES + source * row + first, load(observation, source * LANES))
        put(sums, state, from_inputs + first)
    for _ in range(iterations):
        for first in range(0, neurons * LANES, 4 * LANES):
            sums = take(state, from_inputs + first)
            for neuron in range(neurons):
                sums = add(sums, parameters, inner + neuron * row + first, load(state, neuron * LANES))
            put(add(sums, parameters, biases + first, fill(ONE)), state, fresh + first)
        for first in range(0, neurons * LANES, LANES):
            activate(activation, state, fresh + first, first, LANES)
    for index in range(outputs):
        store(output, index * LANES, load(state, (neurons - outputs + index) * LANES))


class FullyMeshed(Representation):
    """See the module's text; ``neurons`` are the non-input nodes."""

    settings_type = Settings
    step = staticmethod(step)
    step_lanes = staticmethod(step_lanes)
    settings: Settings

    def __init__(self, settings: Settings, inputs: int, outputs: int) -> None:
        super().__init__(settings, inputs, outputs)
        self.neurons = settings.hidden + outputs
        self.sources = inputs + self.neurons
        self.shape = (self.neurons, self.sources + 1)  # a genome as a table: weights, then the bias, per neuron
        self.genes = self.neurons * (self.sources + 1)
        self.genome_bytes = 4 * self.genes
        self._padded = -(-self.neurons // LANES) * LANES
        self.state_size = 3 * self._padded
        self._ranges = np.full(self.shape, settings.weight_range)
        self._ranges[:, -1] = settings.bias_range
        self.ranges = self._ranges.ravel()

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Header, then per source its weights to all neurons (padded with zeros), then the biases."""
        for genome in genomes:
            if len(genome) != self.genome_bytes:
                raise ValueError(f"a genome has {len(genome)} bytes; this network takes {self.genome_bytes}")
        table = self._tables(genomes)
        if not np.isfinite(table).all():
            raise ValueError("a genome holds a number that is not finite")
        rows = np.zeros((len(genomes), HEADER + (self.sources + 1) * self._padded), np.float32)
        rows[:, :3] = self.settings.iterations, ACTIVATIONS.index(self.settings.activation), self.neurons
        body = rows[:, HEADER:].reshape(len(genomes), self.sources + 1, self._padded)
        body[:, :, : self.neurons] = table.transpose(0, 2, 1)
        return rows

    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Weights uniform on +-weight_range, biases on +-bias_range."""
        draws = stream.uniform(-1.0, 1.0, count * self._ranges.size).reshape(count, *self.shape)
        return _split(draws * self._ranges)

    def mutate(
        self, genomes: Sequence[bytes], stream: Stream, *, method: int, severity: float, probability: float
    ) -> list[bytes]:
        """FREVO's mutations of each gene, with the given probability.

        Method 1 adds U(-s, s), s = severity times the weight or bias range. Method 2 is relative, as FREVO's code has it:
        s = max(w / 5, 0.1) for a weight (so 0.1 for every negative one), s = max(b / 5, 10) cut to an integer for a bias.
        """
        tables = self._tables(genomes)
        hit = stream.uniform(0.0, 1.0, tables.size).reshape(tables.shape) < probability
        draws = stream.uniform(-1.0, 1.0, tables.size).reshape(tables.shape)
        if method == 1:
            reach = severity * self._ranges
        else:
            reach = np.maximum(tables.astype(np.float64) / 5.0, 0.1)
            reach[..., -1] = np.trunc(np.maximum(tables[..., -1].astype(np.float64) / 5.0, 10.0))
        return _split(np.where(hit, tables + (draws * reach).astype(np.float32), tables))

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """The mother with one block of neurons (their weights and biases) of the father, cut at the last neuron."""
        length = 1 + stream.integer(max(1, self.neurons - 1))
        start = stream.integer(self.neurons)
        row = 4 * (self.sources + 1)
        begin, end = start * row, min(start + length, self.neurons) * row
        return mother[:begin] + father[begin:end] + mother[end:]

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Sums of the absolute differences of all genes, added in gene order."""
        # Along its first axis numpy adds one row after the other; numbers that are a single column it adds in pairs.
        columns = right if len(right) != 1 else [*right, *right]
        a, b = (np.ascontiguousarray(self._tables(side).reshape(len(side), self._ranges.size).T) for side in (left, columns))
        total = np.empty((len(left), len(columns)))
        rows = max(1, BLOCK // max(1, b.size))
        for begin in range(0, len(left), rows):
            block = a[:, begin : begin + rows, None] - b[:, None, :]
            np.add.reduce(np.abs(block, out=block), axis=0, dtype=np.float64, out=total[begin : begin + rows])
        return total[:, : len(right)]

    def _tables(self, genomes: Sequence[bytes]) -> np.ndarray:
        return np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), *self.shape)


def _split(tables: np.ndarray) -> list[bytes]:
    return [table.tobytes() for table in tables.astype("<f4")]
