"""MAP-Elites and CMA-ME keep the best of each behaviour; the record holds their archive."""

import functools
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from tests.ot.optimizers.spheres import Vector, evolve, make
from tests.repository import REPOSITORY
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.evaluate import evaluate
from zswarm.kernels.random import Stream
from zswarm.ot import run
from zswarm.ot.build import build
from zswarm.ot.generation import Assessment
from zswarm.ot.optimizers.elites import COMPILED, CmaMe, Elites, MapElites
from zswarm.ot.record.writer import Record
from zswarm.testing import check_optimizer

DOCUMENT = REPOSITORY / "docs" / "optimizers.md"
GRID = {"measures": ["a", "b"], "lows": [-2, -2], "highs": [2, 2], "cells": [10, 12]}
KINDS = [
    (MapElites, {}),
    (CmaMe, {}),
    (CmaMe, {"separable": True, "emitters": 2, "population": 5}),
]


def elites(kind: type[Elites], genes: int = 8, **settings: Any) -> Elites:
    optimizer = make(kind, genes, **(GRID | settings))
    assert isinstance(optimizer, Elites)
    return optimizer


def test_cma_me_of_the_separable_form_keeps_the_contract_of_optimizers() -> None:
    check_optimizer(CmaMe, GRID | KINDS[-1][1])


@pytest.mark.parametrize(("kind", "settings"), KINDS)
def test_the_archive_holds_the_best_of_each_cell(
    kind: type[Elites], settings: dict[str, Any]
) -> None:
    """The archive follows from measures and fitness told; the first of equals stays."""
    optimizer = elites(kind, **settings)
    best: dict[tuple[int, ...], tuple[float, bytes]] = {}
    for genomes, fitness, measures in evolve(optimizer, 30):
        for genome, value, measured in zip(
            genomes, fitness.tolist(), measures, strict=True
        ):
            steps = np.floor((measured - GRID["lows"]) / 4.0 * GRID["cells"])
            cell = tuple(
                np.clip(steps, 0, np.array(GRID["cells"]) - 1).astype(int).tolist()
            )
            if cell not in best or value > best[cell][0]:
                best[cell] = value, genome
    archive = optimizer.archive.data()
    cells = map(tuple, optimizer.archive.int_to_grid_index(archive["index"]).tolist())
    ranges = Vector(8).ranges
    found = {
        cell: (value, (solution * ranges).astype("<f4").tobytes())
        for cell, value, solution in zip(
            cells, archive["objective"].tolist(), archive["solution"], strict=True
        )
    }
    assert found == best
    statistics = optimizer.statistics()
    assert statistics["elites"] == len(best)
    assert statistics["coverage"] == pytest.approx(len(best) / 120)
    assert statistics["qd_score"] == pytest.approx(
        sum(value for value, _ in best.values())
    )


def test_the_score_counts_fitness_from_its_offset() -> None:
    plain, raised = (elites(MapElites, qd_score_offset=offset) for offset in (0.0, -50.0))
    for optimizer in (plain, raised):
        evolve(optimizer, 5)
    count = plain.statistics()["elites"]
    assert raised.statistics()["qd_score"] == pytest.approx(
        plain.statistics()["qd_score"] + 50 * count
    )


def test_the_first_candidates_of_map_elites_are_random_genomes() -> None:
    """Their genes are uniform in the ranges, as at the start of evolution."""
    optimizer = elites(MapElites, 200)
    genes = optimizer.representation.parameters(optimizer.ask()) / Vector(200).ranges
    assert 0.9 < np.abs(genes).max() <= 1.0
    assert abs(genes.mean()) < 0.02


@pytest.mark.parametrize(("kind", "settings"), KINDS)
def test_failed_candidates_leave_no_trace_in_the_archive(
    kind: type[Elites], settings: dict[str, Any]
) -> None:
    """This holds even if all of a generation failed and none was told before."""
    optimizer = elites(kind, **settings)
    for generation in range(6):
        genomes = optimizer.ask()
        fitness, measures = np.ones(len(genomes)), np.zeros((len(genomes), 2))
        failed = (
            np.arange(len(genomes)) % 3 != 0
            if generation % 2
            else np.full(len(genomes), True)
        )
        fitness[failed], measures[failed], measures[~failed] = np.nan, np.nan, 1.9
        optimizer.tell(fitness, measures)
        assert optimizer.statistics()["elites"] == (generation > 0)
    assert optimizer.archive.data("measures").tolist() == [[1.9, 1.9]]


def test_emitters_learn_from_what_was_evaluated() -> None:
    """They learn neither from unrounded proposals nor, after a resume, from diverged ones."""
    optimizer = elites(CmaMe)
    genomes = optimizer.ask()
    strangers = optimizer.representation.random(len(genomes), Stream(9))
    optimizer._asked = strangers
    table = optimizer.representation.parameters(strangers) / Vector(8).ranges
    optimizer.tell(
        np.arange(len(genomes), dtype=np.float64), table[:, :2].astype(np.float64)
    )
    learned = np.concatenate([emitter._opt._solutions for emitter in optimizer._emitters])
    assert np.array_equal(learned, table)


def test_nothing_is_compiled_for_an_emitter() -> None:
    """Compilation would take longer than a run."""
    for separable in (False, True):
        optimizer = elites(CmaMe, separable=separable)
        for emitter in optimizer._emitters:
            assert not [
                name
                for name in COMPILED
                if hasattr(getattr(emitter._opt, name, None), "py_func")
            ]
        assert not [
            name
            for name, value in vars(type(emitter._opt)).items()
            if "jit" in repr(value) and name not in COMPILED
        ]


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            {"measures": []},
            "optimizer: measures: expected the names of metrics that describe behaviour",
        ),
        ({"lows": [0]}, "optimizer: lows: expected 2 numbers, one per measure, not 1"),
        (
            {"cells": [3, 4, 5]},
            "optimizer: cells: expected 2 numbers, one per measure, not 3",
        ),
        ({"lows": [2, 0]}, "optimizer: a: expected a low below its high, not 2 and 2"),
        (
            {"highs": [2, float("inf")]},
            "optimizer: b: expected a low below its high, not -2 and inf",
        ),
        ({"cells": [3, 0]}, "optimizer: cells: expected at least 1 for b, not 0"),
        (
            {"cells": [2000, 2000]},
            "optimizer: cells: expected at most 1,000,000 in all, not 4,000,000",
        ),
        (
            {"measures": ["a", "a"]},
            "optimizer: measures: a name stands there twice: a, a",
        ),
    ],
)
def test_an_impossible_grid_is_refused_in_one_line(
    settings: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        elites(MapElites, **settings)
    assert str(refusal.value) == text


def test_an_emitter_of_too_few_candidates_is_refused() -> None:
    with pytest.raises(
        ConfigError, match="optimizer: population: expected 0, or at least 4, not 3"
    ):
        elites(CmaMe, population=3)


def test_the_package_is_loaded_only_when_used() -> None:
    """Loading it takes seconds."""
    imports = "import sys, zswarm.ot.optimizers.elites, zswarm.ot.optimizers.cmaes"
    code = f"{imports}; print({{'ribs', 'cmaes'}} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) == ("set()\n", "")


def test_where_the_package_is_missing_one_line_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("ribs", "ribs.emitters"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(
        ConfigError, match=r"^an optimizer with an archive needs ribs: .* install "
    ):
        elites(MapElites)


# ---- the example: many ways to play capture the flag


def loaded(**optimizer: Any) -> experiment.Experiment:
    mapping = experiment.to_mapping(experiment.load(experiment.find("minisim-elites")))
    mapping["optimizer"] = {
        "measures": ["steals", "tagged"],
        "lows": [0, 0],
        "highs": [6, 160],
        "cells": [12, 16],
    } | optimizer
    return experiment.complete(experiment.check(mapping, "test"), "test")


def played(parts: run.Parts, generations: int, genomes: Any = None) -> run.Parts:
    """Play without servers; ``genomes(generation)`` replaces those that were asked for."""
    problem, optimizer = parts
    for generation in range(generations):
        asked = optimizer.ask()
        if genomes:
            optimizer._asked = asked = genomes(generation)[: len(asked)]
        assessment = Assessment(problem, asked, generation)
        work = assessment.workload
        outcomes = evaluate(
            problem.simulator,
            problem.representation,
            work.genomes,
            work.participants,
            work.seeds,
        )
        work.fitness[:], work.metrics[:] = outcomes.fitness, outcomes.metrics
        assessment.advance()
        optimizer.tell(assessment.fitness(), assessment.measures(optimizer.measures))
    return parts


@functools.cache
def scores(generations: int) -> dict[str, list[float]]:
    """Return the scores with six seeds after generations of 50 evaluations each."""
    found: dict[str, list[float]] = {"map-elites": [], "cma-me": [], "random": []}
    for seed in range(1, 7):
        for kind, settings in (
            ("map-elites", {"population": 50}),
            ("cma-me", {"emitters": 5, "population": 10}),
        ):
            complete = experiment.complete(
                experiment.check(
                    experiment.to_mapping(loaded(kind=kind, **settings)) | {"seed": seed},
                    "test",
                ),
                "test",
            )
            parts = played(build(complete), generations)
            found[kind].append(parts.optimizer.statistics()["qd_score"])
        parts = build(complete)

        def genomes(
            generation: int, parts: run.Parts = parts, seed: int = seed
        ) -> list[bytes]:
            return parts.problem.representation.random(
                50, Stream(1000 * seed + generation)
            )

        played(parts, generations, genomes)
        found["random"].append(parts.optimizer.statistics()["qd_score"])
    return found


COMPARED = pytest.mark.parametrize(
    "generations",
    [
        pytest.param(50, marks=pytest.mark.long),
        pytest.param(100, marks=pytest.mark.thorough),
    ],
)


@COMPARED
def test_quality_diversity_finds_more_and_better_behaviours_than_random_search(
    generations: int,
) -> None:
    found = scores(generations)
    for kind in ("map-elites", "cma-me"):
        assert (
            mannwhitneyu(found[kind], found["random"], alternative="greater").pvalue
            < 0.01
        )
        assert np.median(found[kind]) > 3 * np.median(found["random"])


@COMPARED
def test_cma_me_has_a_higher_score_than_map_elites_with_as_many_candidates(
    generations: int,
) -> None:
    """In the task of their examples."""
    found = scores(generations)
    assert (
        mannwhitneyu(found["cma-me"], found["map-elites"], alternative="greater").pvalue
        < 0.01
    )


def test_the_archive_of_a_recorded_run_is_that_of_its_optimizer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Made by the lines of the document, from what each candidate's fitness and measures were."""
    monkeypatch.chdir(tmp_path)
    complete = loaded(kind="map-elites", population=20)
    problem, optimizer = build(complete)
    with Record.create(
        Path("runs"), complete, "0" * 32, problem.simulator.metrics
    ) as record:
        for generation in range(6):
            genomes = optimizer.ask()
            first = np.array(
                [np.frombuffer(genome, "<f4")[:2] for genome in genomes], np.float64
            )
            fitness, measures = first[:, 0].copy(), np.abs(first) * [2, 60]
            fitness[3], measures[3] = np.nan, np.nan
            optimizer.tell(fitness, measures)
            record.finish(
                generation,
                genomes,
                fitness,
                optimizer.statistics(),
                optimizer.state(),
                measures,
            )
    code = next(
        block
        for block in re.findall(
            r"^```python\n(.*?)^```", DOCUMENT.read_text(), re.S | re.M
        )
        if "GridArchive" in block
    )
    namespace: dict[str, Any] = {}
    exec(compile(code, DOCUMENT.name, "exec"), namespace)  # noqa: S102  our own text
    recorded, told = namespace["archive"].data(), optimizer.archive.data()  # type: ignore[attr-defined]
    for name in ("index", "objective", "measures"):
        assert np.array_equal(recorded[name], told[name])
    assert np.array_equal(
        recorded["solution"],
        (told["solution"] * problem.representation.ranges).astype("<f4"),
    )
    assert len(recorded["index"]) > 20
