"""A server that lies: it looks like any other, and answers batches with what its lie returns."""

from collections import Counter
from collections.abc import Callable

import msgspec
import numpy as np
import zenoh

from tests.integration.programs import free_port
from zswarm import session
from zswarm.protocol import codec, keys, messages
from zswarm.protocol.messages import Evaluate, Message, Verb

SLOTS = 4
METRICS = 5  # of a trial of xor


class Liar:
    """A server on loopback, in this process.

    Args:
        answers: what it answers to a verb instead of what a server would, as bytes.

    Attributes:
        asked: how often it was asked, by verb.
    """

    def __init__(
        self,
        answers: dict[Verb, Callable[[Message], bytes]],
        *,
        name: str = "liar-00000000",
    ) -> None:
        self.asked: Counter[str] = Counter()
        self.name, self._answers = name, answers
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        reach = session.Reach(multicast=False)
        self._session, _ = session.open_server([self.endpoint], reach)
        callback = zenoh.handlers.Callback(self._on_query, indirect=False)
        for key in (keys.offer("default", name), keys.requests("default", name)):
            self._session.declare_queryable(key, callback)
        alive = keys.alive("default", name)
        self._token = self._session.liveliness().declare_token(alive)

    def close(self) -> None:
        """End it."""
        session.close(self._session)

    def _on_query(self, query: zenoh.Query) -> None:
        assert query.payload is not None
        _, message = codec.decode_query(str(query.key_expr), query.payload.to_bytes())
        verb = messages.verb(message)
        self.asked[verb] += 1
        answer = self._answers.get(verb, self._usual)
        with query:
            query.reply(query.key_expr, answer(message))

    def _usual(self, message: Message) -> bytes:
        """Answer as a server does that has slots for everybody; batches run for ever."""
        match message:
            case messages.Requirements():
                return codec.encode(offer(self.name))
            case messages.Reserve() | messages.Renew():
                return lease()
            case messages.Evaluate():
                return codec.encode(
                    messages.Running(batch=message.batch, done=0, given=True)
                )
        return codec.encode(messages.Done())


def offer(name: str, mismatch: str = "") -> messages.Offer:
    return messages.Offer(
        server=name,
        program="",
        machine="",
        capacity=SLOTS,
        free=SLOTS,
        leases=0,
        simulators=[],
        representations=[],
        mismatch=mismatch,
    )


def lease(**fields: object) -> bytes:
    """Return a lease that is ready, with fields that no server sends."""
    usual = {"type": "lease", "lease": bytes(16), "state": "ready"}
    usual |= {"slots": SLOTS, "ready": SLOTS, "trial_s": 0.001}
    return msgspec.msgpack.encode(usual | fields)


def outcomes(message: Message, fitness: float, **fields: object) -> bytes:
    """Return outcomes of all trials of a batch of xor."""
    assert isinstance(message, Evaluate)
    trials = len(message.seeds) // 8
    usual = {"type": "outcomes", "batch": message.batch, "seconds": 0.001}
    usual["fitness"] = np.full(trials, fitness).tobytes()
    usual["metrics"] = np.zeros((trials, METRICS)).tobytes()
    return msgspec.msgpack.encode(usual | fields)


def refused(code: str, reason: str) -> bytes:
    return codec.encode(messages.Refused(code=code, reason=reason))
