"""How slots ask the optimizer for what its controllers decide, where it keeps them (``Reserve.asks``).

A slot's process sends ``Sensors`` by its pipe and waits for the answer. The server's loop sends them on, one question at a time
for each slot, and asks again until the answer comes, the slot is told to stop, or its process ends.
"""

import math
import os
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection

import msgspec
import numpy as np

from zswarm.errors import EvaluationError
from zswarm.protocol import codec
from zswarm.protocol.messages import Asks, Evaluate, Refused, Sensors

AGAIN_S = (0.05, 0.2, 1.0)  # before a question is asked again that nobody answered; the last one from then on
AT_ONCE = 12_000  # bytes of unanswered questions of a run that zenoh takes without waiting


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


class Answered(msgspec.Struct, frozen=True):
    """A question ended: with an answer, or without one."""

    question: int
    body: bytes | None


class Waiting(msgspec.Struct, eq=False):
    """A question without an answer."""

    number: int
    run: tuple[str, str]
    body: bytes
    asked: int = 0  # times
    again_at: float = math.inf


class Asking:
    """The questions of all slots.

    Args:
        send: sends a question's body to a run, by user and run, and tells ``Answered`` with its number; at once if told, for that
            does not block.
    """

    def __init__(self, send: Callable[[tuple[str, str], int, bytes, bool], None]) -> None:
        self._send = send
        self._waiting: dict[int, Waiting] = {}  # by slot
        self._slots: dict[int, int] = {}  # by question
        self._count = 0

    def ask(self, slot: int, run: tuple[str, str], body: bytes) -> None:
        """Ask for a slot."""
        self._count += 1
        out = sum(len(other.body) for other in self._waiting.values() if other.run == run)
        waiting = self._waiting[slot] = Waiting(self._count, run, body)
        self._slots[self._count] = slot
        self._send(run, waiting.number, body, out + len(body) < AT_ONCE)

    def answered(self, event: Answered, now: float) -> tuple[int, bytes] | None:
        """The slot and the answer, if it is one, and one that is waited for."""
        slot = self._slots.get(event.question)
        if slot is None:
            return None
        waiting = self._waiting[slot]
        if event.body is None:
            waiting.again_at = now + AGAIN_S[min(waiting.asked, len(AGAIN_S) - 1)]
            waiting.asked += 1
            return None
        self.end(slot)
        return slot, event.body

    def end(self, slot: int) -> bool:
        """Wait for a slot's answer no more; whether it was waited for."""
        if (waiting := self._waiting.pop(slot, None)) is None:
            return False
        del self._slots[waiting.number]
        return True

    def next_time(self) -> float:
        """When to ask again."""
        return min((waiting.again_at for waiting in self._waiting.values()), default=math.inf)

    def ask_again(self, now: float) -> None:
        """Ask what it is time for."""
        for waiting in self._waiting.values():
            if waiting.again_at <= now:
                waiting.again_at = math.inf
                self._send(waiting.run, waiting.number, waiting.body, False)
