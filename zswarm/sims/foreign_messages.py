"""What zswarm and a program that is a simulator say to each other (docs/foreign.md), message by message.

Each message is a msgpack map with its ``type``, behind its length in bytes as a little-endian uint32. Numbers of networks are raw
little-endian float32.
"""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

VERSION = 1
MAX_FRAME = 8 << 20  # bytes of a message, either way
MAX_AGENTS = 100_000
MAX_SENSORS = 100_000  # inputs and outputs, too

Name = Annotated[str, Meta(min_length=1, max_length=100)]
Count = Annotated[int, Meta(ge=0, le=MAX_SENSORS)]


class _Message(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", forbid_unknown_fields=True):
    """What all have in common."""


class Setting(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A setting of the program; ``type`` is that of its value."""

    name: Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,62}$")]
    type: Literal["int", "float", "bool", "text"]
    default: int | float | bool | str
    description: str = ""
    minimum: int | float | None = None  # of a number
    maximum: int | float | None = None
    choices: list[str] = []  # of a text; empty: any


class Network(msgspec.Struct, frozen=True, kw_only=True):
    """The kind of the controllers, with its settings."""

    kind: str
    settings: dict[str, Any]


# ---- from the program


class Hello(_Message, frozen=True, tag="hello"):
    """The first that a program says, by itself."""

    v: Annotated[int, Meta(ge=0)]
    description: str = ""  # a data sheet: its first line in short what the simulator is
    settings: list[Setting] = []


class Ready(_Message, frozen=True, tag="ready"):
    """It is set up."""

    inputs: Count  # numbers that an agent observes
    outputs: Annotated[int, Meta(ge=1, le=MAX_SENSORS)]  # and sets, in one decision
    owners: Annotated[list[Count], Meta(min_length=1, max_length=MAX_AGENTS)]  # per agent the participant that drives it
    participants: Annotated[int, Meta(ge=1, le=1000)] = 1  # genomes that play one trial together
    metrics: Annotated[list[Name], Meta(max_length=1000)] = []
    sensors: list[Name] = []
    actuators: list[Name] = []
    first_seed: Annotated[int, Meta(ge=0, le=2**62)] | None = None  # trials have this seed, the next one, ...; None: any
    hosts: bool = False  # it decides for the controllers of the set-up's network itself


class Turn(_Message, frozen=True, tag="turn"):
    """Who acts next."""

    agents: Annotated[list[Count], Meta(min_length=1, max_length=MAX_AGENTS)]
    observations: bytes  # (agents, inputs) float32


class End(_Message, frozen=True, tag="end"):
    """The trial is over."""

    fitness: list[float]  # one per participant
    metrics: list[float] = []


class Error(_Message, frozen=True, tag="error"):
    """It cannot do what was asked; it can do other things."""

    text: str


Said = Hello | Ready | Turn | End | Error

# ---- to the program


class Setup(_Message, frozen=True, tag="setup"):
    """A problem; answered by ``ready``, or an error that refuses it. A later one replaces it."""

    settings: dict[str, Any]
    network: Network | None  # that the program may host; None: it is asked for turns


class Reset(_Message, frozen=True, tag="reset"):
    """Begin a trial in turns; answered by a turn or an end. A trial under way is given up."""

    seed: int  # below 2^64


class Actions(_Message, frozen=True, tag="actions"):
    """What the agents of the last turn do; answered by a turn or an end."""

    actions: bytes  # (agents of the turn, outputs) float32


class Evaluate(_Message, frozen=True, tag="evaluate"):
    """Play a whole trial; answered by an end."""

    seed: int
    genomes: list[bytes]  # one per participant, as the representation documents them


Asked = Setup | Reset | Actions | Evaluate
