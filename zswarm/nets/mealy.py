"""Finite-state machines whose outputs follow from state and inputs.

Source: ``MealyFSM`` of FREVO 1.5, github.com/smartgrids-aau/Frevo, by A. Pinter-Bartha. How a
machine decides, the genome, the mutations, and what differs from FREVO: docs/representations.md.
"""

import functools
import itertools
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta, field

from zswarm.config.meta import PartSettings, about, above, within
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.nets.graph import Edge, Graph, Node
from zswarm.nets.mealy_kernel import HEADER, step
from zswarm.nets.representation import Representation, stacked

LARGEST = 1 << 20  # numbers of a table

Chance = Annotated[float, Meta(ge=0, le=1)]
States = Annotated[int, Meta(ge=1, le=1000)]
Bounds = Annotated[
    list[Annotated[int, Meta(ge=-1_000_000, le=1_000_000)]], Meta(min_length=1)
]
Counts = Annotated[list[Annotated[int, Meta(ge=0, le=1000)]], Meta(min_length=1)]


class MealySettings(PartSettings, frozen=True):
    """Settings of ``[representation]`` with ``kind = "mealy"``.

    Lists have one number for all inputs, or one per input.
    """

    states: Annotated[States, about("states of a new machine")] = 6
    max_states: Annotated[
        States, about("maximum number of states, if `add_state` is not 0")
    ] = 20
    rows: Annotated[
        Literal["combinations", "product"],
        about("combinations: a table row for each combination; product: as in FREVO"),
    ] = "combinations"
    scale: Annotated[
        float, above(0, 1e6, "an input is multiplied by this, then truncated")
    ] = 100.0
    thresholds: Annotated[
        Counts, about("thresholds of each input; 0: `units` + 1 classes of equal width")
    ] = field(default_factory=lambda: [1])
    minimum: Annotated[Bounds, about("minimum scaled value of each input")] = field(
        default_factory=lambda: [0]
    )
    maximum: Annotated[Bounds, about("maximum scaled value of each input")] = field(
        default_factory=lambda: [100]
    )
    units: Annotated[
        Counts, about("steps from minimum to maximum, at least 1; thresholds lie on them")
    ] = field(default_factory=lambda: [100])
    output_units: Annotated[
        int, within(1, 1_000_000, "an output is a multiple of 1 / this")
    ] = 100
    add_state: Annotated[Chance, about("chance to add a state")] = 0.0
    delete_state: Annotated[Chance, about("chance to delete a state")] = 0.0
    delete_transition: Annotated[
        Chance, about("chance that a transition keeps its state")
    ] = 0.01
    change_first_state: Annotated[Chance, about("chance to redraw the first state")] = (
        0.01
    )
    change_output: Annotated[Chance, about("chance to redraw each output")] = 0.01
    change_next_state: Annotated[Chance, about("chance to redirect each transition")] = (
        0.01
    )
    change_threshold: Annotated[Chance, about("chance to redraw each threshold")] = 0.01


class Machine(NamedTuple):
    """A decoded genome."""

    first: int  # state
    thresholds: np.ndarray  # (thresholds of all inputs,) int32
    following: np.ndarray  # (rows, states) uint16
    outputs: np.ndarray  # (rows, states, outputs) int32

    @property
    def states(self) -> int:
        """Return the number of states."""
        return int(self.following.shape[1])

    def genome(self) -> bytes:
        """Encode the machine."""
        layout = _layout(len(self.thresholds), self.outputs.shape)
        return np.array((self.states, *self), layout).tobytes()


@functools.lru_cache
def _layout(thresholds: int, table: tuple[int, ...]) -> np.dtype[np.void]:
    """Return the layout of a genome whose table is (rows, states, outputs)."""
    return np.dtype(
        [
            ("states", "<u2"),
            ("first", "<u2"),
            ("thresholds", "<i4", (thresholds,)),
            ("following", "<u2", table[:2]),
            ("outputs", "<i4", table),
        ]
    )


class Mealy(Representation):
    """Finite-state machines: inputs fall into classes, and a table gives outputs and next state.

    ``mutate``: each of the seven mutations with its chance from the settings times ``probability``.
    Both methods, and all severities, are the same.
    """

    settings_type = MealySettings
    step = staticmethod(step)
    settings: MealySettings
    state_size = 1

    def __init__(self, settings: MealySettings, inputs: int, outputs: int) -> None:
        super().__init__(settings, inputs, outputs)
        names = ("thresholds", "minimum", "maximum", "units")
        self._per_input = np.array([self._each(name) for name in names], np.int64).T
        if (self._per_input[:, 1] >= self._per_input[:, 2]).any():
            raise ConfigError(
                "representation: minimum must be less than maximum, for each input"
            )
        if (self._per_input[:, 3] < 1).any():
            raise ConfigError("representation: units must be at least 1, for each input")
        if settings.max_states < settings.states and settings.add_state:
            raise ConfigError(
                "representation: max_states must be at least states, "
                f"{settings.states}, not {settings.max_states}"
            )
        self.rows = 1
        for thresholds, _, _, units in self._per_input.tolist():
            self.rows *= (thresholds or units) + 1
        self._varies = settings.add_state > 0 or settings.delete_state > 0
        self._most = settings.max_states if settings.add_state else settings.states
        numbers = self.rows * self._most * (outputs + 1)
        if numbers > LARGEST:
            raise ConfigError(
                f"representation: a mealy machine's table would have {self.rows:,} rows of "
                f"{self._most} states, which are {numbers:,} numbers; at most {LARGEST:,}: use "
                "fewer thresholds or states"
            )
        self._head, self._thresholds_at = self._head_of_rows()
        self._thresholds = len(self._thresholds_at)
        self.genome_bytes = (
            None if self._varies else self._layout(settings.states).itemsize
        )

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return rows as described at ``HEADER``; rows of fewer states end in zeros."""
        return stacked([self._row(genome) for genome in genomes], HEADER)

    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Draw machines that begin in state 0; all else is uniform."""
        states, entries = self.settings.states, self.rows * self.settings.states
        genomes = []
        for _ in range(count):
            thresholds = self._drawn_thresholds(stream)
            following = stream.integers(states, entries).reshape(self.rows, states)
            outputs = self._drawn_outputs(stream, states)
            genomes.append(Machine(0, thresholds, following, outputs).genome())
        return genomes

    def mutate(
        self,
        genomes: Sequence[bytes],
        stream: Stream,
        *,
        method: int,  # noqa: ARG002  both are the same
        severity: float,  # noqa: ARG002  what changes is drawn again
        probability: float,
    ) -> list[bytes]:
        """Mutate in FREVO's order, deleted transitions last."""
        settings, mutants = self.settings, []
        for genome in genomes:
            machine = self._decoded(genome)
            add, delete, first = stream.uniform(0.0, 1.0, 3) / probability
            if add < settings.add_state and machine.states < settings.max_states:
                machine = self._with_state(machine, stream)
            if delete < settings.delete_state and machine.states > 1:
                machine = self._without_state(machine, stream)
            machine = self._changed(machine, stream, probability)
            if first < settings.change_first_state and machine.states > 1:
                other = machine.first + 1 + stream.integer(machine.states - 1)
                machine = machine._replace(first=other % machine.states)
            mutants.append(machine.genome())
        return mutants

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """Cross as FREVO does uniformly: first state, thresholds of each input, each table entry.

        The child has as many states as the mother. Of the father's table only states that she has,
        and transitions to them, count.
        """
        hers, his = self._decoded(mother), self._decoded(father)
        states, inputs = hers.states, self.inputs
        both = min(states, his.states)
        begin, end = 1 + inputs, 1 + inputs + self.rows * both
        chosen = stream.uniform(0.0, 1.0, end + self.rows * both * self.outputs) < 0.5
        by_input = np.repeat(chosen[1:begin], self._per_input[:, 0])
        following = his.following[:, :both]
        taken = chosen[begin:end].reshape(following.shape) & (following < states)
        hers.following[:, :both] = np.where(taken, following, hers.following[:, :both])
        taken = chosen[end:].reshape(self.rows, both, self.outputs)
        hers.outputs[:, :both] = np.where(
            taken, his.outputs[:, :both], hers.outputs[:, :both]
        )
        first = his.first if chosen[0] and his.first < states else hers.first
        thresholds = np.where(by_input, his.thresholds, hers.thresholds)
        return hers._replace(first=first, thresholds=thresholds).genome()

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Count the numbers that differ, including those of states that only one machine has.

        FREVO counts digits of a text, without the thresholds.
        """
        a, b = (
            np.array([self._padded(genome) for genome in side]) for side in (left, right)
        )
        counts = [np.count_nonzero(b != numbers, axis=1) for numbers in a]
        return np.array(counts, np.float64).reshape(len(left), len(right))

    def graph(self, genome: bytes) -> Graph:
        """Return states and transitions, with the share of table rows that take each."""
        self.parameters([genome])  # checks the genome
        machine = self._decoded(genome)
        nodes, edges = [], []
        for state in range(machine.states):
            nodes.append(
                Node("state", state, "the first one" if state == machine.first else "")
            )
            counts = np.bincount(machine.following[:, state], minlength=machine.states)
            for target in np.flatnonzero(counts).tolist():
                text = f"{counts[target]} of {self.rows} combinations of inputs"
                edges.append(Edge(state, target, int(counts[target]) / self.rows, text))
        return Graph(nodes, edges)

    # ---- genomes

    def _each(self, name: str) -> list[int]:
        """Return a setting's number for each input."""
        given = getattr(self.settings, name)
        if len(given) not in (1, self.inputs):
            text = (
                f"expected one number, or {self.inputs}, one per input, not {len(given)}"
            )
            raise ConfigError(f"representation: {name}: {text}")
        return list(given) * (self.inputs if len(given) == 1 else 1)

    def _layout(self, states: int) -> np.dtype[np.void]:
        return _layout(self._thresholds, (self.rows, states, self.outputs))

    def _decoded(self, genome: bytes) -> Machine:
        """Return a machine whose arrays may be changed."""
        layout = self._layout(int.from_bytes(genome[:2], "little"))
        _, first, *arrays = np.frombuffer(genome, layout)[0].copy()
        return Machine(int(first), *arrays)

    def _checked(self, genome: bytes) -> Machine:
        states = int.from_bytes(genome[:2], "little")
        fits = (
            1 <= states <= self._most if self._varies else states == self.settings.states
        )
        if not fits or len(genome) != self._layout(states).itemsize:
            up_to = "up to " if self._varies else ""
            raise ValueError(
                f"a genome has {len(genome)} bytes and {states} states; this machine has "
                f"{up_to}{self._most} states"
            )
        machine, most = self._decoded(genome), self.settings.output_units
        if machine.first >= states or (machine.following >= states).any():
            raise ValueError(f"a genome leads to a state beyond its {states}")
        if ((machine.outputs < 0) | (machine.outputs > most)).any():
            raise ValueError(f"a genome has an output that is not in 0..{most}")
        if (np.abs(machine.thresholds.astype(np.int64)) > 2_000_000).any():
            raise ValueError("a genome has a threshold beyond 2,000,000")
        return machine

    def _row(self, genome: bytes) -> np.ndarray:
        machine, head = self._checked(genome), self._head.copy()
        head[:2] = machine.states, machine.first
        head[self._thresholds_at] = machine.thresholds
        tables = machine.following.ravel(), machine.outputs.ravel()
        return np.concatenate([head, *tables], dtype=np.float32, casting="unsafe")

    def _head_of_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Return what is before a row's table, and where a genome's thresholds go in it."""
        settings = self.settings
        at: list[int] = []
        head = [
            0,
            0,
            settings.output_units,
            settings.rows == "product",
            settings.scale,
            0,
        ]
        for thresholds, *others in self._per_input.tolist():
            head += [thresholds, *others]
            at += range(len(head), len(head) + thresholds)
            head += [0] * thresholds
        head[HEADER - 1] = len(head)
        return np.array(head, np.float32), np.array(at, np.int64)

    def _by_input(self, thresholds: np.ndarray) -> list[np.ndarray]:
        counts = itertools.accumulate(self._per_input[:, 0].tolist(), initial=0)
        return [thresholds[begin:end] for begin, end in itertools.pairwise(counts)]

    def _padded(self, genome: bytes) -> np.ndarray:
        """Return all numbers of a machine, -1 for states that it does not have."""
        machine = self._decoded(genome)
        table = np.full((self.rows, self._most, 1 + self.outputs), -1, np.int64)
        table[:, : machine.states, 0] = machine.following
        table[:, : machine.states, 1:] = machine.outputs
        return np.concatenate([[machine.first], machine.thresholds, table.ravel()])

    # ---- draws

    def _drawn_outputs(self, stream: Stream, states: int) -> np.ndarray:
        """Return (rows, states, outputs)."""
        count = self.rows * states * self.outputs
        drawn = stream.integers(self.settings.output_units + 1, count)
        return drawn.reshape(self.rows, states, self.outputs)

    def _drawn_thresholds(self, stream: Stream) -> np.ndarray:
        """Draw rising thresholds on the steps of each input, without the last one, as in FREVO."""
        drawn = []
        for thresholds, least, most, units in self._per_input.tolist():
            steps = stream.integers(units, thresholds)
            drawn.append(np.sort(least + (most - least) // units * steps))
        return np.concatenate(drawn).astype(np.int64)

    def _changed(self, machine: Machine, stream: Stream, probability: float) -> Machine:
        """Change thresholds, outputs and next states; delete transitions."""
        settings, states = self.settings, machine.states
        shape, outputs = machine.following.shape, machine.outputs

        def hit(chance: float, shape: tuple[int, ...]) -> np.ndarray:
            draws = stream.uniform(0.0, 1.0, int(np.prod(shape))).reshape(shape)
            return draws < chance * probability

        redrawn = hit(settings.change_threshold, machine.thresholds.shape)
        thresholds = np.where(redrawn, self._drawn_thresholds(stream), machine.thresholds)
        thresholds = np.concatenate(
            [np.sort(part) for part in self._by_input(thresholds)]
        )
        redrawn = hit(settings.change_output, outputs.shape)
        outputs = np.where(redrawn, self._drawn_outputs(stream, states), outputs)
        following = machine.following.astype(np.int64)
        steps = 1 + stream.integers(max(1, states - 1), following.size).reshape(shape)
        others = (following + steps) % states
        following = np.where(hit(settings.change_next_state, shape), others, following)
        deleted = hit(settings.delete_transition, shape)
        following = np.where(deleted, np.arange(states), following)
        return Machine(machine.first, thresholds, following, outputs)

    def _with_state(self, machine: Machine, stream: Stream) -> Machine:
        """Append a state, to which no transition leads yet."""
        following = stream.integers(machine.states + 1, self.rows).reshape(self.rows, 1)
        outputs = self._drawn_outputs(stream, 1)
        return machine._replace(
            following=np.concatenate([machine.following, following], axis=1),
            outputs=np.concatenate([machine.outputs, outputs], axis=1),
        )

    def _without_state(self, machine: Machine, stream: Stream) -> Machine:
        """Delete a random state; transitions to it lead to random others."""
        rest = machine.states - 1
        lost = stream.integer(machine.states)
        following = np.delete(machine.following, lost, axis=1).astype(np.int64)
        others = stream.integers(rest, following.size).reshape(following.shape)
        following = np.where(following == lost, others, following - (following > lost))
        outputs = np.delete(machine.outputs, lost, axis=1)
        first = machine.first - (machine.first > lost)
        if machine.first == lost:
            first = stream.integer(rest)
        return Machine(first, machine.thresholds, following, outputs)
