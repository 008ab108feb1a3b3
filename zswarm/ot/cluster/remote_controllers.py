"""Controllers that stay at the optimizer (``cluster.controller``): servers ask for their actions.

Zenoh's threads call ``react``, each for its own servers; it never waits.
"""

from typing import NamedTuple

import msgspec
import numpy as np

from zswarm.errors import RemoteProtocolError
from zswarm.nets.networks import Networks
from zswarm.nets.representation import Representation
from zswarm.ot.workload import Workload
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    MAX_TEXT,
    Actuators,
    Reaction,
    Refusal,
    Refused,
    Sensors,
)


class _Play(msgspec.Struct, eq=False):
    """A trial that a server plays."""

    token: bytes
    networks: Networks
    asked: int = 0  # questions
    answer: bytes = b""  # to the last one


class _Batch(NamedTuple):
    """Trials that a server has."""

    lease: bytes
    parameters: np.ndarray  # (genomes, P) float32
    participants: np.ndarray  # (trials, k), rows of these
    plays: dict[int, _Play]  # by trial


class RemoteControllers(msgspec.Struct, eq=False):
    """The controllers of one run."""

    representation: Representation
    participants: int  # that play a trial together
    _workload: Workload | None = None
    _parameters: np.ndarray = np.empty((0, 0), np.float32)
    _batches: dict[tuple[str, int], _Batch] = {}

    def begin(self, workload: Workload) -> None:
        """Control the genomes of another workload; refuse questions about earlier ones."""
        self._batches = {}
        self._workload = workload
        self._parameters = self.representation.parameters(workload.genomes)

    def give(self, server: str, lease: bytes, batch: int, trials: np.ndarray) -> None:
        """Let a server ask about trials of the workload, as those of a batch.

        A batch may be given again: trials that have begun continue.
        """
        assert self._workload is not None  # noqa: S101  batches are of one
        known = self._batches.get((server, batch))
        plays = known.plays if known is not None and known.lease == lease else {}
        participants = self._workload.participants[trials]
        self._batches[server, batch] = _Batch(
            lease, self._parameters, participants, plays
        )

    def take_back(self, server: str, batch: int) -> None:
        """Forget a batch that was answered."""
        self._batches.pop((server, batch), None)

    def react(self, server: str, body: bytes) -> bytes:
        """Return the answer to a server's question."""
        try:
            return self._answer(server, codec.decode_sensors(body))
        except RemoteProtocolError as error:
            return _refuse("malformed", str(error))

    def _answer(self, server: str, message: Sensors) -> bytes:
        batch = self._batches.get((server, message.batch))
        if batch is None or batch.lease != message.lease:
            text = "this server does not have such a batch: it was answered, or is done elsewhere"
            return _refuse("cancelled", text)
        count = len(batch.participants)
        if message.trial >= count:
            raise RemoteProtocolError(
                f"trial {message.trial} is not in a batch of {count}"
            )
        play = batch.plays.get(message.trial)
        if play is None or play.token != message.play:
            if message.number:
                text = f"question {message.number} came before the first one of its trial"
                return _refuse("cancelled", text)
            parameters = batch.parameters[batch.participants[message.trial]]
            play = _Play(message.play, Networks(self.representation, parameters))
            batch.plays[message.trial] = play
        if message.number == play.asked - 1:
            return play.answer
        if message.number != play.asked:
            text = f"question {message.number} came instead of question {play.asked}"
            return _refuse("cancelled", text)
        sensed = codec.sensed(message, self.participants, self.representation.inputs)
        actions = play.networks.decide(*sensed).astype("<f4", copy=False)
        play.answer = codec.encode(Actuators(actions=actions.tobytes()))
        play.asked += 1
        return play.answer


def _refuse(code: Refusal, reason: str) -> bytes:
    reaction: Reaction = Refused(code=code, reason=reason[:MAX_TEXT])
    return codec.encode(reaction)
