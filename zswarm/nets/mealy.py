"""Finite-state machines whose outputs follow from state and inputs.

Source: FREVO's ``MealyFSM`` (github.com/smartgrids-aau/Frevo, version 1.5), by A. Pinter-Bartha.

A decision: each input, times ``scale`` and cut to an integer, falls into a class: by so many thresholds, the number of those
that it reaches before the first that it does not; without any, by equal parts of ``minimum`` to ``maximum``, ``units`` + 1
of them. The classes of all inputs choose a row of the table, the state a column; there stand the outputs, in parts of
``output_units``, and the next state.

With ``rows = "product"`` the row is the product of (class + 1) over the inputs, less 1, as FREVO computes: so (1, 3) and (3,
1) have one row, and a part of the table is never read. With ``rows = "combinations"`` each combination has its own, the last
input counting fastest, as FREVO's documentation says.

Genome, little-endian: uint16 states, uint16 first state; int32 thresholds, input by input; per row and in it per state
uint16 next state; in the same order int32 outputs.

FREVO's other flaws, mended: changing thresholds fails if an input without any comes before one with some, and forgets where
the range begins; changing the first state swaps as many rows as there are inputs, not all; a new state lands at a wrong
place in the table; a deleted one leaves transitions that lead to it; deleting a transition has a setting, but does nothing
(here the machine then stays in its state); machines of different numbers of states cannot be crossed; an input out of its
range reads outside the table (here it counts as the nearest class). A mutation may move a threshold to where another one is.
"""

import struct
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta, field

from zswarm.draws import Stream
from zswarm.errors import ConfigError
from zswarm.jit import STEP_SIGNATURE, kernel
from zswarm.nets.graph import Edge, Graph, Node
from zswarm.nets.representation import Representation
from zswarm.portable import to_int

STATES = struct.Struct("<HH")
HEADER = 6  # of a row of parameters: states, first state, output units, whether rows are products, scale, where the table begins
PER_INPUT = 4  # thresholds, minimum, maximum, units; then the thresholds
LARGEST = 1 << 20  # numbers of a table

Chance = Annotated[float, Meta(ge=0, le=1)]
Bound = Annotated[int, Meta(ge=-1_000_000, le=1_000_000)]
Count = Annotated[int, Meta(ge=0, le=1000)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[representation]`` with ``kind = "mealy"``; lists have one number for all inputs, or one for each."""

    states: Annotated[int, Meta(ge=1, le=1000, description="states of a new machine")] = 6
    max_states: Annotated[int, Meta(ge=1, le=1000, description="states at most, if `add_state` is not 0")] = 20
    rows: Annotated[
        Literal["combinations", "product"],
        Meta(description="combinations: each has a row of the table; product: rows are chosen by FREVO's product of classes"),
    ] = "combinations"
    scale: Annotated[float, Meta(gt=0, le=1e6, description="an input is multiplied by this and cut to an integer")] = 100.0
    thresholds: Annotated[
        list[Count], Meta(min_length=1, description="thresholds of each input, to 1,000; 0: `units` + 1 classes of equal width")
    ] = field(default_factory=lambda: [1])
    minimum: Annotated[list[Bound], Meta(min_length=1, description="least value of each input, after `scale`")] = field(
        default_factory=lambda: [0]
    )
    maximum: Annotated[list[Bound], Meta(min_length=1, description="greatest value")] = field(default_factory=lambda: [100])
    units: Annotated[
        list[Count], Meta(min_length=1, description="steps from least to greatest, 1 to 1,000: thresholds lie on them")
    ] = field(default_factory=lambda: [100])
    output_units: Annotated[int, Meta(ge=1, le=1_000_000, description="an output is a whole number of these parts of 1")] = 100
    add_state: Annotated[Chance, Meta(description="chance of a mutant to get another state")] = 0.0
    delete_state: Annotated[Chance, Meta(description="chance to lose one")] = 0.0
    delete_transition: Annotated[Chance, Meta(description="chance of each transition to stay in its state")] = 0.01
    change_first_state: Annotated[Chance, Meta(description="chance to begin in another state")] = 0.01
    change_output: Annotated[Chance, Meta(description="chance of each output to be drawn anew")] = 0.01
    change_next_state: Annotated[Chance, Meta(description="chance of each transition to lead elsewhere")] = 0.01
    change_threshold: Annotated[Chance, Meta(description="chance of each threshold to be drawn anew")] = 0.01


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """One decision; ``state`` is the machine's state plus 1, or 0 where it has not begun."""
    states, units, product = int(parameters[0]), parameters[2], int(parameters[3])
    current = int(parameters[1]) if state[0] == 0 else int(state[0]) - 1
    table = int(parameters[5])
    row, combinations = product, 1
    at = HEADER
    for index in range(observation.shape[0]):
        value = to_int(np.float64(observation[index] * parameters[4]))
        thresholds = int(parameters[at])
        if thresholds > 0:
            classes, place = thresholds + 1, 0
            while place < thresholds and value >= parameters[at + PER_INPUT + place]:
                place += 1
        else:
            least, most = int(parameters[at + 1]), int(parameters[at + 2])
            value = min(max(value, least), most)
            classes = int(parameters[at + 3]) + 1
            # As there, in float32: (value - least) units / (most - least), cut.
            place = int(np.float32((value - least) * (classes - 1)) / np.float32(most - least))
        row = row * (place + 1) if product else row * classes + place
        combinations *= classes
        at += PER_INPUT + thresholds
    entry = (row - product) * states + current
    state[0] = np.float32(parameters[table + entry] + np.float32(1))
    outputs = table + combinations * states + entry * output.shape[0]
    for index in range(output.shape[0]):
        output[index] = parameters[outputs + index] / units


class Machine(NamedTuple):
    """A genome taken apart."""

    first: int  # state
    thresholds: np.ndarray  # (thresholds of all inputs,) int32
    following: np.ndarray  # (rows, states) uint16
    outputs: np.ndarray  # (rows, states, outputs) int32

    def genome(self) -> bytes:
        """The bytes."""
        return STATES.pack(self.following.shape[1], self.first) + b"".join(
            array.astype(dtype).tobytes()
            for array, dtype in ((self.thresholds, "<i4"), (self.following, "<u2"), (self.outputs, "<i4"))
        )


class Mealy(Representation):
    """Finite-state machines: inputs fall into classes, and a table says outputs and next state.

    ``mutate``: each of the seven mutations with its chance from the settings times ``probability``; both methods, and any
    ``severity``, are the same.
    """

    settings_type = Settings
    step = staticmethod(step)
    settings: Settings
    state_size = 1

    def __init__(self, settings: Settings, inputs: int, outputs: int) -> None:
        super().__init__(settings, inputs, outputs)
        self._per_input = np.array(
            [self._each(name) for name in ("thresholds", "minimum", "maximum", "units")], np.int64
        ).T  # (inputs, 4)
        if (self._per_input[:, 1] >= self._per_input[:, 2]).any():
            raise ConfigError("representation: minimum must be less than maximum, for each input")
        if (self._per_input[:, 3] < 1).any():
            raise ConfigError("representation: units must be at least 1, for each input")
        if settings.max_states < settings.states and settings.add_state:
            raise ConfigError(f"representation: max_states must be at least states, {settings.states}, not {settings.max_states}")
        self.rows = 1
        for thresholds, _, _, units in self._per_input.tolist():
            self.rows *= (thresholds or units) + 1
        self._varies = settings.add_state > 0 or settings.delete_state > 0
        self._most = settings.max_states if settings.add_state else settings.states
        if self.rows * self._most * (outputs + 1) > LARGEST:
            raise ConfigError(
                f"representation: a mealy machine's table would have {self.rows:,} rows of {self._most} states, which are "
                f"{self.rows * self._most * (outputs + 1):,} numbers; at most {LARGEST:,}: use fewer thresholds or states"
            )
        self._thresholds = int(np.add.reduce(self._per_input[:, 0]))
        self.genome_bytes = None if self._varies else self._length(settings.states)

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """See ``HEADER`` and ``PER_INPUT``; then the next states and the outputs. Rows of fewer states end in zeros."""
        rows = [self._row(genome) for genome in genomes]
        table = np.zeros((len(rows), max(map(len, rows), default=HEADER)), np.float32)
        for into, row in zip(table, rows, strict=True):
            into[: len(row)] = row
        return table

    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Begin in state 0; all else uniform."""
        return [self._random(stream).genome() for _ in range(count)]

    def mutate(
        self,
        genomes: Sequence[bytes],
        stream: Stream,
        *,
        method: int,  # noqa: ARG002  there is one
        severity: float,  # noqa: ARG002  whatever changes is drawn anew
        probability: float,
    ) -> list[bytes]:
        """See the class; in FREVO's order, deleted transitions last."""
        mutants = []
        for genome in genomes:
            machine = self._taken_apart(genome)
            add, delete, first = stream.uniform(0.0, 1.0, 3) / probability
            if add < self.settings.add_state and machine.following.shape[1] < self.settings.max_states:
                machine = self._with_state(machine, stream)
            if delete < self.settings.delete_state and machine.following.shape[1] > 1:
                machine = self._without_state(machine, stream)
            machine = self._changed(machine, stream, probability)
            states = machine.following.shape[1]
            if first < self.settings.change_first_state and states > 1:
                machine = machine._replace(first=_other(machine.first, states, stream))
            mutants.append(machine.genome())
        return mutants

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """FREVO's uniform crossover: the first state, each input's thresholds, each next state and output of either parent.

        The child has as many states as the mother; of the father count those that she has, too, and what leads to such.
        """
        hers, his = self._taken_apart(mother), self._taken_apart(father)
        states = hers.following.shape[1]
        both = min(states, his.following.shape[1])
        inputs, nexts = self.inputs, self.rows * both
        chosen = stream.uniform(0.0, 1.0, 1 + inputs + nexts * (1 + self.outputs)) < 0.5
        by_input = np.repeat(chosen[1 : 1 + inputs], self._per_input[:, 0])
        following = his.following[:, :both]
        taken = chosen[1 + inputs : 1 + inputs + nexts].reshape(following.shape) & (following < states)
        hers.following[:, :both] = np.where(taken, following, hers.following[:, :both])
        taken = chosen[1 + inputs + nexts :].reshape(self.rows, both, self.outputs)
        hers.outputs[:, :both] = np.where(taken, his.outputs[:, :both], hers.outputs[:, :both])
        return hers._replace(
            first=his.first if chosen[0] and his.first < states else hers.first,
            thresholds=np.where(by_input, his.thresholds, hers.thresholds),
        ).genome()

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """How many numbers differ: first state, thresholds, next states, outputs; those of states that one has, too.

        FREVO counts digits of a text, without the thresholds.
        """
        tables = [np.array([self._padded(genome) for genome in side]) for side in (left, right)]
        found = np.empty((len(left), len(right)))
        for row, numbers in enumerate(tables[0]):
            found[row] = np.count_nonzero(tables[1] != numbers, axis=1)
        return found

    def graph(self, genome: bytes) -> Graph:
        """States and transitions: how many rows of the table lead from one to another."""
        self.parameters([genome])  # refuses what is no machine
        machine = self._taken_apart(genome)
        states = machine.following.shape[1]
        nodes = [Node("state", state, "the first one" if state == machine.first else "") for state in range(states)]
        edges = []
        for state in range(states):
            counts = np.bincount(machine.following[:, state], minlength=states)
            edges += [
                Edge(state, target, count / self.rows, f"{count} of {self.rows} combinations of inputs")
                for target, count in enumerate(counts.tolist())
                if count
            ]
        return Graph(nodes, edges)

    # ---- genomes --------------------------------------------------------------------------------------------------

    def _each(self, name: str) -> list[int]:
        given = getattr(self.settings, name)
        if len(given) not in (1, self.inputs):
            raise ConfigError(f"representation: {name}: expected one number, or {self.inputs}, one per input, not {len(given)}")
        return list(given) * (self.inputs if len(given) == 1 else 1)

    def _length(self, states: int) -> int:
        return STATES.size + 4 * self._thresholds + self.rows * states * (2 + 4 * self.outputs)

    def _taken_apart(self, genome: bytes) -> Machine:
        """Copies of its arrays, to change."""
        states, first = STATES.unpack_from(genome)
        at = STATES.size + 4 * self._thresholds
        entries = self.rows * states
        return Machine(
            first,
            np.frombuffer(genome, "<i4", self._thresholds, STATES.size).copy(),
            np.frombuffer(genome, "<u2", entries, at).reshape(self.rows, states).copy(),
            np.frombuffer(genome, "<i4", entries * self.outputs, at + 2 * entries)
            .reshape(self.rows, states, self.outputs)
            .copy(),
        )

    def _row(self, genome: bytes) -> np.ndarray:
        states = STATES.unpack_from(genome)[0] if len(genome) >= STATES.size else 0
        fits = 1 <= states <= self._most if self._varies else states == self.settings.states
        if not fits or len(genome) != self._length(states):
            wanted = f"up to {self._most}" if self._varies else f"{self._most}"
            raise ValueError(f"a genome has {len(genome)} bytes and {states} states; this machine has {wanted} states")
        machine = self._taken_apart(genome)
        if machine.first >= states or (machine.following >= states).any():
            raise ValueError(f"a genome leads to a state beyond its {states}")
        if ((machine.outputs < 0) | (machine.outputs > self.settings.output_units)).any():
            raise ValueError(f"a genome has an output that is not in 0..{self.settings.output_units}")
        if (np.abs(machine.thresholds.astype(np.int64)) > 2_000_000).any():
            raise ValueError("a genome has a threshold beyond 2,000,000")
        inputs, at = [], 0
        for of in self._per_input.tolist():
            inputs.append(np.array(of, np.float32))
            inputs.append(machine.thresholds[at : at + of[0]].astype(np.float32))
            at += of[0]
        table = HEADER + PER_INPUT * self.inputs + self._thresholds
        product = self.settings.rows == "product"
        header = np.array([states, machine.first, self.settings.output_units, product, self.settings.scale, table], np.float32)
        numbers = (machine.following.ravel(), machine.outputs.ravel())
        return np.concatenate([header, *inputs, *(array.astype(np.float32) for array in numbers)])

    def _padded(self, genome: bytes) -> np.ndarray:
        """All numbers of a machine, those of states that it does not have -1."""
        machine = self._taken_apart(genome)
        missing = self._most - machine.following.shape[1]
        following = np.pad(machine.following.astype(np.int64), ((0, 0), (0, missing)), constant_values=-1)
        outputs = np.pad(machine.outputs.astype(np.int64), ((0, 0), (0, missing), (0, 0)), constant_values=-1)
        return np.concatenate([[machine.first], machine.thresholds, following.ravel(), outputs.ravel()])

    # ---- what is drawn --------------------------------------------------------------------------------------------

    def _random(self, stream: Stream) -> Machine:
        states, entries = self.settings.states, self.rows * self.settings.states
        return Machine(
            0,
            self._drawn_thresholds(stream),
            stream.integers(states, entries).reshape(self.rows, states),
            self._drawn_outputs(stream, entries).reshape(self.rows, states, self.outputs),
        )

    def _drawn_outputs(self, stream: Stream, entries: int) -> np.ndarray:
        return stream.integers(self.settings.output_units + 1, entries * self.outputs)

    def _drawn_thresholds(self, stream: Stream) -> np.ndarray:
        """On the steps of their inputs, the last one left out, as there; rising for each input."""
        drawn = []
        for thresholds, least, most, units in self._per_input.tolist():
            drawn.append(np.sort(least + (most - least) // units * stream.integers(units, thresholds)))
        return np.concatenate(drawn).astype(np.int64)

    def _changed(self, machine: Machine, stream: Stream, probability: float) -> Machine:
        """Thresholds, outputs, next states, and deleted transitions."""
        settings, states = self.settings, machine.following.shape[1]
        entries = self.rows * states

        def hit(chance: float, count: int) -> np.ndarray:
            return stream.uniform(0.0, 1.0, count) < chance * probability

        thresholds = np.where(
            hit(settings.change_threshold, self._thresholds), self._drawn_thresholds(stream), machine.thresholds
        )
        ends = np.add.accumulate(self._per_input[:, 0])[:-1]
        thresholds = np.concatenate([np.sort(of) for of in np.split(thresholds, ends)])
        outputs = machine.outputs.ravel()
        outputs = np.where(hit(settings.change_output, entries * self.outputs), self._drawn_outputs(stream, entries), outputs)
        following = machine.following.ravel().astype(np.int64)
        elsewhere = (following + 1 + stream.integers(max(1, states - 1), entries)) % states
        following = np.where(hit(settings.change_next_state, entries), elsewhere, following)
        itself = np.tile(np.arange(states), self.rows)
        following = np.where(hit(settings.delete_transition, entries), itself, following)
        return Machine(
            machine.first, thresholds, following.reshape(self.rows, states), outputs.reshape(self.rows, states, self.outputs)
        )

    def _with_state(self, machine: Machine, stream: Stream) -> Machine:
        """One more, the last, to which nothing leads yet."""
        states = machine.following.shape[1]
        following = stream.integers(states + 1, self.rows).reshape(self.rows, 1)
        outputs = self._drawn_outputs(stream, self.rows).reshape(self.rows, 1, self.outputs)
        return machine._replace(
            following=np.concatenate([machine.following, following], axis=1),
            outputs=np.concatenate([machine.outputs, outputs], axis=1),
        )

    def _without_state(self, machine: Machine, stream: Stream) -> Machine:
        """Without a random one; what led to it leads to random others."""
        states = machine.following.shape[1]
        lost = stream.integer(states)
        following = np.delete(machine.following, lost, axis=1).astype(np.int64)
        others = stream.integers(states - 1, following.size).reshape(following.shape)
        following = np.where(following == lost, others, following - (following > lost))
        first = stream.integer(states - 1) if machine.first == lost else machine.first - (machine.first > lost)
        return machine._replace(first=first, following=following, outputs=np.delete(machine.outputs, lost, axis=1))


def _other(state: int, states: int, stream: Stream) -> int:
    return (state + 1 + stream.integer(states - 1)) % states
