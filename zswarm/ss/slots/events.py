"""Events into the slot table, and commands out of it.

The server and a slot's process exchange those about one slot (``workers/child.py``).
"""

from typing import Literal

import msgspec

from zswarm.protocol import codec, messages

Query = int  # stands for a query that waits for its answer


class SlotMessage(msgspec.Struct, frozen=True, tag_field="type", tag=str.lower):
    """An event or a command about one slot."""

    slot: int


# ---- events -------------------------------------------------------------------------------


class Asked(msgspec.Struct, frozen=True):
    """A run sent a request."""

    query: Query
    user: str
    run: str
    message: messages.Request


class HolderAlive(msgspec.Struct, frozen=True):
    """The liveliness token of a run appeared or vanished."""

    user: str
    run: str
    alive: bool


class Preparing(SlotMessage, frozen=True):
    """The slot has built its problem; other slots can load its kernels if none is to compile."""

    compiling: int  # kernels that are not compiled, before the first trial
    probe_trials: int  # that the probe has: one if the simulator is not repeatable
    kernels: int = 0  # that were to be compiled


class Prepared(SlotMessage, frozen=True):
    """The slot played trials of the probe, and is ready for its problem."""

    probe: bytes  # digests of the trials; b"" if the simulator is not repeatable
    trial_s: float  # of one of them
    first: int = 0  # of them
    loaded: bool = False  # it was prepared before


class Unprepared(SlotMessage, frozen=True):
    """The slot cannot evaluate its problem."""

    reason: str
    passing: bool = False  # it may be able to later


class Finished(SlotMessage, frozen=True):
    """The slot finished its chunk, or refused it as malformed."""

    reply: messages.Outcomes | messages.Refused
    recycle: bool = False  # little memory is left in its process


class Exhausted(SlotMessage, frozen=True):
    """The process ran out of memory at a trial of its chunk; see ``jobs.JobQueue.exhausted``."""

    trial: int  # index in the chunk


class Died(SlotMessage, frozen=True):
    """The process ended at a trial of its chunk; a new one is started."""

    trial: int  # index in the chunk
    reason: str
    kind: messages.FaultKind | Literal["stopped"] = "crashed"


class Tick(msgspec.Struct, frozen=True):
    """Time passed; comes at least every 0.25 s while there are leases, or slots that stop."""

    # For each slot the trial that it is at, an index in its chunk; -1 while the chunk is on the
    # way to its process.
    positions: tuple[int, ...]


class Drain(msgspec.Struct, frozen=True):
    """Finish the chunks that run, and accept no new work; the token is undeclared already."""


SlotEvent = Preparing | Prepared | Unprepared | Finished | Exhausted | Died
Event = Asked | HolderAlive | SlotEvent | Tick | Drain


# ---- commands -----------------------------------------------------------------------------


class Answer(msgspec.Struct, frozen=True):
    """Answer a query; no other answer follows."""

    query: Query
    body: bytes


class PrepareSlot(SlotMessage, frozen=True):
    """Prepare the slot for a problem; Prepared, Unprepared or Died follows.

    It reports how far it is by Preparing, and then plays a trial of the probe, which loads all that
    trials need.
    """

    reserve: messages.Reserve  # with the problem
    first: int = 0  # this trial
    most: int = 1  # and following ones, so many in all, if they are short


class PlayProbe(SlotMessage, frozen=True):
    """Play trials of the probe in a slot that is prepared; Prepared or Died follows."""

    first: int
    count: int


class RunChunk(SlotMessage, frozen=True):
    """Evaluate a chunk in the slot; Finished, Exhausted or Died follows."""

    work: messages.Evaluate
    first: int = 0  # index of its first trial in the batch of the run


class StopSlot(SlotMessage, frozen=True):
    """Stop the chunk of the slot before its next trial."""


class KillSlot(SlotMessage, frozen=True):
    """Replace the process of the slot by a new one; no Died follows."""


class Log(msgspec.Struct, frozen=True):
    """Write a line to the log."""

    event: str
    fields: dict[str, str | int | float]


class Drained(msgspec.Struct, frozen=True):
    """Exit: nothing runs any more."""


Command = (
    Answer | PrepareSlot | PlayProbe | RunChunk | StopSlot | KillSlot | Log | Drained
)


class CommandList(list[Command]):
    """The commands that follow from an event; the parts of the slot table share it.

    Attributes:
        now: monotonic time of the event.
    """

    now = 0.0

    def answer(self, query: Query, message: messages.Message) -> None:
        """Answer a query."""
        self.append(Answer(query, codec.encode(message)))

    def refuse(self, query: Query | None, code: messages.Refusal, reason: str) -> None:
        """Refuse what a query asks for, if one is open."""
        if query is not None:
            self.answer(
                query, messages.Refused(code=code, reason=reason[: messages.MAX_TEXT])
            )

    def log(self, event: str, **fields: str | int | float) -> None:
        """Write a line to the log."""
        self.append(Log(event, fields))
