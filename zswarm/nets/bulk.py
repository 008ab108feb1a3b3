"""Several networks of one kind in one genome, and an input that says which of them decides.

FREVO's ``SimpleBulkRepresentation`` (github.com/smartgrids-aau/Frevo, version 1.5) holds several genomes, of which the problem
takes one by its number; by itself it cannot decide. Here a decision knows what the agent senses and nothing else, so the input
number ``input`` is taken for the number of the part: rounded to the nearest, and cut to 0..parts - 1. An input that tells an
agent's type, or its role at the moment, so gives each type or role a network of its own. Parts that do not decide keep their
state.

Genome: the genomes of the parts, one after the other. State: the parts' states, one after the other.

Operators are FREVO's: all parts mutate; a child has the first parts of the mother, one at least, and the others of the father
(FREVO cannot cross a single part; here it is crossed as its kind does); the distance is the mean of the parts'.
"""

from collections.abc import Mapping, Sequence
from types import FunctionType
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from zswarm import plugins
from zswarm.draws import Stream
from zswarm.errors import ConfigError
from zswarm.jit import STEP_SIGNATURE, Step, kernel
from zswarm.nets.graph import Graph
from zswarm.nets.representation import Representation
from zswarm.portable import to_int
from zswarm.strict import convert

HEADER = 4  # parts, input, numbers of a part's parameters, of its state
HALF = np.float32(0.5)


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[representation]`` with ``kind = "bulk"``; those of a part are ``[representation.of]``."""

    parts: Annotated[int, Meta(ge=1, le=100, description="networks in a genome")] = 2
    input: Annotated[
        int, Meta(ge=0, le=100_000, description="number of the input, from 0, that says which part decides: 0, 1, ...")
    ] = 0
    of: Annotated[dict[str, Any], Meta(description="kind and settings of the parts: a table as `[representation]` is")] = (
        msgspec.field(default_factory=lambda: {"kind": "fully-meshed"})
    )

    def __post_init__(self) -> None:
        """Check the settings of the parts, and write out their defaults."""
        kind = self.of.get("kind")
        known = [name for name in plugins.BUNDLED["representation"] if name != "bulk"]
        if kind not in known:
            raise ValueError(f"of: kind: expected one of {', '.join(known)}, not {kind!r:.60}")
        given = {key: value for key, value in self.of.items() if key != "kind"}
        try:
            settings = convert(given, plugins.load("representation", kind).settings_type, "of")
        except ConfigError as error:
            raise ValueError(str(error)) from None
        complete = {key: value for key, value in msgspec.to_builtins(settings).items() if value is not None}
        msgspec.structs.force_setattr(self, "of", {"kind": kind, **complete})


part_step: Step  # of the parts' kind: ``_step_of`` gives it to ``decide``


def decide(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """One decision, by the part that an input names."""
    parts, numbers, numbers_of_state = int(parameters[0]), int(parameters[2]), int(parameters[3])
    part = min(max(to_int(observation[int(parameters[1])] + HALF), 0), parts - 1)
    begin, begin_of_state = HEADER + part * numbers, part * numbers_of_state
    part_step(  # noqa: F821  one of its globals
        parameters[begin : begin + numbers],
        state[begin_of_state : begin_of_state + numbers_of_state],
        observation,
        output,
    )


STEPS: dict[str, Step] = {}  # by the kind of the parts


def _step_of(kind: str, part_step: Step) -> Step:
    """``decide`` for parts of a kind. It is a function of a name of its own, with globals of its own: that numba can cache."""
    if kind not in STEPS:
        name = f"decide_{kind.replace('-', '_')}"
        function = FunctionType(decide.__code__, {**globals(), "part_step": part_step}, name)
        function.__qualname__ = name
        STEPS[kind] = kernel(STEP_SIGNATURE)(function)
    return STEPS[kind]


class Bulk(Representation):
    """Several networks of one kind in one genome; an input says which of them decides."""

    settings_type = Settings
    settings: Settings
    genome_bytes: int

    def __init__(self, settings: Settings, inputs: int, outputs: int) -> None:
        super().__init__(settings, inputs, outputs)
        if settings.input >= inputs:
            raise ConfigError(f"representation: input: expected 0 to {inputs - 1}, not {settings.input}")
        of: Mapping[str, Any] = settings.of
        kind = plugins.load("representation", of["kind"])
        given = {key: value for key, value in of.items() if key != "kind"}
        self.part: Representation = kind(convert(given, kind.settings_type, "representation: of"), inputs, outputs)
        if self.part.genome_bytes is None:
            raise ConfigError(f"representation: of: expected a kind whose genomes have one length; those of {of['kind']} grow")
        self.genome_bytes = settings.parts * self.part.genome_bytes
        self.state_size = settings.parts * self.part.state_size
        if self.part.genes is not None and self.part.ranges is not None:
            self.genes = settings.parts * self.part.genes
            self.ranges = np.tile(self.part.ranges, settings.parts)
        self.step = _step_of(of["kind"], self.part.step)

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Header, then the parameters of each part."""
        parts = self.settings.parts
        of_parts = self.part.parameters([part for genome in genomes for part in self._split(genome)])
        rows = np.empty((len(genomes), HEADER + parts * of_parts.shape[1]), np.float32)
        rows[:, :HEADER] = parts, self.settings.input, of_parts.shape[1], self.part.state_size
        rows[:, HEADER:] = of_parts.reshape(len(genomes), -1)
        return rows

    def random(self, count: int, stream: Stream) -> list[bytes]:
        """Random parts."""
        return self._join(self.part.random(count * self.settings.parts, stream))

    def mutate(
        self, genomes: Sequence[bytes], stream: Stream, *, method: int, severity: float, probability: float
    ) -> list[bytes]:
        """All parts mutate."""
        parts = [part for genome in genomes for part in self._split(genome)]
        return self._join(self.part.mutate(parts, stream, method=method, severity=severity, probability=probability))

    def crossover(self, mother: bytes, father: bytes, stream: Stream) -> bytes:
        """The mother's parts up to a random one, then the father's."""
        if self.settings.parts == 1:
            return self.part.crossover(mother, father, stream)
        cut = (1 + stream.integer(self.settings.parts - 1)) * (self.genome_bytes // self.settings.parts)
        return mother[:cut] + father[cut:]

    def distances(self, left: Sequence[bytes], right: Sequence[bytes]) -> np.ndarray:
        """Means of the distances between the parts of one number, added in their order."""
        sides = [[self._split(genome) for genome in side] for side in (left, right)]
        total = np.zeros((len(left), len(right)))
        for number in range(self.settings.parts):
            total += self.part.distances(*([parts[number] for parts in side] for side in sides))
        return total / self.settings.parts

    def graph(self, genome: bytes) -> Graph:
        """See ``Representation``; the networks side by side."""
        whole = Graph([], [])
        for number, part in enumerate(self._split(genome)):
            first, of_part = len(whole.nodes), self.part.graph(part)
            whole.nodes.extend(node._replace(part=number) for node in of_part.nodes)
            whole.edges.extend(edge._replace(source=first + edge.source, target=first + edge.target) for edge in of_part.edges)
        return whole

    def _split(self, genome: bytes) -> list[bytes]:
        """The genomes of the parts.

        Raises:
            ValueError: the genome has the wrong length.
        """
        if len(genome) != self.genome_bytes:
            raise ValueError(f"a genome has {len(genome)} bytes; this network takes {self.genome_bytes}")
        size = self.genome_bytes // self.settings.parts
        return [genome[begin : begin + size] for begin in range(0, len(genome), size)]

    def _join(self, parts: Sequence[bytes]) -> list[bytes]:
        count = self.settings.parts
        return [b"".join(parts[begin : begin + count]) for begin in range(0, len(parts), count)]
