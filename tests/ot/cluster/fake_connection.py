"""Fake a connection without servers, to test a run's loop: this program fills in the outcomes."""

import contextlib
from collections.abc import Generator, Iterator
from typing import Any

from zswarm.config.sections import ClusterConfig
from zswarm.ot.cluster.events import Counted, Retracted
from zswarm.ot.cluster.remote_server import Standing
from zswarm.ot.logger import Generation, Result
from zswarm.ot.workload import Workload


class FakeConnection:
    """Connection and cluster in one; a subclass decides the outcomes."""

    standing = Standing(serving=1, slots=2, probe=b"digest")
    options = ClusterConfig()

    def __init__(self) -> None:
        self.asked: dict[str, Any] = {}
        self.handed: list[Workload] = []  # in their order
        self.pauses: list[bool] = []  # begun and ended

    @contextlib.contextmanager
    def cluster(self, *_args: object, **asked: Any) -> "Iterator[FakeConnection]":
        self.asked = asked
        yield self

    def who_computes(self) -> str:
        return "nobody"

    def wait(self, *_cluster: object) -> Iterator[None]:
        return iter(())

    rest = wait

    def pause(self, *, paused: bool) -> None:
        self.pauses.append(paused)

    def evaluate(self, workload: Workload) -> Iterator[Counted | Retracted]:
        self.handed.append(workload)
        return self.play(workload)

    def play(self, workload: Workload) -> Iterator[Counted | Retracted]:
        """Fill in the outcomes of the trials that have none."""
        raise NotImplementedError


def result(evolution: Generator[Generation, None, Result]) -> Result:
    """Play a run to its end and return the result."""
    while True:
        try:
            next(evolution)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
