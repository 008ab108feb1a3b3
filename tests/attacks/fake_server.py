"""Servers whose answers to an optimizer are mutated, and whose questions to it."""

import queue
import random
import secrets
import threading
from collections import Counter
from types import TracebackType
from typing import Any, Self

import numpy as np
import zenoh

from tests.attacks.mutation import mutated
from tests.integration.programs import free_port
from zswarm import evaluate, session
from zswarm.errors import RemoteProtocolError
from zswarm.protocol import codec, keys, messages
from zswarm.protocol.keys import ServerKey

METRICS = len(evaluate.build("xor", {}, "fully-meshed", {})[0].metrics)
SHOWN = 12  # servers at a time
# An optimizer drops servers whose answers are not valid: there are always new ones.
RENEWED_S = 0.2
CODES = [
    "malformed",
    "lease-lost",
    "busy",
    "draining",
    "mismatch",
    "unknown-batch",
    "cancelled",
    "?",
]


class FakeServers:
    """Many servers at one endpoint; ``with`` shows them and takes them away."""

    def __init__(self, draw: random.Random) -> None:
        self.draw = draw
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.asked: Counter[str] = Counter()
        self.answered = 0
        self.wrong: list[str] = []  # what the optimizer sent and should not
        self._batches: dict[int, int] = {}  # trials
        self._queries: queue.Queue[zenoh.Query | None] = queue.Queue()
        self._shown: list[list[Any]] = []
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=target, daemon=True)
            for target in (self._work, self._work, self._renew)
        ]

    def __enter__(self) -> Self:
        reach = session.Reach((), multicast=False)
        self.session, _ = session.open_server([self.endpoint], reach)
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        for _ in self._threads:
            self._queries.put(None)
        for thread in self._threads:
            thread.join(30.0)
        session.close(self.session)

    def _renew(self) -> None:
        """Show new servers, and let the oldest vanish."""
        while not self._stop.wait(RENEWED_S):
            name = keys.new_server_id(f"fake{self.draw.randrange(10**6)}")
            on_query = zenoh.handlers.Callback(self._queries.put, indirect=False)
            declare = self.session.declare_queryable
            self._shown.append(
                [
                    declare(keys.offer("default", name), on_query),
                    declare(keys.requests("default", name), on_query),
                    self.session.liveliness().declare_token(keys.alive("default", name)),
                ]
            )
            if len(self._shown) > SHOWN:
                for declared in self._shown.pop(0):
                    declared.undeclare()

    def _work(self) -> None:
        while (query := self._queries.get()) is not None:
            key = str(query.key_expr)
            body = query.payload.to_bytes() if query.payload is not None else b""
            try:
                parts, message = codec.decode_query(key, body)
            except RemoteProtocolError as error:
                self.wrong.append(f"{key}: {error}")
                query.drop()
                continue
            self.asked[parts.verb] += 1
            if parts.verb == "evaluate" and self.draw.random() < 0.3:
                self._ask(parts, message)
            reply = self._reply(parts.server, message)
            wild = self.draw.random() < (
                0.1 if parts.verb in ("offer", "reserve") else 0.3
            )
            try:
                query.reply(
                    key, mutated(reply, self.draw) if wild else codec.encode(reply)
                )
            except zenoh.ZError:  # the optimizer ended
                pass
            finally:
                query.drop()
            self.answered += 1

    def _ask(self, parts: ServerKey, message: Any) -> None:
        """Ask the run's controllers, which it has only if they are to stay with it."""
        sensors = messages.Sensors(
            lease=message.lease,
            batch=message.batch,
            trial=0,
            play=secrets.token_bytes(16),
            number=0,
            agents=bytes(4),
            participants=bytes(4),
            observations=np.ones(self.draw.choice([2, 2, 3]), "<f4").tobytes(),
        )
        key = keys.control("default", parts.user, parts.run, parts.server)
        body = (
            codec.encode(sensors)
            if self.draw.random() < 0.3
            else mutated(sensors, self.draw)
        )
        session.ask(self.session, key, body, self._reacted, timeout_s=2.0)

    def _reacted(self, answer: bytes | None, _replier: str) -> None:
        if answer is None:
            return
        try:
            self.asked[type(codec.decode_reaction(answer)).__name__] += 1
        except RemoteProtocolError as error:
            self.wrong.append(f"control: {error}")

    def _reply(self, server: str, message: messages.Request) -> messages.Reply:
        draw = self.draw
        if draw.random() < 0.03:
            return messages.Refused(code=draw.choice(CODES), reason="no")
        match message:
            case messages.Requirements():
                return messages.Offer(
                    server=server,
                    program="0.1.0",
                    machine="Linux x86_64",
                    capacity=4,
                    free=4,
                    leases=0,
                    simulators=["xor"],
                    representations=["fully-meshed"],
                    labels={"cores": "4"},
                    features=messages.FEATURES,
                )
            case messages.Reserve() | messages.Renew():
                ready = draw.choice([0, 4, 4, 4])
                return messages.Lease(
                    lease=b"L" * 16,
                    state="ready" if ready else "preparing",
                    slots=4,
                    ready=ready,
                    trial_s=0.001,
                )
            case messages.Evaluate():
                return self._evaluated(message)
        return messages.Done()

    def _evaluated(self, message: messages.Evaluate) -> messages.Reply:
        draw, batch = self.draw, message.batch
        if message.seeds:
            self._batches[batch] = len(message.seeds) // 8
        count = self._batches.get(batch, 1)
        some = draw.randrange(count + 1)
        fields: dict[str, Any] = {
            "batch": batch,
            "trials": codec.indices(range(some)),
            "fitness": np.full(some, draw.random()).tobytes(),
            "metrics": np.ones(some * METRICS).tobytes(),
            "seconds": 0.001 * some,
        }
        match draw.randrange(10):
            case 0:
                return messages.Running(done=some, given=draw.random() < 0.5, **fields)
            case 1:
                trial = draw.randrange(count)
                return messages.Fault(
                    kind="crashed", trial=trial, reason="it ended", **fields
                )
        fields |= {
            "trials": b"",
            "fitness": np.full(count, draw.random()).tobytes(),
            "metrics": np.ones(count * METRICS).tobytes(),
            "seconds": 0.001 * count,
        }
        return messages.Outcomes(**fields)
