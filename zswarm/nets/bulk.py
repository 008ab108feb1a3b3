"""Several networks of one kind in one genome, and an input that selects the one that decides.

Source: FREVO 1.5 (github.com/smartgrids-aau/Frevo), ``SimpleBulkRepresentation``. There the problem
selects a part. Here the input with number ``input`` does, rounded and cut to 0..parts - 1. Parts
that do not decide keep their state. Genome and state are those of the parts in their order.
Operators: docs/representations.md.
"""

import functools
from collections.abc import Sequence
from types import FunctionType
from typing import Annotated, Any

import msgspec
import numpy as np

from zswarm.config.decode import convert
from zswarm.config.meta import PartSettings, about, within
from zswarm.errors import ConfigError
from zswarm.kernels.jit import STEP_SIGNATURE, Step, kernel
from zswarm.kernels.portable import to_int
from zswarm.kernels.random import Stream
from zswarm.nets.graph import Graph
from zswarm.nets.representation import Representation
from zswarm.nets.vector import check_lengths
from zswarm.plugins import registry as plugins

HEADER = 4  # parts, input, numbers of a part's parameters, of its state
HALF = np.float32(0.5)


class BulkSettings(PartSettings, frozen=True):
    """Settings of ``[representation]`` with ``kind = "bulk"``; a part's are in ``of``."""

    parts: Annotated[int, within(1, 100, "networks in a genome")] = 2
    input: Annotated[
        int, within(0, 100_000, "number of the input that selects the part")
    ] = 0
    of: Annotated[
        dict[str, Any],
        about("kind and settings of the parts: a table like `[representation]`"),
    ] = msgspec.field(default_factory=lambda: {"kind": "fully-meshed"})

    def __post_init__(self) -> None:
        """Check the settings of the parts, and complete them with their defaults."""
        kind = self.of.get("kind")
        known = [name for name in plugins.BUNDLED["representation"] if name != "bulk"]
        if kind not in known:
            raise ValueError(
                f"of: kind: expected one of {', '.join(known)}, not {kind!r:.60}"
            )
        try:
            _, settings = _part(self.of, "of")
        except ConfigError as error:
            raise ValueError(str(error)) from None
        items = msgspec.to_builtins(settings).items()
        complete = {key: value for key, value in items if value is not None}
        msgspec.structs.force_setattr(self, "of", {"kind": kind, **complete})


def _part(
    table: dict[str, Any], where: str
) -> tuple[type[Representation], msgspec.Struct]:
    """Return the class and the settings of the parts."""
    kind = plugins.load("representation", table["kind"])
    given = {key: value for key, value in table.items() if key != "kind"}
    return kind, convert(given, kind.settings_type, where)


part_step: Step  # of the parts' kind: ``_step_for`` gives it to ``decide``


def decide(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Let the part decide that an input selects."""
    parts = int(parameters[0])
    numbers = int(parameters[2])
    numbers_of_state = int(parameters[3])
    part = min(max(to_int(observation[int(parameters[1])] + HALF), 0), parts - 1)
    begin, begin_of_state = HEADER + part * numbers, part * numbers_of_state
    part_step(  # noqa: F821  one of its globals
        parameters[begin : begin + numbers],
        state[begin_of_state : begin_of_state + numbers_of_state],
        observation,
        output,
    )


@functools.cache
def _step_for(kind: str) -> Any:
    """Return ``decide`` for parts of a kind; a separate name and globals let numba cache it."""
    name = f"decide_{kind.replace('-', '_')}"
    part_step = plugins.load("representation", kind).step
    function = FunctionType(decide.__code__, {**globals(), "part_step": part_step}, name)
    function.__qualname__ = name
    return kernel(STEP_SIGNATURE)(function)


class Bulk(Representation):
    """Several networks of one kind in one genome; an input selects the one that decides."""

    settings_type = BulkSettings
    settings: BulkSettings
    genome_bytes: int

    def __init__(self, settings: BulkSettings, inputs: int, outputs: int) -> None:
        super().__init__(settings, inputs, outputs)
        if settings.input >= inputs:
            text = f"input: expected 0 to {inputs - 1}, not {settings.input}"
            raise ConfigError(f"representation: {text}")
        name, parts = settings.of["kind"], settings.parts
        kind, part_settings = _part(settings.of, "representation: of")
        self.part: Representation = kind(part_settings, inputs, outputs)
        if self.part.genome_bytes is None:
            text = f"expected a kind whose genomes have one length; those of {name} grow"
            raise ConfigError(f"representation: of: {text}")
        self.genome_bytes = parts * self.part.genome_bytes
        self.state_size = parts * self.part.state_size
        if self.part.genes is not None and self.part.ranges is not None:
            self.genes = parts * self.part.genes
            self.ranges = np.tile(self.part.ranges, parts)
        self.crossover_draws = 1 if parts > 1 else self.part.crossover_draws
        self.step = _step_for(name)

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return header, then the parameters of each part."""
        parts, table = self.settings.parts, self.part.parameters(self._split(genomes))
        rows = np.empty((len(genomes), HEADER + parts * table.shape[1]), np.float32)
        rows[:, :HEADER] = (
            parts,
            self.settings.input,
            table.shape[1],
            self.part.state_size,
        )
        rows[:, HEADER:] = table.reshape(len(genomes), -1)
        return rows

    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Draw random parts."""
        return self._join(self.part.random(count * self.settings.parts, stream))

    def mutate(
        self, genomes: Sequence[bytes], stream: Stream, **options: Any
    ) -> list[bytes]:
        """Mutate all parts."""
        return self._join(self.part.mutate(self._split(genomes), stream, **options))

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """Return the mother's parts up to a random one, then the father's.

        FREVO cannot cross a single part; here it is crossed as its kind does.
        """
        parts = self.settings.parts
        if parts == 1:
            return self.part.crossover(mother, father, stream)
        cut = (1 + stream.integer(parts - 1)) * (self.genome_bytes // parts)
        return mother[:cut] + father[cut:]

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Return means of the distances between parts of the same number, added in order."""
        parts, total = self.settings.parts, np.zeros((len(left), len(right)))
        lefts, rights = self._split(left), self._split(right)
        for number in range(parts):
            total += self.part.distances(lefts[number::parts], rights[number::parts])
        return total / parts

    def graph(self, genome: bytes) -> Graph:
        """Return the networks of all parts."""
        nodes, edges = Graph([], [])
        for number, part in enumerate(self._split([genome])):
            first, graph = len(nodes), self.part.graph(part)
            nodes += [node._replace(part=number) for node in graph.nodes]
            edges += [
                edge._replace(source=first + edge.source, target=first + edge.target)
                for edge in graph.edges
            ]
        return Graph(nodes, edges)

    def _split(self, genomes: Sequence[bytes]) -> list[bytes]:
        """Return the parts of all genomes, in order.

        Raises:
            ValueError: a genome has the wrong length.
        """
        check_lengths(genomes, self.genome_bytes)
        size = self.genome_bytes // self.settings.parts
        begins = range(0, self.genome_bytes, size)
        return [genome[begin : begin + size] for genome in genomes for begin in begins]

    def _join(self, parts: Sequence[bytes]) -> list[bytes]:
        count = self.settings.parts
        return [
            b"".join(parts[begin : begin + count])
            for begin in range(0, len(parts), count)
        ]
