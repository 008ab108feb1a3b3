"""Users' loggers get all calls in order; neither their errors nor their slowness stop the run."""

import threading
from pathlib import Path
from typing import Any

import pytest

from zswarm import experiment
from zswarm.champion.controller import Controller
from zswarm.ot import logger as loggers
from zswarm.ot.logger import Generation, InBackground, Logger, Loggers, Result, Started
from zswarm.ot.notes import Note

STARTED = Started(Path("runs/x"), experiment.load(experiment.find("stadium")), 0)
RESULT = Result("runs/x", 3, 1.0, 150, 0, "00", 0.1, 0, 0)
NOTE = Note("server_joined", "lab-1", count=2)
CHAMPION = Controller(
    simulator="s",
    simulator_settings={},
    representation="r",
    representation_settings={},
    inputs=1,
    outputs=1,
    sensors=[],
    actuators=[],
    genome=b"",
    fitness=1.0,
    run="x",
)


def generation(number: int) -> Generation:
    return Generation(number, 1.0, 0.5, 50, 1, 2, {"best": 1.0, "mean": 0.5})


class Hearing(Logger):
    """Record every call, and the thread it came in."""

    def __init__(self) -> None:
        self.heard: list[tuple[str, Any]] = []
        self.threads: set[int] = set()

    def _hear(self, what: str, *given: Any) -> None:
        self.heard.append((what, given[0] if len(given) == 1 else given))
        self.threads.add(threading.get_ident())

    def on_start(self, run: Started) -> None:
        self._hear("start", run)

    def on_say(self, line: str) -> None:
        self._hear("say", line)

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        self._hear("progress", generation, counted, trials)

    def on_generation(self, generation: Generation) -> None:
        self._hear("generation", generation)

    def on_champion(self, champion: Controller) -> None:
        self._hear("champion", champion)

    def on_event(self, event: Note) -> None:
        self._hear("event", event)

    def on_end(self, result: Result | None) -> None:
        self._hear("end", result)


def tell(logger: Logger, generations: int = 3) -> None:
    """Make all the calls of a whole run."""
    logger.on_start(STARTED)
    logger.on_say("hello")
    logger.on_event(NOTE)
    for number in range(generations):
        logger.on_progress(number, 50, 50)
        logger.on_generation(generation(number))
        logger.on_champion(CHAMPION)
    logger.on_end(RESULT)


def without_progress(heard: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
    return [call for call in heard if call[0] != "progress"]


ALL = [
    ("start", STARTED),
    ("say", "hello"),
    ("event", NOTE),
    *(
        call
        for number in range(3)
        for call in (("generation", generation(number)), ("champion", CHAMPION))
    ),
    ("end", RESULT),
]


def test_a_logger_that_overrides_nothing_follows_a_run() -> None:
    """The others hear all, and nothing is said about it."""
    hearing, said = Hearing(), list[str]()
    tell(Loggers([InBackground(Logger(), said.append), hearing]))
    assert said == []
    assert without_progress(hearing.heard) == ALL


def test_every_logger_receives_every_call() -> None:
    first, second = Hearing(), Hearing()
    tell(Loggers([first, second]))
    assert first.heard == second.heard
    assert without_progress(first.heard) == ALL
    assert ("progress", (2, 50, 50)) in first.heard


def test_a_background_logger_receives_all_calls_in_order_in_one_thread() -> None:
    """When ``on_end`` returns, it heard it."""
    hearing, said = Hearing(), list[str]()
    tell(InBackground(hearing, said.append))
    assert without_progress(hearing.heard) == ALL
    assert len(hearing.threads) == 1
    assert threading.get_ident() not in hearing.threads
    assert said == []


@pytest.mark.parametrize(
    "error",
    [ZeroDivisionError("no disk"), SystemExit("no disk")],
    ids=["an error", "an exit"],
)
def test_an_error_of_a_logger_is_reported_once_and_it_gets_later_events(
    error: BaseException,
) -> None:
    class Raising(Hearing):
        def on_generation(self, generation: Generation) -> None:
            super().on_generation(generation)
            raise error

    raising, said = Raising(), list[str]()
    tell(InBackground(raising, said.append))
    assert said == [f"logger Raising: {type(error).__name__}: no disk; the run continues"]
    assert without_progress(raising.heard) == ALL


def test_a_slow_logger_delays_nothing_and_receives_the_number_of_missed_calls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A limited number of calls wait for it; progress is omitted while it is behind."""
    monkeypatch.setattr(loggers, "WAITING", 10)
    slow, said = threading.Event(), list[str]()

    class Slow(Hearing):
        def on_start(self, run: Started) -> None:
            super().on_start(run)
            slow.wait(30.0)

    hearing = Slow()
    background = InBackground(hearing, said.append)
    background.on_start(STARTED)
    for number in range(30):
        background.on_progress(number, 1, 50)
        background.on_generation(generation(number))
    assert [what for what, _ in hearing.heard] in ([], ["start"])
    slow.set()
    background.on_end(RESULT)
    heard = [given.generation for what, given in hearing.heard if what == "generation"]
    assert heard == list(range(len(heard)))
    assert 9 <= len(heard) <= 10
    assert sum(what == "progress" for what, _ in hearing.heard) <= 1
    assert hearing.heard[-1] == ("end", RESULT)
    assert len(said) == 1
    assert said[0].startswith("logger Slow was too slow: 2")


def test_a_hanging_logger_is_abandoned_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its queue may have room or not; if it continues, it gets the last call and ends."""
    monkeypatch.setattr(loggers, "LAST_CALLS_S", 0.05)
    for waiting in (2, 100):
        monkeypatch.setattr(loggers, "WAITING", waiting)
        go_on, said = threading.Event(), list[str]()

        class Hanging(Hearing):
            def on_start(self, run: Started) -> None:  # noqa: ARG002
                go_on.wait(30.0)  # noqa: B023  of this round

        hanging = Hanging()
        background = InBackground(hanging, said.append)
        tell(background)
        assert said == ["logger Hanging hangs and was abandoned"]
        go_on.set()
        background._thread.join(30.0)
        assert not background._thread.is_alive()
        assert hanging.heard[-1] == ("end", RESULT)


def test_a_run_that_did_not_begin_ends_without_a_logger_call() -> None:
    hearing = Hearing()
    InBackground(hearing, print).on_end(None)
    assert hearing.heard == []
