"""The controllers of candidates where the optimizer keeps them (``cluster.controller``): servers ask what they decide.

Zenoh's threads call ``react``, each for the servers of its own; it waits for nothing.
"""

from typing import NamedTuple

import msgspec
import numpy as np

from zswarm.errors import RemoteProtocolError
from zswarm.nets.networks import Networks
from zswarm.nets.representation import Representation
from zswarm.ot.workload import Workload
from zswarm.protocol import codec
from zswarm.protocol.messages import MAX_TEXT, Actuators, Reaction, Refusal, Refused, Sensors


class _Play(msgspec.Struct, eq=False):
    """A trial that is played."""

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


class Controllers:
    """Of one run.

    Args:
        participants: that play a trial together.
    """

    def __init__(self, representation: Representation, participants: int) -> None:
        self._representation, self._count = representation, participants
        self._workload: Workload | None = None
        self._parameters = np.empty((0, 0), np.float32)
        self._batches: dict[tuple[str, int], _Batch] = {}

    def begin(self, workload: Workload) -> None:
        """Decide for another workload's genomes; who asks for an earlier one's is refused."""
        self._batches = {}
        self._workload, self._parameters = workload, self._representation.parameters(workload.genomes)

    def give(self, server: str, lease: bytes, batch: int, trials: np.ndarray) -> None:
        """A server may ask for trials of the workload, as those of a batch. It may be told again: what is played goes on."""
        assert self._workload is not None  # noqa: S101  batches are of one
        known = self._batches.get((server, batch))
        plays = known.plays if known is not None and known.lease == lease else {}
        self._batches[server, batch] = _Batch(lease, self._parameters, self._workload.participants[trials], plays)

    def take_back(self, server: str, batch: int) -> None:
        """It has done with a batch."""
        self._batches.pop((server, batch), None)

    def react(self, server: str, body: bytes) -> bytes:
        """The answer to a server's question."""
        try:
            return self._answer(server, codec.decode_sensors(body))
        except RemoteProtocolError as error:
            return _refuse("malformed", str(error))

    def _answer(self, server: str, message: Sensors) -> bytes:
        batch = self._batches.get((server, message.batch))
        if batch is None or batch.lease != message.lease:
            return _refuse("cancelled", "no such batch is with this server: it was answered, or is done elsewhere")
        if message.trial >= len(batch.participants):
            raise RemoteProtocolError(f"trial {message.trial} is none of a batch of {len(batch.participants)}")
        play = batch.plays.get(message.trial)
        if play is None or play.token != message.play:
            if message.number:
                return _refuse("cancelled", f"question {message.number} is of a trial whose beginning was not asked about")
            parameters = batch.parameters[batch.participants[message.trial]]
            play = batch.plays[message.trial] = _Play(message.play, Networks(self._representation, parameters))
        if message.number == play.asked - 1:
            return play.answer
        if message.number != play.asked:
            return _refuse("cancelled", f"question {message.number} came when {play.asked} was to come")
        actions = play.networks.decide(*codec.sensed(message, self._count, self._representation.inputs))
        play.answer, play.asked = codec.encode(Actuators(actions=actions.astype("<f4", copy=False).tobytes())), play.asked + 1
        return play.answer


def _refuse(code: Refusal, reason: str) -> bytes:
    reaction: Reaction = Refused(code=code, reason=reason[:MAX_TEXT])
    return codec.encode(reaction)
