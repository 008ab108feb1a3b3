"""Questions to the optimizer, where its controllers decide for the agents (``Reserve.asks``).

A slot's process sends ``Sensors`` by its pipe and waits for the answer. The server's loop forwards
them, one question at a time for each slot, and asks again until the answer comes, the slot is to
stop, or its process ends. Zenoh's thread writes the answer into the pipe: to wake the loop for it
would take as long as the controllers' decision.
"""

import math
import os
import threading
from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from zswarm.errors import EvaluationError
from zswarm.protocol import codec
from zswarm.protocol.messages import Asks, Evaluate, Refused, Sensors
from zswarm.ss.workers.frames import ProcessEnd

# Before a lost question is asked again; the last one from then on.
AGAIN_S = (0.05, 0.2, 1.0)
AT_ONCE = 12_000  # bytes of open questions of a run that zenoh takes without blocking
CANCELLED = codec.encode(Refused(code="cancelled", reason="the batch was cancelled"))

Answered = Callable[[int, bytes], None]
Send = Callable[[tuple[str, str], int, bytes, Answered, bool], None]


# ---- in a slot's process ------------------------------------------------------------------


class Unanswered(EvaluationError):
    """The optimizer refused, or the batch was cancelled."""

    def __init__(self, refused: Refused) -> None:
        super().__init__(refused.reason)
        self.refused = refused


class Trial(msgspec.Struct, eq=False):
    """The controllers of a trial of a run's batch, which the optimizer evaluates."""

    pipe: ProcessEnd
    batch: Evaluate
    trial: int  # index in the batch
    outputs: int
    asks: Asks
    _play: bytes = msgspec.field(default_factory=lambda: os.urandom(16))
    _number: int = 0

    def decide(
        self, agents: Sequence[int], participants: Sequence[int], observations: np.ndarray
    ) -> np.ndarray:
        """Return the actions, (agents, outputs) float32, by one question or by one for each agent.

        Raises:
            Unanswered: no answer will come.
        """
        if self.asks == "turn":
            return self._ask(agents, participants, observations)
        ones = [slice(row, row + 1) for row in range(len(agents))]
        return np.concatenate(
            [self._ask(agents[one], participants[one], observations[one]) for one in ones]
        )

    def _ask(
        self, agents: Sequence[int], participants: Sequence[int], observations: np.ndarray
    ) -> np.ndarray:
        question = Sensors(
            lease=self.batch.lease,
            batch=self.batch.batch,
            trial=self.trial,
            play=self._play,
            number=self._number,
            agents=np.array(agents, "<u4").tobytes(),
            participants=np.array(participants, "<u4").tobytes(),
            observations=observations.astype("<f4", copy=False).tobytes(),
        )
        self.pipe.send(codec.encode(question))
        reaction = codec.decode_reaction(self.pipe.receive())
        if isinstance(reaction, Refused):
            raise Unanswered(reaction)
        self._number += 1
        return codec.decided(reaction, len(agents), self.outputs)


# ---- in the server ------------------------------------------------------------------------


class Unheard(msgspec.Struct, frozen=True):
    """A question ended without an answer."""

    question: int


class FullPipe(msgspec.Struct, frozen=True):
    """A slot's process did not take all of an answer yet."""

    slot: int


class PendingQuestion(msgspec.Struct, eq=False):
    """A question that is not answered yet."""

    number: int
    run: tuple[str, str]
    body: bytes
    lost: int = 0  # how often
    again_at: float = math.inf


class Questions:
    """The open questions of all slots. The loop calls it; any thread may call ``answer``.

    Args:
        send: sends a question to a run (user, run): its number, its body, what takes the answer,
            and whether to send it in this thread, because it does not block.
        reply: writes an answer into a slot's pipe, and does not block.
    """

    def __init__(self, send: Send, reply: Callable[[int, bytes], None]) -> None:
        self._send, self._reply = send, reply
        self._pending: dict[int, PendingQuestion] = {}  # by slot
        # An answer must not reach the next process of a slot, which has another pipe.
        self._lock = threading.Lock()
        self._count = 0

    def ask(self, slot: int, run: tuple[str, str], body: bytes) -> None:
        """Ask a run's optimizer for a slot."""
        with self._lock:
            self._count += 1
            question = self._pending[slot] = PendingQuestion(self._count, run, body)
            open_ = sum(
                len(other.body) for other in self._pending.values() if other.run == run
            )
        self._send(run, question.number, body, self.answer, open_ < AT_ONCE)

    def answer(self, question: int, body: bytes) -> None:
        """Give an answer to the slot that waits for it."""
        with self._lock:
            for slot, pending in self._pending.items():
                if pending.number == question:
                    del self._pending[slot]
                    self._reply(slot, body)
                    return

    def unheard(self, question: int, now: float) -> None:
        """Ask a lost question again after a while."""
        with self._lock:
            for pending in self._pending.values():
                if pending.number == question:
                    pending.again_at = now + AGAIN_S[min(pending.lost, len(AGAIN_S) - 1)]
                    pending.lost += 1

    def stop(self, slot: int) -> None:
        """End the question of a slot that is to stop."""
        with self._lock:
            if self._pending.pop(slot, None) is not None:
                self._reply(slot, CANCELLED)

    def forget(self, slot: int) -> None:
        """Drop the question of a slot whose process ended or is about to."""
        with self._lock:
            self._pending.pop(slot, None)

    def next_time(self) -> float:
        """Return when to call ``ask_again``."""
        with self._lock:
            return min(
                (pending.again_at for pending in self._pending.values()), default=math.inf
            )

    def ask_again(self, now: float) -> None:
        """Send the questions again that are due."""
        with self._lock:
            due = [
                pending for pending in self._pending.values() if pending.again_at <= now
            ]
            for pending in due:
                pending.again_at = math.inf
        for pending in due:
            self._send(pending.run, pending.number, pending.body, self.answer, False)
