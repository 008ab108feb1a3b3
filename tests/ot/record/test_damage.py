"""A damaged record gives the right answer or a clear error: never another hash."""

import contextlib
import os
import shutil
import sqlite3
import threading
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from tests.ot.cluster.fake_connection import FakeConnection, result
from tests.ot.record.damages import copied, damage
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot import run
from zswarm.ot.build import build
from zswarm.ot.cluster.events import Counted
from zswarm.ot.logger import Logger
from zswarm.ot.record.folder import load_experiment
from zswarm.ot.record.reader import Run
from zswarm.ot.record.results import finished_result
from zswarm.ot.record.rollback import go_back
from zswarm.ot.record.writer import Record

GENERATIONS = 4
SEED = int(os.environ.get("SEED", "1"))


class Genes(FakeConnection):
    """A candidate's fitness is its first gene plus a number from the trial's seed."""

    def play(self, workload: Any) -> Iterator[Counted]:
        genes = np.array([np.frombuffer(genome, "<f4")[0] for genome in workload.genomes])
        for trials in np.array_split(np.flatnonzero(~workload.counted), 4):
            if not len(trials):
                continue
            noise = (workload.seeds[trials] % 7 / 7)[:, None]
            workload.fitness[trials] = genes[workload.participants[trials]] + noise
            workload.metrics[trials] = workload.fitness[trials]
            workload.counted[trials] = True
            yield Counted(trials, "lab-1-0123abcd", 0.01)


class Runs:
    """A finished run, and one that was killed in its third generation, with its log."""

    def __init__(self, parent: Path) -> None:
        overrides = [f"generations={GENERATIONS}", "optimizer.population=6"]
        loaded = experiment.load(
            experiment.find("stadium"), [*overrides, "representation.hidden=1"]
        )
        self.complete = experiment.complete(loaded, "test")
        parts = build(self.complete)
        metrics = parts.problem.simulator.metrics
        with Record.create(parent, self.complete, "0" * 32, metrics) as record:
            self.history = result(
                run.evolve(parts, record, Genes(), Logger(), threading.Event())  # type: ignore[arg-type]
            ).history_hash
            self.finished = record.folder
        with Record.create(parent, self.complete, "0" * 32, metrics) as record:
            parts = build(self.complete)
            evolution = run.evolve(parts, record, Genes(), Logger(), threading.Event())  # type: ignore[arg-type]
            for _ in islice(evolution, 2):
                pass
            work = run.Assessment(parts.problem, parts.optimizer._asked, 2).workload
            record.begin(2, work)
            for counted in islice(Genes().play(work), 2):
                record.add(counted, work)
            record.sync()
            self.killed = Path(shutil.copytree(record.folder, parent / "killed"))
            record._database._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            self.stopped = Path(shutil.copytree(record.folder, parent / "stopped"))
            evolution.close()
        self.contents = contents(self.finished)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    return Runs(tmp_path_factory.mktemp("damage"))


def contents(folder: Path) -> list[Any]:
    """Return what is read of a run for its results."""
    read = Run(folder)
    numbers = range(read.generations())
    return [
        read.history_hash,
        read.history(),
        read.best(),
        [read.candidates(number) for number in numbers],
        [read.trials(number) for number in numbers],
    ]


def read(folder: Path) -> list[Any] | str:
    """Return the contents of a run, or why it cannot be read."""
    try:
        return contents(folder)
    except ConfigError as error:
        return str(error)


def resumed(folder: Path) -> str:
    """Resume a run, and return its history hash."""
    record, complete = Record.open(folder)
    with record:
        return result(
            run.evolve(build(complete), record, Genes(), Logger(), threading.Event())  # type: ignore[arg-type]
        ).history_hash


def check(runs: Runs, folder: Path, how: str) -> str:
    """Resume a damaged run; return ``right``, or why it was refused."""
    try:
        found = resumed(folder)
    except ConfigError as error:
        return str(error)
    assert found == runs.history, f"{how}: another history"
    return "right"


def try_damages(runs: Runs, to: Path, count: int, seed: int) -> dict[str, int]:
    """Damage runs; return how often a resume was right, was refused, or went back."""
    random = Random(seed)
    counts = {"right": 0, "refused": 0, "back": 0}
    for number in range(count):
        source = random.choice((runs.finished, runs.stopped, runs.killed))
        folder = copied(source, to / "run")
        how = f"damage {number} of seed {seed}: {source.name}, {damage(folder, random)}"
        if source is runs.finished:
            found = read(folder)
            right = isinstance(found, str) or found == runs.contents or not found[0]
            assert right, f"{how}: other results"
        said = check(runs, folder, how)
        assert said.isprintable(), how
        if said == "right":
            counts["right"] += 1
        elif "--from " in said:
            counts[back(runs, folder, said, how)] += 1
        else:
            counts["refused"] += 1
    return counts


def back(runs: Runs, folder: Path, said: str, how: str) -> str:
    """Go back as a refusal says; return ``back``, or ``refused`` if too much is damaged."""
    try:
        go_back(folder, int(said.partition("--from ")[2].split()[0]) - 1)
    except ConfigError:
        return "refused"
    assert check(runs, folder, f"{how}, gone back") == "right", how
    return "back"


def test_a_damaged_record_gives_the_right_history_or_a_clear_error(
    runs: Runs, tmp_path: Path
) -> None:
    counts = try_damages(runs, tmp_path, 60, SEED)
    assert min(counts.values()) > 0, counts


@pytest.mark.parametrize(
    ("number", "count"),
    [
        pytest.param(0, 200, marks=pytest.mark.long),
        *(
            pytest.param(number, 500, marks=pytest.mark.thorough)
            for number in range(1, 5)
        ),
    ],
)
def test_many_damages_give_the_right_history_or_a_clear_error(
    runs: Runs, tmp_path: Path, number: int, count: int
) -> None:
    try_damages(runs, tmp_path, count, SEED + 1000 + number)


@pytest.mark.parametrize("generations", [0, 2, GENERATIONS])
def test_a_run_that_goes_back_ends_with_the_same_history(
    runs: Runs, tmp_path: Path, generations: int
) -> None:
    """The former record is kept; the optimizer's state is made again from the candidates."""
    folder = copied(runs.finished, tmp_path / "run")
    former = (folder / "run.sqlite").read_bytes()
    aside = go_back(folder, generations).path
    assert aside.read_bytes() == former
    assert Run(folder).generations() == generations
    assert not Run(folder).finished
    assert resumed(folder) == runs.history
    assert contents(folder)[0] == runs.history


def test_a_damaged_key_of_another_type_is_damage(runs: Runs, tmp_path: Path) -> None:
    folder = copied(runs.finished, tmp_path / "run")
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as database, database:
        database.execute("UPDATE meta SET key = x'6500' WHERE key = 'epoch'")
    with pytest.raises(ConfigError, match="damaged: table meta: not what was written: "):
        Run(folder)


def test_a_difference_names_the_generation_and_the_way_back(
    runs: Runs, tmp_path: Path
) -> None:
    folder = copied(runs.finished, tmp_path / "run")
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as database, database:
        database.execute(
            "UPDATE candidates SET fitness = fitness + 1 WHERE (generation, candidate) = (2, 1)"
        )
    line = (
        f"{folder}/run.sqlite: damaged: generation 3: its candidates, their fitness or measures "
        f"are not what was written; zswarm-ot resume {folder} --from 3 evaluates again from there"
    )
    for read in (lambda: Run(folder).candidates(2), lambda: resumed(folder)):
        with pytest.raises(ConfigError) as caught:
            read()
        assert str(caught.value) == line
    with pytest.raises(ConfigError, match="damaged: generation 3: "):
        finished_result(folder, load_experiment(folder))
