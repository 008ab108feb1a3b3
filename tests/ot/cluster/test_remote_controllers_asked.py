"""What is asked of a run through its folder is done between two generations, or at once."""

import threading
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.ot.cluster.fake_connection import FakeConnection
from zswarm.errors import Stopped
from zswarm.ot.evolution import Evolution, Requests
from zswarm.ot.logger import Generation, Logger, Result
from zswarm.ot.record import control_file as control

RESULT = Result("run", 3, 1.0, 3, 0, "0" * 32, 0.0, 0, 0)


class Follower(Logger):
    """Do something when the run says that it pauses."""

    def __init__(self, folder: Path, word: control.Word | None = None) -> None:
        self.folder, self.word, self.said = folder, word, list[str]()
        self.ended: list[Result | None] = []

    def on_say(self, line: str) -> None:
        self.said.append(line)
        if self.word is None:
            control.forget(self.folder)
        else:
            control.ask(self.folder, self.word)

    def on_end(self, result: Result | None) -> None:
        self.ended.append(result)


def evolution(folder: Path, logger: Logger, closed: list[int]) -> Evolution:
    """Return an evolution of three generations."""

    def evolve(stop: threading.Event) -> Generator[Generation, None, Result]:
        try:
            for number in range(3):
                if stop.is_set():
                    raise Stopped("stopped")
                yield Generation(number, 1.0, 0.5, number + 1, 1, 1, {})
                Requests(folder, logger, stop).obey(FakeConnection())  # type: ignore[arg-type]
        finally:
            closed.append(1)
        return RESULT

    return Evolution(folder, evolve, logger)


def test_a_run_without_requests_runs_to_its_end(tmp_path: Path) -> None:
    logger, closed = Follower(tmp_path), list[int]()
    begun = evolution(tmp_path, logger, closed)
    assert [generation.generation for generation in begun] == [0, 1, 2]
    assert (begun.result, logger.ended, logger.said, closed) == (
        RESULT,
        [RESULT],
        [],
        [1],
    )


def test_a_run_stops_after_its_generation(tmp_path: Path) -> None:
    """Everything that it began is closed, and loggers learn that there is no result."""
    logger, closed = Follower(tmp_path), list[int]()
    control.ask(tmp_path, "drain")
    generations = iter(evolution(tmp_path, logger, closed))
    assert next(generations).generation == 0
    with pytest.raises(Stopped, match="stopped after a generation, as requested"):
        next(generations)
    assert (logger.ended, closed) == ([None], [1])


def test_a_paused_run_continues_when_the_request_is_withdrawn(tmp_path: Path) -> None:
    logger = Follower(tmp_path)
    control.ask(tmp_path, "pause")
    assert [generation.generation for generation in evolution(tmp_path, logger, [])] == [
        0,
        1,
        2,
    ]
    assert logger.said == ["paused, as requested; continue it in the dashboard"]


@pytest.mark.parametrize("word", ["stop", "drain"])
def test_a_run_that_pauses_can_be_stopped(tmp_path: Path, word: control.Word) -> None:
    logger, closed = Follower(tmp_path, word), list[int]()
    control.ask(tmp_path, "pause")
    generations = iter(evolution(tmp_path, logger, closed))
    next(generations)
    with pytest.raises(Stopped):
        next(generations)
    assert closed == [1]


def test_a_run_abandoned_between_generations_is_closed(tmp_path: Path) -> None:
    logger, closed = Follower(tmp_path), list[int]()
    begun = evolution(tmp_path, logger, closed)
    assert next(iter(begun)).generation == 0
    begun.close()
    assert (logger.ended, closed) == ([None], [1])
