"""zswarm's two designs: real runs on real ``zswarm-ss`` daemons.

A candidate travels as its parameters, and a generic controller at the server reads them: what the
paper proposes in section VI. Or the controllers stay in the optimizer, as in the paper's
network-based design, and servers ask it in each turn.
"""

import contextlib
import json
import tempfile
import time
from pathlib import Path
from typing import Self

import by_mqtt
import leased

from paper import world
from paper.world import Optimized, Size, World
from zswarm.ot import evolution
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.logger import Logger
from zswarm.ot.notes import Note

WAYS: dict[str, tuple[str, ...]] = {  # what [cluster] says
    "blob": (),
    "turn": ("cluster.controller=optimizer", "cluster.messages=turn"),
    "agent": ("cluster.controller=optimizer", "cluster.messages=agent"),
}
START_S = 120.0


class Joined(Logger):
    """Record when the first server was ready; servers behind the broker connect before."""

    at = 0.0

    def on_event(self, event: Note) -> None:
        """Note the first server that is ready."""
        if event.event == "server_joined" and not self.at:
            self.at = time.perf_counter()


class Servers(contextlib.AbstractContextManager["Servers"]):
    """Daemons of one slot on this machine; none at first."""

    def __init__(self) -> None:
        self._endpoints: list[str] = []
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def grow(self, servers: int) -> None:
        """Start daemons until there are enough."""
        before = len(self._endpoints)
        for number in range(before, servers):
            port = leased.free_port()
            self._endpoints.append(f"tcp/127.0.0.1:{port}")
            self._stack.enter_context(
                leased.daemon(1, self._endpoints[-1], "--name", f"s{number}")
            )
        for endpoint in self._endpoints[before:]:
            by_mqtt.wait_for_port(int(endpoint.rpartition(":")[2]), START_S)

    def optimize(
        self, size: Size, on: World, servers: int, way: str = "blob"
    ) -> Optimized:
        """Run on the first of them."""
        where = [
            f"cluster.servers={servers}",
            f"cluster.connect={json.dumps(self._endpoints[:servers])}",
            "cluster.multicast=false",
        ]
        loaded = world.load(on, size, *where, *WAYS[way])
        with tempfile.TemporaryDirectory() as folder:
            joined = Joined()
            with (
                Connection(loaded.cluster) as connection,
                evolution.start(
                    loaded, "paper", Path(folder), connection, joined
                ) as begun,
            ):
                result = begun.finish()
            seconds = time.perf_counter() - joined.at
        return Optimized(seconds, result.evaluations * size.trials, result.history_hash)
