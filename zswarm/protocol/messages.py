"""The messages of the wire, field by field as in docs/protocol.md.

Each is a map with ``type``, without the fields that have their default. Unknown fields are ignored:
a program with further optional fields works with one that lacks them. Arrays are raw little-endian
bytes.
"""

import hashlib
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

MAX_MESSAGE = 32 << 20  # bytes
MAX_GENOMES = 4096  # in one batch
MAX_GENOME = 16_000_000  # bytes
MAX_TRIALS = 65_536  # in one batch
MAX_TEXT = 500  # characters
MAX_VALUES = 10_000  # in the settings of a message: texts, numbers, lists and maps
# Bytes of the settings of simulator and representation; names and versions are sent with them.
MAX_SETTINGS = 48 << 10
MAX_EPOCH = 1_000_000  # resumes of a run
MAX_SLOTS = 65_535
MAX_SECONDS = 1e9
MIN_SECONDS = 1e-9  # of a time that is not 0: it is divided by
MAX_OUTCOME = 1e300  # absolute value: sums of many stay finite
# Per slot, that a run may ask for or a server give: with less, there is no room for a compiler.
MIN_MEMORY_MB = 512  # compiling the largest kernel, that of e-pucks, takes 350
MAX_LABELS = 64  # of a server
LABEL_NAME = "[a-z][a-z0-9_.-]{0,62}"
LABEL_VALUE = "[A-Za-z0-9][A-Za-z0-9_.:+-]{0,62}"
MAX_PARTS = 100  # of a version; limits of a server
MAX_AGENTS = 65_536  # of a trial whose controllers are at the optimizer
# Every server plays these trials for its digest: each genome on each seed.
PROBE_GENOMES = 4
PROBE_SEEDS = 2
PROBE_TRIALS = PROBE_GENOMES * PROBE_SEEDS
PROBE_DIGEST = 8  # bytes, of one trial

Text = Annotated[str, Meta(max_length=MAX_TEXT)]
Token = Annotated[bytes, Meta(min_length=16, max_length=16)]
Proof = Annotated[bytes, Meta(max_length=32)]
Count = Annotated[int, Meta(ge=0, le=2**53)]
Epoch = Annotated[int, Meta(ge=0, le=MAX_EPOCH)]
Seconds = Annotated[float, Meta(ge=0, le=MAX_SECONDS)]  # 0, or MIN_SECONDS at least
Slots = Annotated[int, Meta(ge=0, le=MAX_SLOTS)]
TrialIndex = Annotated[int, Meta(ge=0, lt=MAX_TRIALS)]  # in a batch
Megabytes = Annotated[int, Meta(ge=0, le=2**40)]  # of 2^20 bytes
Genome = Annotated[bytes, Meta(max_length=MAX_GENOME)]
LabelName = Annotated[str, Meta(pattern=rf"\A{LABEL_NAME}\Z")]
LabelValue = Annotated[str, Meta(pattern=rf"\A{LABEL_VALUE}\Z")]
Labels = Annotated[dict[LabelName, LabelValue], Meta(max_length=MAX_LABELS)]
Names = Annotated[list[Text], Meta(max_length=1000)]
Limits = Annotated[list[Text], Meta(max_length=MAX_PARTS)]
Versions = Annotated[dict[Text, Text], Meta(max_length=MAX_PARTS)]
BatchId = Count
State = Literal["waiting", "preparing", "ready", "failed"]
FaultKind = Literal["crashed", "timeout", "memory"]
Asks = Literal["", "turn", "agent"]
Refusal = Literal[
    "malformed",
    "unsupported",
    "superseded",
    "lease-lost",
    "busy",
    "draining",
    "mismatch",
    "unknown-batch",
    "cancelled",
]
# What a server may have besides: an optimizer uses it only if the offer names it.
BY_ID = "by-id"  # a batch is asked for again by its id alone
FEATURES = [BY_ID]


class Message(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    tag_field="type",
    omit_defaults=True,
):
    """What all messages have in common."""


class Part(msgspec.Struct, frozen=True):
    """A simulator or a representation by name, with its settings."""

    kind: Text
    settings: dict[str, Any]


# ---- from the optimizer


class Requirements(Message, frozen=True, tag="requirements"):
    """Phase 1: what a run needs; with no simulator and no representation every server matches."""

    simulator: Text = ""
    representation: Text = ""
    version_hash: Text = ""
    trial_memory_mb: Megabytes = 0  # see Reserve
    settings: dict[str, Any] = {}  # of the simulator: all of them
    versions: Versions = {}  # what the version hash is of, to name what differs


class Reserve(Message, frozen=True, tag="reserve"):
    """Phase 2: the right to slots, and all that is needed to evaluate for this run."""

    nonce: Token  # the same nonce gets the same lease
    epoch: Epoch  # raised by every resume; a higher one takes the run's lease over
    slots: Annotated[int, Meta(ge=1, le=MAX_SLOTS)]
    simulator: Part
    representation: Part
    version_hash: Text
    trial_timeout_s: Annotated[float, Meta(ge=MIN_SECONDS, le=MAX_SECONDS)]
    # That a slot's process may take; 0: what the server gives.
    trial_memory_mb: Megabytes = 0
    # The controllers stay at the optimizer, which is asked in each turn, or for each agent.
    asks: Asks = ""
    # The same for all programs of the run, and known to no others: see ``proof``.
    proof: Proof = b""


class Renew(Message, frozen=True, tag="renew"):
    """Renew a lease; answered when the run knows an outdated state, or after a while."""

    lease: Token
    # Ready slots the optimizer knows of; -1: answer at once.
    known_ready: Annotated[int, Meta(ge=-1, le=MAX_SLOTS)] = -1


class Evaluate(Message, frozen=True, tag="evaluate"):
    """Evaluate a batch of trials; sent again with the same id, get what runs or was computed.

    Without trials it asks for a batch that the server has: ``BY_ID``.
    """

    lease: Token
    batch: BatchId
    # Each is empty: see Reserve.asks.
    genomes: Annotated[list[Genome], Meta(max_length=MAX_GENOMES)] = []
    participants: bytes = b""  # (trials, k) uint32, indices into genomes
    seeds: bytes = b""  # (trials,) uint64


class Cancel(Message, frozen=True, tag="cancel"):
    """Stop batches; their queries end with ``Refused``."""

    lease: Token
    batches: Annotated[list[BatchId], Meta(max_length=MAX_TRIALS)]


class Release(Message, frozen=True, tag="release"):
    """End a lease."""

    lease: Token


# ---- from the server


class Offer(Message, frozen=True, tag="offer"):
    """What a server has and can do."""

    server: Text
    program: Text  # zswarm's version
    machine: Text  # operating system and processor
    capacity: Slots
    free: Slots
    leases: Count
    simulators: Names
    representations: Names
    mismatch: Text = ""  # why the requirements are not met; empty: they are
    labels: Labels = {}  # that runs require or prefer
    limits: Limits = []  # of settings, in words; the server judges them
    features: Names = []  # those of FEATURES that it has


class Lease(Message, frozen=True, tag="lease"):
    """The state of a lease; it is ready if at least one slot is."""

    lease: Token
    state: State
    slots: Slots  # slots held
    ready: Slots  # of them ready to evaluate
    # Digests of the first trials of the probe, in order, once ready.
    probe: Annotated[bytes, Meta(max_length=64)] = b""
    trial_s: Seconds = 0.0  # seconds of one trial of the probe
    reason: Text = ""  # of a failure
    passing: bool = False  # the failure may pass: the run may reserve again later
    # While it is preparing: kernels that are not compiled, or how many trials of the probe were
    # begun, and how many there are; and how many kernels were to be compiled.
    compiling: Count = 0
    probe_begun: Count = 0
    probe_trials: Count = 0
    kernels: Count = 0


class Outcomes(Message, frozen=True, tag="outcomes"):
    """Outcomes of trials of a batch; others of the batch are to go to other servers.

    No number in them is beyond ``MAX_OUTCOME``.
    """

    batch: BatchId
    fitness: bytes  # (trials, k) float64, NaN where the simulator raised
    metrics: bytes  # (trials, m) float64
    seconds: Seconds  # spent computing, by all slots together
    trials: bytes = b""  # (trials,) uint32, indices into the batch, rising; b"": all
    error: Text = ""  # what the simulator raised first
    left: Text = ""  # what the simulator left behind in its process, which was replaced


class Running(Message, frozen=True, tag="running"):
    """The batch still runs: ask again with the same id. Holds outcomes that were not sent yet."""

    batch: BatchId
    done: Annotated[int, Meta(ge=0, le=MAX_TRIALS)]  # trials
    given: bool = False  # none of it waits for a slot
    trials: bytes = b""  # as in Outcomes; b"": none
    fitness: bytes = b""
    metrics: bytes = b""
    seconds: Seconds = 0.0
    error: Text = ""
    left: Text = ""


class Fault(Message, frozen=True, tag="fault"):
    """The machine or the simulator's process failed at one trial; some others are done."""

    batch: BatchId
    kind: FaultKind
    trial: TrialIndex
    reason: Text
    trials: bytes = b""  # that are done, as in Outcomes; b"": none
    fitness: bytes = b""
    metrics: bytes = b""
    seconds: Seconds = 0.0
    error: Text = ""
    left: Text = ""


class Sensors(Message, frozen=True, tag="sensors"):
    """What agents observe, answered with ``Actuators``; sent again, with the same answer."""

    lease: Token
    batch: BatchId
    trial: TrialIndex  # in the batch
    play: Token  # drawn when the trial is begun
    number: Count  # of the question in its trial
    agents: bytes  # (agents,) uint32, below MAX_AGENTS
    participants: bytes  # (agents,) uint32, which of the trial's participants drives each
    observations: bytes  # (agents, inputs) float32


class Refused(Message, frozen=True, tag="refused"):
    """The request is not carried out."""

    # A Refusal; a later program may have more.
    code: Text
    reason: Text


class Done(Message, frozen=True, tag="done"):
    """The request was carried out."""


# ---- from the optimizer, as an answer


class Actuators(Message, frozen=True, tag="actuators"):
    """The actions of the agents of ``Sensors``."""

    actions: bytes  # (agents, outputs) float32


Request = Requirements | Reserve | Renew | Evaluate | Cancel | Release
Verb = Literal["offer", "reserve", "renew", "evaluate", "cancel", "release"]
VERBS: dict[type[Request], Verb] = {
    Requirements: "offer",
    Reserve: "reserve",
    Renew: "renew",
    Evaluate: "evaluate",
    Cancel: "cancel",
    Release: "release",
}
# Bytes of a request. A larger one is refused before it is decoded.
MAX_REQUEST: dict[str, int] = {
    "offer": 64 << 10,
    "reserve": 64 << 10,
    "renew": 4 << 10,
    "evaluate": MAX_MESSAGE,
    "cancel": 640 << 10,
    "release": 4 << 10,
}
Reply = Offer | Lease | Outcomes | Running | Fault | Refused | Done
Reaction = Actuators | Refused


def proof(secret: bytes, server: str) -> bytes:
    """Return what shows to one server that a program belongs to a run, and to no other server.

    Args:
        secret: of the run; b"": it has none.
        server: id of the server.
    """
    if not secret:
        return b""
    return hashlib.blake2b(server.encode(), key=secret, digest_size=16).digest()


def verb(request: Request) -> Verb:
    """Return the last part of the key that a request is sent to."""
    return VERBS[type(request)]
