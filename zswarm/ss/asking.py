"""How slots ask the optimizer for what its controllers decide, where it keeps them (``Reserve.asks``).

A slot's process sends ``Sensors`` by its pipe and waits for the answer. The server's loop sends them on, one question at a time
for each slot, and asks again until the answer comes, the slot is told to stop, or its process ends. An answer goes into the pipe
in zenoh's thread, in which it comes: waking the loop for it would take as long as the controllers' decision.
"""

import math
import os
import threading
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection

import msgspec
import numpy as np

from zswarm.errors import EvaluationError
from zswarm.protocol import codec
from zswarm.protocol.messages import Asks, Evaluate, Refused, Sensors

AGAIN_S = (0.05, 0.2, 1.0)  # before a question is asked again that nobody answered; the last one from then on
AT_ONCE = 12_000  # bytes of unanswered questions of a run that zenoh takes without waiting
NOBODY = codec.encode(Refused(code="cancelled", reason="nobody waits for the batch any more"))


# ---- in a slot's process ------------------------------------------------------------------------------------------


class Unanswered(EvaluationError):
    """The optimizer refused, or nobody waits for the batch any more."""

    def __init__(self, refused: Refused) -> None:
        super().__init__(refused.reason)
        self.refused = refused


class Trial:
    """The controllers of a trial's agents, by asking.

    Args:
        trial: index in the batch that the optimizer knows.
    """

    def __init__(self, pipe: Connection, batch: Evaluate, trial: int, outputs: int, asks: Asks) -> None:
        self._pipe, self._batch, self._trial, self._outputs = pipe, batch, trial, outputs
        self._each = asks == "agent"
        self._play, self._number = os.urandom(16), 0

    def decide(self, agents: Sequence[int], participants: Sequence[int], observations: np.ndarray) -> np.ndarray:
        """What they decide: (agents, outputs) float32; in one question, or in one for each.

        Raises:
            Unanswered: there is no answer to come.
        """
        if not self._each:
            return self._ask(agents, participants, observations)
        ones = [slice(row, row + 1) for row in range(len(agents))]
        return np.concatenate([self._ask(agents[one], participants[one], observations[one]) for one in ones])

    def _ask(self, agents: Sequence[int], participants: Sequence[int], observations: np.ndarray) -> np.ndarray:
        question = Sensors(
            lease=self._batch.lease,
            batch=self._batch.batch,
            trial=self._trial,
            play=self._play,
            number=self._number,
            agents=np.array(agents, "<u4").tobytes(),
            participants=np.array(participants, "<u4").tobytes(),
            observations=observations.astype("<f4", copy=False).tobytes(),
        )
        self._pipe.send_bytes(b"S" + codec.encode(question))
        reaction = codec.decode_reaction(self._pipe.recv_bytes())
        if isinstance(reaction, Refused):
            raise Unanswered(reaction)
        self._number += 1
        return codec.decided(reaction, len(agents), self._outputs)


# ---- in the server ------------------------------------------------------------------------------------------------


class Unheard(msgspec.Struct, frozen=True):
    """A question ended without an answer."""

    question: int


class Waiting(msgspec.Struct, eq=False):
    """A question without an answer."""

    number: int
    run: tuple[str, str]
    body: bytes
    asked: int = 0  # times, without being heard
    again_at: float = math.inf


class Asking:
    """The questions of all slots; the loop's, but for ``answer``.

    Args:
        send: sends a question's number and body to a run, by user and run, in this thread if told: that does not block then. What
            comes back is told by ``answer``, or put as ``Unheard``.
        reply: puts an answer into a slot's pipe.
    """

    def __init__(self, send: Callable[[tuple[str, str], int, bytes, bool], None], reply: Callable[[int, bytes], None]) -> None:
        self._send, self._reply = send, reply
        self._waiting: dict[int, Waiting] = {}  # by slot
        self._lock = threading.Lock()  # a slot that does not wait any more may have a new process, at another pipe
        self._count = 0

    def ask(self, slot: int, run: tuple[str, str], body: bytes) -> None:
        """Ask for a slot."""
        with self._lock:
            self._count += 1
            waiting = self._waiting[slot] = Waiting(self._count, run, body)
            out = sum(len(other.body) for other in self._waiting.values() if other.run == run)
        self._send(run, waiting.number, body, out < AT_ONCE)

    def answer(self, question: int, body: bytes) -> None:
        """Give the slot its answer if it waits for it; by any thread."""
        with self._lock:
            for slot, waiting in self._waiting.items():
                if waiting.number == question:
                    del self._waiting[slot]
                    self._reply(slot, body)
                    return

    def unheard(self, question: int, now: float) -> None:
        """Nobody answered: the question is asked again in a while."""
        with self._lock:
            for waiting in self._waiting.values():
                if waiting.number == question:
                    waiting.again_at = now + AGAIN_S[min(waiting.asked, len(AGAIN_S) - 1)]
                    waiting.asked += 1

    def stop(self, slot: int) -> None:
        """Tell a slot that waits that nobody answers."""
        with self._lock:
            if self._waiting.pop(slot, None) is not None:
                self._reply(slot, NOBODY)

    def forget(self, slot: int) -> None:
        """Its process ended, or is about to."""
        with self._lock:
            self._waiting.pop(slot, None)

    def next_time(self) -> float:
        """When to ask again."""
        with self._lock:
            return min((waiting.again_at for waiting in self._waiting.values()), default=math.inf)

    def ask_again(self, now: float) -> None:
        """Ask what it is time for."""
        with self._lock:
            due = [waiting for waiting in self._waiting.values() if waiting.again_at <= now]
            for waiting in due:
                waiting.again_at = math.inf
        for waiting in due:
            self._send(waiting.run, waiting.number, waiting.body, False)
