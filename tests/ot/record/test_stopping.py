"""``[stop]``: a run ends before its last generation, and goes on when the limit is raised."""

import re
import threading
from pathlib import Path

import msgspec
import pytest

from tests.ot.cluster.fake_connection import result
from tests.ot.test_evolving import Genes, created, loaded
from zswarm import experiment
from zswarm.config.sections import StopConfig
from zswarm.errors import ConfigError
from zswarm.ot import run
from zswarm.ot.build import build
from zswarm.ot.logger import Logger, Result
from zswarm.ot.record.folder import EXPERIMENT, load_experiment
from zswarm.ot.record.reader import Run
from zswarm.ot.record.results import finished_result
from zswarm.ot.record.stopping import Spent, StopWatch
from zswarm.ot.record.writer import Record


@pytest.mark.parametrize(
    ("limits", "found", "ends"),
    [
        (
            {"evaluations": 50},
            [Spent(1.0, 20, 80, 1.0)] * 2,
            True,
        ),  # 20 more are too many
        ({"evaluations": 60}, [Spent(1.0, 20, 80, 1.0)] * 2, False),
        ({"simulations": 239}, [Spent(1.0, 20, 80, 1.0)] * 2, True),
        ({"simulations": 240}, [Spent(1.0, 20, 80, 1.0)] * 2, False),
        ({"fitness": 0.5}, [Spent(1.9, 1, 4, 1.0)], False),  # 0.475 a trial
        ({"fitness": 0.5}, [Spent(2.0, 1, 4, 1.0), Spent(0.0, 1, 4, 1.0)], True),
        ({"stagnation": 2}, [Spent(best, 1, 1, 0.0) for best in (1.0, 2.0, 2.0)], False),
        ({"stagnation": 2}, [Spent(best, 1, 1, 0.0) for best in (2.0, None, 2.0)], True),
        ({"seconds": 2.0}, [Spent(None, 1, 1, 0.9)] * 2, False),
        ({"seconds": 2.0}, [Spent(None, 1, 1, 1.0)] * 2, True),
        ({}, [Spent(9.0, 10**9, 10**9, 1e9)], False),
    ],
)
def test_each_limit_ends_a_run(
    limits: dict[str, float], found: list[Spent], ends: bool
) -> None:
    stop = msgspec.convert(limits, StopConfig)
    assert bool(StopWatch(stop, 4, found).reason()) is ends
    watch = StopWatch(stop, 4, ())
    assert not watch.reason()
    for spent in found:
        watch.take(spent)
    assert bool(watch.reason()) is ends


def played(record: Record, complete: object) -> Result:
    with record:
        parts = build(complete)  # type: ignore[arg-type]
        begun = run.evolve(parts, record, Genes(), Logger(), threading.Event())  # type: ignore[arg-type]
        return result(begun)


def test_a_budget_ends_a_run_which_goes_on_with_a_larger_one(tmp_path: Path) -> None:
    """The run with the budget raised has the history of one that had it from the start."""
    complete = loaded("generations=100", "stop.evaluations=30")
    record = created(tmp_path / "small", complete)
    found = played(record, complete)
    assert (found.generations, found.evaluations) == (3, 24)
    folder = record.folder
    assert Run(folder).finished
    again = finished_result(folder, load_experiment(folder))
    assert again is not None
    assert (again.generations, again.history_hash) == (3, found.history_hash)

    file = folder / EXPERIMENT
    text = file.read_text()
    assert text.count("evaluations = 30") == 1
    file.write_text(re.sub("evaluations = 30", "evaluations = 50", text))
    assert finished_result(folder, load_experiment(folder)) is None
    record, larger = Record.open(folder)
    longer = played(record, larger)
    assert longer.evaluations == 45

    whole = loaded("generations=100", "stop.evaluations=50")
    fresh = played(created(tmp_path / "large", whole), whole)
    assert (longer.generations, longer.history_hash) == (
        fresh.generations,
        fresh.history_hash,
    )


def test_a_run_that_was_killed_at_its_end_does_not_go_on(tmp_path: Path) -> None:
    """It is closed before its champion is assessed, and only that is left to do."""
    complete = loaded("generations=100", "stop.evaluations=30")
    record = created(tmp_path, complete)
    with record:
        begun = run.evolve(build(complete), record, Genes(), Logger(), threading.Event())  # type: ignore[arg-type]
        for _ in range(3):
            next(begun)
        begun.close()
    record, complete = Record.open(record.folder)
    assert played(record, complete).generations == 3


def test_scores_have_no_target(tmp_path: Path) -> None:
    text = experiment.find("minisim-duel").read_text() + "[stop]\nstagnation = 3\n"
    duel = tmp_path / "duel.toml"
    duel.write_text(text)
    whole = experiment.complete(experiment.load(duel), "duel.toml")
    with pytest.raises(
        ConfigError, match="stop: fitness and stagnation need fitness that"
    ):
        build(whole)
