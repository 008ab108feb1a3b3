"""The run's view of a server: its phase, its lease, and the batches that it has.

==========  =====================================  =============================================
phase       the server ...                         it leaves the phase when ...
==========  =====================================  =============================================
IDLE        is not used: it has no token, does     its token appears (SEEN)
            not match, refused, sent nonsense, or
            is of a machine that is banned
SEEN        is asked for its offer                 it offers what is required (SPARE)
SPARE       matches; its slots are not wanted      its slots are wanted (RESERVING), or its
                                                   token appears again (SEEN)
RESERVING   is asked for slots                     it grants a lease (LEASED)
LEASED      granted a lease, which is renewed; it  its token vanishes (LEAVING), or the run
            may have no slot yet                   holds enough slots without it (SPARE)
LEAVING     has no token any more: it drains or    its token is back (LEASED), or none of its
            died, or the link is cut               batches is out (IDLE)
BACKED_OFF  is not asked for a while: it did not   the pause is over, or its token appears
            answer, has too many leases, ended     (SEEN)
            this one, failed too many trials,
            cannot get ready now, sent what cannot
            be handled, or its probe is disputed
BANNED      computes wrong outcomes                never
==========  =====================================  =============================================

Besides, one that refuses, or whose token vanishes while it is not LEASED, becomes IDLE, one that
does not answer BACKED_OFF, and one that is found to compute wrong BANNED. ``MOVES`` has all allowed
changes.

Only a LEASED server is sent batches. Those that are out when it becomes LEAVING may still be
answered. When it leaves these two phases, its batches wait for any server:

- It was silent, or its link was cut: the batches are *stranded* there. If the server grants the
  same lease again (``resumable_lease``), it is asked again for those that no other server took,
  under their ids, and computes nothing twice. The others are cancelled there.
- Its lease ended in another way: nothing is resumed.
- It is BANNED, as all servers of its machine: what was counted for them in this workload is
  evaluated again, too.

When a lease can be resumed: docs/protocol.md, "Times of a lease".
"""

import math
from enum import Enum, auto
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from zswarm.ot.cluster.machines import name_of
from zswarm.ot.cluster.pace import Pace
from zswarm.protocol.messages import PROBE_DIGEST, Lease

# Before one is asked again that cannot serve now; longer each time, until it sends an outcome.
SETBACKS_S = (5, 10, 20, 40, 80, 160, 320, 600)
# Before the same is asked again of one that had nothing new, or that got on with its first slot.
AGAIN_S, PROGRESS_S = 1.0, 0.5


class Phase(Enum):
    """How far a server is; see the table above."""

    IDLE = auto()
    SEEN = auto()
    SPARE = auto()
    RESERVING = auto()
    LEASED = auto()
    LEAVING = auto()
    BACKED_OFF = auto()
    BANNED = auto()


_ENDS = {Phase.IDLE, Phase.BANNED}
MOVES = {
    Phase.IDLE: {Phase.SEEN, Phase.BANNED},
    Phase.SEEN: {Phase.SPARE, Phase.BACKED_OFF, *_ENDS},
    Phase.SPARE: {Phase.SEEN, Phase.RESERVING, Phase.BACKED_OFF, *_ENDS},
    Phase.RESERVING: {Phase.LEASED, Phase.BACKED_OFF, *_ENDS},
    Phase.LEASED: {Phase.LEAVING, Phase.SPARE, Phase.BACKED_OFF, *_ENDS},
    Phase.LEAVING: {Phase.LEASED, *_ENDS},
    Phase.BACKED_OFF: {Phase.SEEN, *_ENDS},
    Phase.BANNED: set[Phase](),
}


class PrepareProgress(NamedTuple):
    """How far a server is that prepares its first slot."""

    compiling: int  # kernels that are not compiled
    probe_begun: int  # trials
    probe_trials: int  # that the probe has
    kernels: int  # that were to be compiled

    def words(self, simulator: str) -> str:
        """Return what it does, for the user."""
        if self.compiling:
            kernels = max(self.compiling, self.kernels)
            return f"compiling kernel {kernels - self.compiling + 1} of {kernels}, once"
        if self.probe_trials == 1:
            return f"plays one trial of {simulator}"
        return f"plays trial {self.probe_begun} of {self.probe_trials} of {simulator}"


class SentBatch(msgspec.Struct, eq=False):
    """Trials that were sent to a server."""

    server: "RemoteServer"
    id: int
    trials: np.ndarray
    done: np.ndarray  # (trials,) bool: the outcome came
    missing: int  # trials whose outcome did not come
    avoid: frozenset[str] = frozenset()  # machines, as in QueuedTrials
    check: bool = False  # they are counted already, and evaluated again for comparison
    question: int = 0  # the query that asked for it last
    asked: Literal["", "whole", "by-id"] = ""  # how it was asked for last
    unanswered: int = 0  # queries in a row that ended without an answer
    heard: np.ndarray = msgspec.UNSET  # type: ignore[assignment]  # (trials,) bool: from its server
    give_up_at: float = math.inf  # unless its server has sent another outcome by then
    all_started: bool = False  # none of it waits for a slot any more
    sent_at: float = 0.0
    due: float = 0.0  # when the answer is expected
    alone: bool = False  # nothing else was with the server
    size: int = 0  # bytes of the message

    def __post_init__(self) -> None:
        self.heard = np.zeros(len(self.trials), bool)

    def rest(self) -> np.ndarray:
        """Return the trials whose outcome did not come."""
        rest: np.ndarray = self.trials[~self.done]
        return rest

    def drop(self, trial: int) -> None:
        """Await the outcome of a trial no more."""
        self.done |= self.trials == trial
        self.missing = len(self.done) - int(self.done.sum())


class RemoteServer(msgspec.Struct, eq=False):
    """What a run knows of a server."""

    id: str  # a server that is restarted has another one
    phase: Phase = Phase.IDLE
    own: bool = False  # it is this machine's, as its link shows
    machine: str = ""  # what it does wrong is held against this (``machines``)
    present: bool = False  # its token is there
    lease: bytes = b""  # while LEASED or LEAVING
    # A lease that was dropped because of silence or a cut link, in any later phase: it may still
    # be valid at the server.
    resumable_lease: bytes = b""
    # Digests of the trials of the probe, which every server plays. Equal code computes
    # equal bits on all machines (docs/architecture.md, "Determinism"): a server that differs from
    # this machine is wrong.
    probe: bytes = b""
    capacity: int = 0
    free: int = 0  # slots that no run held when it offered, or released it
    lot: bytes = b""  # decides between servers of one rank; another one for each run
    features: frozenset[str] = frozenset()
    place: tuple[float, ...] = ()  # its rank; the lowest comes first
    mismatch: str = ""  # as last reported to the user
    wanted: int = 0  # slots it was asked for
    growing: bool = False  # LEASED, and asked for more slots than before
    slots: int = 0
    ready: int = 0  # slots that can evaluate
    progress: PrepareProgress | None = (
        None  # while its first slot is prepared, if it reports that
    )
    pace: Pace = msgspec.field(default_factory=Pace)
    # Its open query for an offer, a reservation or a renewal; 0: none.
    question: int = 0
    asked_at: float = 0.0  # when that was sent
    ask_at: float = math.inf  # when the query of its phase is due
    # It had no room for a batch: no other is sent before.
    paused_until: float | None = None
    batches: dict[int, SentBatch] = {}
    unwanted: list[int] = []  # batches to cancel that the server may still have
    faulty: bool = False  # backed off: too many trials failed on its machine
    setbacks: int = 0  # since it sent an outcome: the pause grows with them
    unanswered: int = 0  # queries in a row, but for batches, that ended without an answer
    silence_reported: bool = False  # to the user

    def __post_init__(self) -> None:
        self.machine = self.machine or name_of(self.id)

    def granted(self, lease: Lease) -> float:
        """Take the state of its lease; return after how long to ask for it again at least.

        The time counts from the last query, which the server holds until there is something new.
        """
        was_ready, was = self.ready, self.progress
        self.lease, self.slots = lease.lease, min(lease.slots, self.wanted)
        self.ready = min(lease.ready, self.slots)
        progress = lease.compiling, lease.probe_begun, lease.probe_trials, lease.kernels
        self.progress = PrepareProgress(*progress) if any(progress) else None
        if self.ready > was_ready or (self.progress and not was):
            return 0.0
        return AGAIN_S if self.progress == was else PROGRESS_S

    def taken(self) -> int:
        """Return how many slots the run has here, or asked for."""
        if self.phase == Phase.RESERVING or self.growing:
            return self.wanted
        return self.slots if self.phase == Phase.LEASED else 0

    def next_setback_s(self) -> int:
        """Return for how long not to ask it, which cannot serve now."""
        pause_s = SETBACKS_S[self.setbacks]
        self.setbacks = min(self.setbacks + 1, len(SETBACKS_S) - 1)
        return pause_s

    def differs_at(self, probe: bytes) -> int | None:
        """Return the first trial of the probe that was played with other outcomes."""
        for at in range(0, min(len(self.probe), len(probe)), PROBE_DIGEST):
            if self.probe[at : at + PROBE_DIGEST] != probe[at : at + PROBE_DIGEST]:
                return at // PROBE_DIGEST
        return None


class Standing(msgspec.Struct, frozen=True):
    """The state of a run's servers."""

    serving: int = 0  # servers with a slot ready
    preparing: list[str] = []  # some of the servers that prepare their first slot
    progress: PrepareProgress | None = None  # of the first of these
    leased: int = 0  # servers that granted a lease
    spare: int = 0  # servers that match and whose slots are not wanted
    slots: int = 0  # that are ready
    probe: bytes = b""  # digest of the probe's outcomes, once known
    own: frozenset[str] = frozenset()  # this machine's servers, once seen
