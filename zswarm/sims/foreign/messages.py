"""Messages between zswarm and a program that is a simulator (docs/foreign.md).

Each message is a msgpack map with its ``type``, after its length in bytes as a little-endian
uint32. Numbers of networks are raw little-endian float32.
"""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

VERSION = 1
MAX_FRAME = 8 << 20  # bytes of a message, in both directions
MAX_AGENTS = 100_000
MAX_SENSORS = 100_000  # inputs and outputs, too

Name = Annotated[str, Meta(min_length=1, max_length=100)]
Count = Annotated[int, Meta(ge=0, le=MAX_SENSORS)]
Agents = Annotated[list[Count], Meta(min_length=1, max_length=MAX_AGENTS)]


class _Message(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    tag_field="type",
    forbid_unknown_fields=True,
):
    """A message with its tag."""


class SettingEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
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
    """The first message, which a program sends unasked."""

    v: Annotated[int, Meta(ge=0)]
    description: str = ""  # a data sheet; its first line is a short description
    settings: list[SettingEntry] = []


class ProgramReady(_Message, frozen=True, tag="ready"):
    """The program is set up."""

    inputs: Count  # numbers that an agent observes in one decision
    outputs: Annotated[int, Meta(ge=1, le=MAX_SENSORS)]  # numbers that it sets
    owners: Agents  # per agent the participant that drives it
    # Genomes that play one trial together.
    participants: Annotated[int, Meta(ge=1, le=1000)] = 1
    metrics: Annotated[list[Name], Meta(max_length=1000)] = []
    sensors: list[Name] = []
    actuators: list[Name] = []
    # Trials have this seed, the next one, and so on; None: any seeds.
    first_seed: Annotated[int, Meta(ge=0, le=2**62)] | None = None
    # The program decides for the controllers of the set-up's network itself.
    hosts: bool = False


class TurnMessage(_Message, frozen=True, tag="turn"):
    """The agents that act next."""

    agents: Agents
    observations: bytes  # (agents, inputs) float32


class End(_Message, frozen=True, tag="end"):
    """The trial is over."""

    fitness: list[float]  # one per participant
    metrics: list[float] = []


class Error(_Message, frozen=True, tag="error"):
    """The program cannot do what was asked; it can do other things."""

    text: str


Reply = Hello | ProgramReady | TurnMessage | End | Error

# ---- to the program


class Setup(_Message, frozen=True, tag="setup"):
    """Set up a problem, replacing the last one; answered by ``ready``, or an error that refuses."""

    settings: dict[str, Any]
    network: Network | None  # that the program may host; None: play in turns


class ResetTrial(_Message, frozen=True, tag="reset"):
    """Begin a trial in turns, abandoning the current one; answered by a turn or an end."""

    seed: int  # below 2^64


class Actions(_Message, frozen=True, tag="actions"):
    """Actions of the agents of the last turn; answered by a turn or an end."""

    actions: bytes  # (agents of the turn, outputs) float32


class EvaluateTrials(_Message, frozen=True, tag="evaluate"):
    """Play a whole trial; answered by an end."""

    seed: int
    genomes: list[bytes]  # one per participant, as the representation documents them


Request = Setup | ResetTrial | Actions | EvaluateTrials
