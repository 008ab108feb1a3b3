"""Fresh seeds: whatever survives is evaluated again, and its fitness is the mean of what it saw."""

import threading
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.ot.assessment.test_assessed_runs import Noisy
from tests.ot.cluster.fake_connection import result
from zswarm import experiment
from zswarm.champion.controller import load_controller
from zswarm.ot import run
from zswarm.ot.assessment.seen_seeds import SeenSeeds
from zswarm.ot.build import build
from zswarm.ot.logger import Logger
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.ot.record.reader import Run
from zswarm.ot.record.summary import summary
from zswarm.ot.record.writer import Record
from zswarm.plugins import registry

MEASURED = {"measures": ["rounds", "escaped"]}
ARCHIVE = {**MEASURED, "lows": [0, 0], "highs": [1, 1], "cells": [4, 4]}
SETTINGS: dict[str, dict[str, object]] = {
    "cea2d": {"width": 3, "height": 3},
    "cma-me": {**ARCHIVE, "emitters": 2, "population": 4},
    "map-elites": {**ARCHIVE, "population": 10},
    "neat": {"population": 10, "elite_size": 1},
    "novelty": {**MEASURED, "population": 10, "fitness": 0.5},
}
NOTHING_SURVIVES = {"cmaes", "openai-es"}
KINDS = sorted(set(registry.names("optimizer")))


def loaded(kind: str, *overrides: str) -> experiment.Experiment:
    own = ["problem.seeds=fresh", "problem.settings.seed=-1"]
    more = ["generations=5", "problem.trials=2", *own, *overrides]
    mapping = experiment.to_mapping(
        experiment.load(experiment.find("stadium"), [*more, "assessment.budget=0"])
    )
    chosen = SETTINGS.get(kind, {"population": 10})
    mapping |= {"optimizer": {"kind": kind, **chosen}}
    network = "neat" if kind == "neat" else "fully-meshed"
    mapping |= {"representation": {"kind": network}}
    return experiment.complete(experiment.check(mapping, "test"), "test")


def evolved(out: Path, complete: experiment.Experiment, stop: int | None = None) -> Path:
    """Evolve, or only some generations; return the folder."""
    metrics = build(complete).problem.simulator.metrics
    with Record.create(out, complete, "0" * 32, metrics) as record:
        evolution = run.evolve(
            build(complete),
            record,
            Noisy(),  # type: ignore[arg-type]
            Logger(),
            threading.Event(),
        )
        if stop is None:
            result(evolution)
        for _ in islice(evolution, stop or 0):
            pass
        evolution.close()
    return record.folder


def resumed(folder: Path) -> None:
    record, complete = Record.open(folder)
    with record:
        result(
            run.evolve(build(complete), record, Noisy(), Logger(), threading.Event())  # type: ignore[arg-type]
        )


def asked(folder: Path) -> list[list[bytes]]:
    found = Run(folder)
    return [
        [row["genome"] for row in found.candidates(generation)]
        for generation in range(found.generations())
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_survivors_are_evaluated_again_and_their_fitness_is_a_mean(
    tmp_path: Path, kind: str
) -> None:
    complete = loaded(kind)
    folder = evolved(tmp_path, complete)
    generations, found = asked(folder), Run(folder)
    again = [len(set(one) & set(other)) for one, other in pairwise(generations)]
    assert all(again) != (kind in NOTHING_SURVIVES)
    seen: dict[bytes, list[float]] = {}
    for number, genomes in enumerate(generations):
        trials = np.array([row["fitness"][0] for row in found.trials(number)])
        sums = dict(zip(genomes, trials.reshape(-1, 2).sum(axis=1), strict=True))
        seen = {one: [*seen.get(one, []), value] for one, value in sums.items()}
        for row in found.candidates(number):
            assert row["fitness"] == pytest.approx(np.mean(seen[row["genome"]]))


@pytest.mark.parametrize("kind", ["nnga", "map-elites"])
def test_a_resumed_run_knows_what_its_genomes_have_seen(
    tmp_path: Path, kind: str
) -> None:
    """One optimizer restores its state, the other repeats all generations."""
    whole = Run(evolved(tmp_path / "whole", loaded(kind)))
    folder = evolved(tmp_path / "stopped", loaded(kind), stop=4)
    resumed(folder)
    assert Run(folder).history_hash == whole.history_hash


def test_the_best_so_far_may_turn_out_to_have_been_lucky(tmp_path: Path) -> None:
    folder = evolved(tmp_path, loaded("nnga"))
    found = Run(folder)
    best = [row["best"] for row in found.history()]
    assert best != sorted(best)
    assert found.best() == summary(folder)["best"] == best[-1] < max(best)
    last = {row["genome"]: row["fitness"] for row in found.candidates(len(best) - 1)}
    champion = load_controller(folder)
    assert last[champion.genome] == champion.fitness == best[-1]


@pytest.mark.parametrize("kind", KINDS)
def test_fixed_seeds_ask_for_no_survivor(kind: str) -> None:
    optimizer: Optimizer = build(loaded(kind, "problem.seeds=fixed")).optimizer
    assert not optimizer.fresh
    first = optimizer.ask()
    count = (len(first), len(optimizer.measures))
    optimizer.tell(np.arange(len(first), dtype=float), np.full(count, 0.5))
    both = set(first) & set(optimizer.ask())
    assert len(both) <= (kind == "cuckoo")  # the best nest's egg does not fly


def test_a_genome_that_failed_once_has_failed_and_one_that_pauses_begins_again() -> None:
    seen, none = SeenSeeds(), np.empty((2, 0))
    seen.merge([b"a", b"b"], np.array([1.0, np.nan]), none)
    fitness, _ = seen.merge([b"b", b"a"], np.array([4.0, 4.0]), none)
    np.testing.assert_array_equal(fitness, [np.nan, 2.5])
    fitness, _ = seen.merge([b"a", b"a"], np.array([7.0, 7.0]), none)
    np.testing.assert_array_equal(fitness, [4.0, 4.0])
    fitness, _ = seen.merge([b"b", b"c"], np.array([3.0, -0.0]), none)
    assert fitness.tobytes() == np.array([3.0, 0.0]).tobytes()
