"""The states of leases and slots.

The state of a lease is not stored; it follows from its slots:

=========  =========================================  ==========================================
state      the lease ...                              it leaves the state when ...
=========  =========================================  ==========================================
waiting    has no slot, and lent none                 a slot is assigned to it (preparing)
preparing  has slots, none ready for its problem, or  the first slot is prepared (ready), or all
           does not know the probe (``probing``)      are given back (waiting)
ready      has a slot that evaluates, or could, or    its last ready slot dies (preparing), or its
           lent one (``sharing``)                     last slot is given back (waiting)
failed     cannot be served: ``failure`` has the      never; the run is to release it
           reason, and it has no slots
=========  =========================================  ==========================================

A lease fails when a slot cannot be prepared, or takes too long to; or when the process of a slot
dies three times while it is prepared, and no other slot of the lease could be. Such a failure may
pass if the machine can be the reason, not the problem alone: it took too long, the process died
for another reason than its limit of memory, or what it needed was missing (``workers/passing``).

A slot is prepared for one problem at a time; ``MOVES`` has the allowed changes of its state:

=========  =========================================  ==========================================
state      the slot ...                               it leaves the state when ...
=========  =========================================  ==========================================
free       is held by no lease                        it is assigned to a lease
assigned   is held by a lease, and waits              its process is to be prepared, or is known
                                                      to be prepared for the problem already
preparing  compiles or loads the problem, or plays    it is prepared (ready)
           trials of the probe
ready      is idle                                    it gets a chunk (busy), or trials of the
                                                      probe (preparing)
busy       evaluates a chunk                          the chunk is finished (ready)
stopping   lost its lease while it worked             its work ended (free)
=========  =========================================  ==========================================

A slot whose process dies, or is replaced for its memory, is assigned again. One that is given back,
or whose lease ends, becomes free if it is assigned or ready, and stopping otherwise.
"""

from typing import Literal, NamedTuple

import msgspec

from zswarm.errors import LocalProtocolError
from zswarm.protocol.messages import Lease, Refusal, Reserve, State
from zswarm.ss.slots.events import Query
from zswarm.ss.slots.jobs import Chunk, JobQueue
from zswarm.ss.slots.probing import ProbeTrials

LEASE_S = 60.0  # after the last message
GRACE_S = 30.0  # after the holder's token vanished
REPORT_S = 0.5  # between two answers about how far a lease is that is not ready


SlotState = Literal["free", "assigned", "preparing", "ready", "busy", "stopping"]
MOVES: dict[SlotState, set[SlotState]] = {
    "free": {"assigned"},
    "assigned": {"preparing", "ready", "free"},
    "preparing": {"ready", "assigned", "stopping"},
    "ready": {"busy", "preparing", "assigned", "free"},
    "busy": {"ready", "assigned", "stopping"},
    "stopping": {"free"},
}


class KnownProbe(NamedTuple):
    """The probe of a problem, played on this server."""

    digest: bytes  # of the trials in order; empty if the simulator is not repeatable
    trial_s: float  # of one trial


class LeaseProgress(NamedTuple):
    """How far a lease is whose slots are prepared."""

    compiling: int = 0  # kernels that are not compiled
    probe_begun: int = 0  # trials
    probe_trials: int = 0  # that the probe has
    kernels: int = 0  # that were to be compiled


class Slot(msgspec.Struct, eq=False):
    """Room for one evaluation."""

    index: int
    state: SlotState = "free"
    # What it does is timed from then: its state or its trial began, or it was told to stop.
    timed_from: float = 0.0
    lease: "HeldLease | None" = None
    prepared_for: Reserve | None = None  # whose problem its process is prepared for
    chunk: Chunk | None = None
    probing: range = range(0)  # trials of the probe that it plays
    trial: int = -1  # that it is at, an index in the chunk; -1 if not known yet
    deaths: int = 0  # in a row, while it was prepared for this lease
    freed: int = 0  # how often it became free

    def move(self, state: SlotState, now: float) -> None:
        """Change the state.

        Raises:
            LocalProtocolError: the move is not allowed.
        """
        if state not in MOVES[self.state]:
            raise LocalProtocolError(f"slot {self.index}: {self.state} to {state}")
        self.state, self.timed_from = state, now
        self.freed += state == "free"
        if state != "preparing":
            self.probing = range(0)


class Renewal(NamedTuple):
    """An open query for the state of a lease."""

    query: Query
    known_ready: int  # number of ready slots that the run knows of
    since: float


class HeldLease(msgspec.Struct, eq=False):
    """A lease."""

    token: bytes
    user: str
    run: str
    reserve: Reserve  # the message that asked for it
    wanted: int  # slots
    since: float
    last_message: float
    jobs: JobQueue
    gone_since: float | None = None  # the holder's token vanished then
    slots: list[Slot] = []
    # Since when slots are idle while outcomes are not reported.
    unreported_since: float | None = None
    renewals: list[Renewal] = []
    probe: KnownProbe | None = None  # of its problem, once played
    trials: ProbeTrials = msgspec.field(default_factory=ProbeTrials)  # of it
    reported: tuple[LeaseProgress, float] = (
        LeaseProgress(),
        0.0,
    )  # what the run knows, and since when
    served: bool = False  # a slot was ready for it
    prepare_s: float = 0.0  # of the slot that took longest
    idle_since: float | None = None  # a slot has had nothing to evaluate since then
    lent: int = 0  # slots that others use until this one has work
    # Slot-seconds, those before the last turn faded; and those at the last turn.
    used: float = 0.0
    used_at_turn: float = 0.0
    failure: str = ""
    passing: bool = False  # the failure may pass

    @property
    def failure_code(self) -> Refusal:
        """The code with which its batches are refused once it failed."""
        return "busy" if self.passing else "mismatch"

    def ready(self) -> int:
        """Return how many slots evaluate, or could: those that are lent come back for work."""
        if self.probe is None:
            return 0
        return self.lent + sum(slot.state in ("ready", "busy") for slot in self.slots)

    def working(self) -> int:
        """Return how many slots evaluate or are prepared."""
        return sum(slot.state in ("preparing", "busy") for slot in self.slots)

    def playing(self) -> set[int]:
        """Return the trials of the probe that its slots play."""
        return {trial for slot in self.slots for trial in slot.probing}

    def useful(self) -> int:
        """Return how many slots have a trial, or could have one that waits."""
        busy = sum(slot.state == "busy" for slot in self.slots)
        return busy + sum(job.rest() for job in self.jobs.waiting)

    def watch_idle(self, now: float) -> None:
        """Notice whether slots are idle, or lent because they were."""
        if (
            self.probe is None
            or self.jobs.waiting
            or not (self.lent or any(slot.state == "ready" for slot in self.slots))
        ):
            self.idle_since = None
        elif self.idle_since is None:
            self.idle_since = now

    def idle(self, now: float, for_s: float) -> bool:
        """Return whether slots have had nothing to evaluate for so long."""
        since = None if self.jobs.waiting else self.idle_since
        return since is not None and now - since >= for_s

    def progress(self) -> LeaseProgress:
        """Return how far it is before the first slot is ready."""
        if not self.slots or self.ready():
            return LeaseProgress()
        return LeaseProgress(*self.trials.progress())

    def got_on(self, now: float) -> bool:
        """Return whether the run is to know how far it is now."""
        known, since = self.reported
        return now - since >= REPORT_S and self.progress() != known

    def status(self) -> Lease:
        """Return the message that reports the state, as in the table above."""
        ready = self.ready()
        state: State = "ready" if ready else "preparing" if self.slots else "waiting"
        return Lease(
            lease=self.token,
            state="failed" if self.failure else state,
            slots=len(self.slots) + self.lent,
            ready=ready,
            probe=self.probe.digest if self.probe else b"",
            trial_s=self.probe.trial_s if self.probe else 0.0,
            reason=self.failure,
            passing=self.passing,
            **self.progress()._asdict(),
        )

    def renew(self, now: float) -> None:
        """Restart the time of the lease: its run sent a message."""
        self.last_message, self.gone_since = now, None

    def expired(self, now: float) -> bool:
        """Return whether the run was silent or gone for too long."""
        gone = self.gone_since is not None and now - self.gone_since > GRACE_S
        return gone or now - self.last_message > LEASE_S

    def prepared(self, slot: Slot) -> bool:
        """Return whether the process of a slot is prepared for the problem of this lease."""
        return slot.prepared_for is not None and (
            slot.prepared_for is self.reserve
            or problem_key(slot.prepared_for) == problem_key(self.reserve)
        )


def problem_key(reserve: Reserve) -> bytes:
    """Return a key that is equal for leases whose slots are prepared alike."""
    parts = (reserve.simulator, reserve.representation, reserve.version_hash)
    how = (reserve.trial_memory_mb, reserve.asks)
    return msgspec.msgpack.encode((*parts, *how), order="deterministic")
