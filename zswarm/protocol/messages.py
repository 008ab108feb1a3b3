"""The messages of the wire, field by field as in docs/protocol.md.

Each is a map with ``type`` and ``v`` (the protocol's version). Arrays of numbers are raw little-endian bytes.
"""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

MAX_MESSAGE = 8 << 20  # bytes
MAX_GENOMES = 4096  # in one batch
MAX_GENOME = 4_000_000  # bytes
MAX_TRIALS = 65_536  # in one batch
MAX_TEXT = 500  # characters
MAX_SLOTS = 65_535
MIN_MEMORY_MB = 256  # that a run may ask for or a server give, per slot: less does not hold a compiler
MAX_LABELS = 64  # of a server
LABEL_NAME = "[a-z][a-z0-9_.-]{0,62}"
LABEL_VALUE = "[A-Za-z0-9][A-Za-z0-9_.:+-]{0,62}"
MAX_PARTS = 100  # of a version; limits of a server
MAX_AGENTS = 65_536  # of a trial whose controllers are at the optimizer
PROBE_GENOMES, PROBE_SEEDS = 4, 2  # the trials that every server plays for its digest: each genome on each seed

Text = Annotated[str, Meta(max_length=MAX_TEXT)]
Token = Annotated[bytes, Meta(min_length=16, max_length=16)]
Count = Annotated[int, Meta(ge=0, le=2**53)]
Seconds = Annotated[float, Meta(ge=0, le=1e9)]
Megabytes = Annotated[int, Meta(ge=0, le=2**40)]  # of 2^20 bytes
LabelName = Annotated[str, Meta(pattern=rf"\A{LABEL_NAME}\Z")]
LabelValue = Annotated[str, Meta(pattern=rf"\A{LABEL_VALUE}\Z")]
BatchId = Count
State = Literal["waiting", "preparing", "ready", "failed"]
FaultKind = Literal["crashed", "timeout", "memory"]
Asks = Literal["", "turn", "agent"]
Refusal = Literal["malformed", "lease-lost", "busy", "draining", "mismatch", "cancelled"]


class Message(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", forbid_unknown_fields=True):
    """What all messages have."""

    v: Literal[1] = 1


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A simulator or a representation by name, with its settings."""

    kind: Text
    settings: dict[str, Any]


# ---- from the optimizer -------------------------------------------------------------------------------------------


class Requirements(Message, frozen=True, tag="requirements", forbid_unknown_fields=False):
    """Phase 1: what a run needs; with no simulator and no representation every server matches.

    This and Offer may have fields of later versions, which are passed over: programs of unlike versions meet here.
    """

    simulator: Text = ""
    representation: Text = ""
    version_hash: Text = ""
    trial_memory_mb: Megabytes = 0  # see Reserve
    settings: dict[str, Any] = {}  # of the simulator: all of them
    versions: Annotated[dict[Text, Text], Meta(max_length=MAX_PARTS)] = {}  # what the version hash is of, to say what differs


class Reserve(Message, frozen=True, tag="reserve"):
    """Phase 2: the right to slots, and all that is needed to evaluate for this run."""

    nonce: Token  # the same nonce gets the same lease
    epoch: Count  # raised by every resume; a higher one takes the run's lease over
    slots: Annotated[int, Meta(ge=1, le=MAX_SLOTS)]
    simulator: Part
    representation: Part
    version_hash: Text
    trial_timeout_s: Annotated[float, Meta(gt=0, le=1e9)]
    trial_memory_mb: Megabytes = 0  # that a slot's process may take; 0: what the server gives
    asks: Asks = ""  # the controllers are at the optimizer, which is asked for each turn, or for each agent; "": they travel


class Renew(Message, frozen=True, tag="renew"):
    """Keep a lease, and ask for its state; answered when the state differs from what is known, or after a while."""

    lease: Token
    known_ready: Annotated[int, Meta(ge=-1, le=MAX_SLOTS)] = -1  # ready slots the optimizer knows of; -1: answer at once


class Evaluate(Message, frozen=True, tag="evaluate"):
    """A batch of trials. Asked again with the same id it attaches to what runs or gets the kept outcomes."""

    lease: Token
    batch: BatchId
    genomes: Annotated[list[Annotated[bytes, Meta(max_length=MAX_GENOME)]], Meta(max_length=MAX_GENOMES)]  # see Reserve.asks
    participants: bytes  # (trials, k) uint32, indices into genomes
    seeds: bytes  # (trials,) uint64


class Cancel(Message, frozen=True, tag="cancel"):
    """Stop batches; their queries end with ``Refused``."""

    lease: Token
    batches: Annotated[list[BatchId], Meta(max_length=MAX_TRIALS)]


class Release(Message, frozen=True, tag="release"):
    """Give a lease back."""

    lease: Token


# ---- from the server ----------------------------------------------------------------------------------------------


class Offer(Message, frozen=True, tag="offer", forbid_unknown_fields=False):
    """What a server has and can do; as for Requirements."""

    server: Text
    program: Text  # zswarm's version
    machine: Text  # operating system and processor
    capacity: Count
    free: Count
    leases: Count
    simulators: Annotated[list[Text], Meta(max_length=1000)]
    representations: Annotated[list[Text], Meta(max_length=1000)]
    mismatch: Text = ""  # why the requirements are not met; empty: they are
    labels: Annotated[dict[LabelName, LabelValue], Meta(max_length=MAX_LABELS)] = {}  # for what runs require and prefer
    limits: Annotated[list[Text], Meta(max_length=MAX_PARTS)] = []  # of settings, in words; the server judges them


class Lease(Message, frozen=True, tag="lease"):
    """The state of a lease: ``waiting`` for a slot, ``preparing``, ``ready`` (a slot at least) or ``failed``."""

    lease: Token
    state: State
    slots: Count  # slots held
    ready: Count  # of them ready to evaluate
    lease_s: Seconds  # it ends this long after the last message
    probe: Annotated[bytes, Meta(max_length=64)] = b""  # digest of the probe's outcomes, once ready
    trial_s: Seconds = 0.0  # seconds of one trial of the probe
    reason: Text = ""  # of a failure


class Outcomes(Message, frozen=True, tag="outcomes"):
    """What the trials of a batch decided."""

    batch: BatchId
    fitness: bytes  # (trials, k) float64, NaN where the simulator raised
    metrics: bytes  # (trials, m) float64
    seconds: Seconds  # spent computing, by all slots together
    trials: bytes = b""  # (trials,) uint32, those of the batch that these are of, rising; b"": all. The others go elsewhere
    error: Text = ""  # what the simulator raised first


class Running(Message, frozen=True, tag="running"):
    """The batch still runs: ask again with the same id. With outcomes of trials that are done and were not told yet."""

    batch: BatchId
    done: Count  # trials
    given: bool = False  # none of it waits for a slot
    trials: bytes = b""  # of these, as in Outcomes; b"": of none
    fitness: bytes = b""
    metrics: bytes = b""
    seconds: Seconds = 0.0
    error: Text = ""


class Fault(Message, frozen=True, tag="fault"):
    """The machine or the simulator's process failed at one trial; the others are without blame, some of them done."""

    batch: BatchId
    kind: FaultKind
    trial: Count
    reason: Text
    trials: bytes = b""  # of those that are done, as in Outcomes; b"": of none
    fitness: bytes = b""
    metrics: bytes = b""
    seconds: Seconds = 0.0
    error: Text = ""


class Sensors(Message, frozen=True, tag="sensors"):
    """What agents observe; the optimizer answers with ``Actuators``. Asked again it gets the same answer."""

    lease: Token
    batch: BatchId
    trial: Count  # index in the batch
    play: Token  # drawn when the trial is begun
    number: Count  # of the question in its trial
    agents: bytes  # (agents,) uint32, below MAX_AGENTS
    participants: bytes  # (agents,) uint32, which of the trial's participants drives each
    observations: bytes  # (agents, inputs) float32


class Refused(Message, frozen=True, tag="refused"):
    """The request is not carried out."""

    code: Refusal
    reason: Text


class Done(Message, frozen=True, tag="done"):
    """Carried out."""


# ---- from the optimizer, as an answer -----------------------------------------------------------------------------


class Actuators(Message, frozen=True, tag="actuators"):
    """What the controllers of the agents of ``Sensors`` decided."""

    actions: bytes  # (agents, outputs) float32


Request = Requirements | Reserve | Renew | Evaluate | Cancel | Release
Reply = Offer | Lease | Outcomes | Running | Fault | Refused | Done
Reaction = Actuators | Refused
