"""What stands for servers and connection where a run's loop is tested: trials have outcomes at once, in this program."""

from collections.abc import Generator, Iterator
from typing import Any

from zswarm.experiment import Cluster
from zswarm.ot.dispatch import Counted, Retracted
from zswarm.ot.logger import Generation, Result
from zswarm.ot.workload import Workload


class Servers:
    """Takes the place of ``run.Evaluations``; a child says what the outcomes are."""

    servers, slots, probe = 1, 2, b"digest"
    options = Cluster()

    def __init__(self) -> None:
        self.asked: dict[str, Any] = {}
        self.handed: list[Workload] = []  # in their order

    def __call__(self, *_args: object, **asked: Any) -> "Servers":
        self.asked = asked
        return self

    def __enter__(self) -> "Servers":
        return self

    def __exit__(self, *_error: object) -> None:
        pass

    def who_computes(self) -> str:
        return "nobody"

    def wait(self) -> Iterator[None]:
        return iter(())

    rest = wait

    def evaluate(self, workload: Workload) -> Iterator[Counted | Retracted]:
        self.handed.append(workload)
        return self.play(workload)

    def play(self, workload: Workload) -> Iterator[Counted | Retracted]:
        """Fill in the outcomes of the trials that have none."""
        raise NotImplementedError


def result(evolution: Generator[Generation, None, Result]) -> Result:
    """Of a run that is left to go to its end."""
    while True:
        try:
            next(evolution)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
