"""Talk to a server as anybody can who reaches its port, without keys."""

import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psutil

from tests.integration.programs import Server, wait_until
from zswarm import session
from zswarm.plugins.version_hash import version_hash
from zswarm.protocol import codec, keys, messages

LONGEST_S = 60.0  # for an answer, on a machine that computes much else
VERSION_HASH = version_hash("xor", "fully-meshed")


class Peer:
    """A user who has a session with a server; ``with`` closes it."""

    def __init__(self, server: Server, user: str) -> None:
        self.server, self.user = str(server.events("server_ready")[0]["server"]), user
        reach = session.Reach([server.endpoint], multicast=False)
        self.session = session.open_optimizer(reach)
        wait_until(lambda: self.ask(messages.Requirements()), "the server answers")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        session.close(self.session)

    def send(
        self, verb: str, body: bytes, run: str = "run-1", timeout_s: float = LONGEST_S
    ) -> list[bytes | None]:
        """Send bytes; return a list that gets the answer, or None, when the query ends."""
        ended: list[bytes | None] = []
        key = keys.request("default", self.server, self.user, run, verb)
        self.ask_key(key, body, ended.append, timeout_s)
        return ended

    def ask_key(
        self,
        key: str,
        body: bytes,
        answered: Callable[[bytes | None], None],
        timeout_s: float = 5.0,
    ) -> None:
        """Send bytes to any key; ``answered`` is called once."""
        session.ask(
            self.session,
            key,
            body,
            lambda answer, _: answered(answer),
            timeout_s=timeout_s,
        )

    def ask(
        self, message: messages.Request, run: str = "run-1", timeout_s: float = LONGEST_S
    ) -> messages.Reply | None:
        """Return the answer to a message, or None."""
        verb = messages.verb(message)
        ended = self.send(verb, codec.encode(message), run, timeout_s)
        (answer,) = wait_until(lambda: ended, "the query ends", 2 * timeout_s)
        return codec.decode_reply(answer) if answer is not None else None

    def offer_s(self) -> float:
        """Return the seconds until the server answers a small question."""
        begun = time.monotonic()
        assert isinstance(self.ask(messages.Requirements()), messages.Offer)
        return time.monotonic() - begun


def reserve(**changes: Any) -> messages.Reserve:
    """Return a request for a slot; the problem is xor."""
    fields: dict[str, Any] = {
        "nonce": secrets.token_bytes(16),
        "epoch": 0,
        "slots": 1,
        "simulator": messages.Part("xor", {}),
        "representation": messages.Part("fully-meshed", {}),
        "version_hash": VERSION_HASH,
        "trial_timeout_s": 60.0,
    }
    return messages.Reserve(**(fields | changes))


def cpu_s(server: Server) -> float:
    """Return the processor time of a server's own process; it does not depend on the load."""
    times = psutil.Process(server.process.pid).cpu_times()
    return float(times.user + times.system)


def memory_mb(pid: int) -> float:
    """Return the memory that a process has to itself."""
    return float(psutil.Process(pid).memory_full_info().uss) / 2**20


@contextmanager
def serving(folder: Path, *options: str, capacity: int = 1) -> Iterator[Server]:
    """Run a server without keys, whose simulators are not compiled."""
    server = Server(
        folder, "lab-01", capacity=capacity, options=options, ZSWARM_PLAIN="1"
    )
    try:
        yield server.ready()
    finally:
        server.close()
