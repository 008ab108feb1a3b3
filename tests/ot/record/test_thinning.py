"""What ``[record] genomes`` keeps, and that nothing else depends on it."""

import threading
from itertools import islice
from pathlib import Path

import pytest

from tests.ot.cluster.fake_connection import result
from tests.ot.record.test_damage import Genes, resumed
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot import run
from zswarm.ot.build import build
from zswarm.ot.logger import Logger
from zswarm.ot.record.reader import Run
from zswarm.ot.record.rollback import go_back
from zswarm.ot.record.selection import controller
from zswarm.ot.record.writer import Record

GENERATIONS = 5
LONG = 40  # hidden neurons of a genome that the optimizer's state refers to, not repeats


def loaded(genomes: str, hidden: int = 1) -> experiment.Experiment:
    overrides = [f"generations={GENERATIONS}", "optimizer.population=8"]
    more = [f"representation.hidden={hidden}", f"record.genomes={genomes}"]
    more.append("assessment.candidates=3")
    found = experiment.load(experiment.find("stadium"), [*overrides, *more])
    return experiment.complete(found, "test")


def evolved(
    out: Path, genomes: str, generations: int = GENERATIONS, hidden: int = 1
) -> Path:
    """Evolve some generations, and return the folder."""
    complete = loaded(genomes, hidden)
    parts = build(complete)
    metrics = parts.problem.simulator.metrics
    with Record.create(out, complete, "0" * 32, metrics) as record:
        evolution = run.evolve(parts, record, Genes(), Logger(), threading.Event())  # type: ignore[arg-type]
        if generations == GENERATIONS:
            result(evolution)
        for _ in islice(evolution, generations):
            pass
        evolution.close()
    return record.folder


def kept(folder: Path) -> list[set[int]]:
    """Return the candidates of each generation whose genomes are there."""
    found = Run(folder)
    return [
        {
            row["candidate"]
            for row in found.candidates(number)
            if row["genome"] is not None
        }
        for number in range(found.generations())
    ]


@pytest.mark.parametrize(
    ("genomes", "whole", "hidden"),
    [("best", set(), 1), ("best", set(), LONG), ("2", {0, 2, 4}, 1)],
)
def test_only_some_genomes_are_kept_and_the_history_is_the_same(
    tmp_path: Path, genomes: str, whole: set[int], hidden: int
) -> None:
    everything = evolved(tmp_path / "all", "all", hidden=hidden)
    folder = evolved(tmp_path / "some", genomes, hidden=hidden)
    assert Run(folder).history_hash == Run(everything).history_hash
    assert [row["best"] for row in Run(folder).history()] == [
        row["best"] for row in Run(everything).history()
    ]
    record = Record.open(folder)[0]
    with record:
        record.resumed()
        needed = set(record._known.values()) | record._raced.places()
        assert len(record._raced.places()) == 3
        of_the_state = {generation for generation, _ in record._known.values()}
        assert of_the_state <= whole if hidden == 1 else of_the_state
    for number, there in enumerate(kept(folder)):
        rows = Run(everything).candidates(number)
        best = max(rows, key=lambda row: (row["fitness"], -row["candidate"]))["candidate"]
        expected = {best} | {at for generation, at in needed if generation == number}
        assert there == (kept(everything)[number] if number in whole else expected)
        assert Run(folder).trials(number) == Run(everything).trials(number)
    assert len(kept(folder)[1]) < len(kept(everything)[1])


@pytest.mark.parametrize("hidden", [1, LONG])
def test_a_thinned_run_resumes_and_goes_back_to_the_same_history(
    tmp_path: Path, hidden: int
) -> None:
    history = Run(evolved(tmp_path / "all", "all", hidden=hidden)).history_hash
    folder = evolved(tmp_path / "stopped", "best", 3, hidden)
    assert resumed(folder) == history
    go_back(folder, 2)
    assert resumed(folder) == history


def test_a_genome_that_was_not_kept_is_named_with_those_that_were(tmp_path: Path) -> None:
    folder = evolved(tmp_path, "best")
    there = kept(folder)[1]
    missing = next(at for at in range(8) if at not in there)
    assert controller(folder, 1).genome
    words = rf"genome of candidate {missing} in generation 2 was not kept \(\[record\] genomes\)"
    with pytest.raises(ConfigError, match=words):
        controller(folder, 1, missing)


def test_an_optimizer_that_repeats_all_generations_keeps_all_genomes() -> None:
    mapping = experiment.to_mapping(loaded("best")) | {"optimizer": {"kind": "cmaes"}}
    with pytest.raises(ConfigError, match='record: genomes: expected "all" with'):
        build(experiment.complete(experiment.check(mapping, "test"), "test"))
