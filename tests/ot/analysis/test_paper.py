"""From recorded runs to what a paper needs: tables, figures, frames and held-out numbers."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import zswarm
from tests.ot.invented_record import written
from zswarm.config.sections import PartConfig
from zswarm.errors import ConfigError
from zswarm.ot.analysis import archive, boxes, grouping, latex, measure
from zswarm.ot.analysis.drawing import SIZES
from zswarm.ot.analysis.measure import Evaluated
from zswarm.ot.cli import command
from zswarm.ot.evaluator import CandidateOutcomes
from zswarm.ot.record.reader import Run
from zswarm.ot.record.runs import runs_below
from zswarm.ot.study import evaluating


def typed(*arguments: str) -> str:
    done = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Two settings with five runs each; the second is better in all."""
    for seed in range(5):
        for hidden, better in ((2, 0.0), (4, 10.0)):
            written(tmp_path, [seed, seed + better + 1], seed=seed, hidden=hidden)
    return tmp_path


def test_latex_has_every_test_and_escapes_names(study: Path) -> None:
    text = typed(
        "compare",
        str(study),
        "--latex",
        "-",
        "--label",
        "hidden 2=A & B_1",
        "--label",
        "hidden 4=50 %",
    )
    assert r"A \& B\_1 & 5 &" in text
    assert r"50 \% & 5 & \textbf{" in text
    assert (
        r"A \& B\_1 & 50 \% & 0 & 0.008 & \textbf{0.008} & 0.00 & 0.00--0.36 & large"
        in text
    )
    assert text.count(r"\bottomrule") == 2
    assert latex.escaped("\\~^") == r"\textbackslash{}\textasciitilde{}\textasciicircum{}"


def test_csv_and_json_have_the_tests(study: Path, tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    told = json.loads(typed("compare", str(study), "--json", "--csv", str(file)))
    (pair,) = told["pairs"]
    assert (pair["a12"], pair["delta"], pair["effect"]) == (0.0, -1.0, "large")
    assert pair["a12_low"] == 0.0
    assert pair["a12_high"] == pytest.approx(0.357, abs=0.001)
    with file.open() as opened:
        *groups, row = csv.DictReader(opened)
    assert [group["what"] for group in groups] == ["group", "group"]
    assert (row["what"], row["group"], row["second"]) == ("pair", "hidden 2", "hidden 4")
    assert float(row["p_holm"]) == pair["p_holm"]


def test_the_same_numbers_are_tidy_frames(study: Path) -> None:
    found = zswarm.compare(study, labels={"hidden 2": "few"})
    assert list(found.groups["group"]) == ["few", "hidden 4"]
    assert list(found.pairs["effect"]) == ["large"]
    assert found.latex.count("toprule") == 2
    frame = zswarm.tidy(study, rows="generations")
    assert len(frame) == 20
    assert set(frame["representation.hidden"]) == {2, 4}
    one = frame[(frame["seed"] == 3) & (frame["representation.hidden"] == 4)]
    assert list(one["best"]) == [3.0, 14.0]
    assert len(zswarm.tidy(study)) == 10
    with pytest.raises(ConfigError, match="was not evaluated: run zswarm-ot evaluate"):
        zswarm.tidy(study, rows="trials")


def test_fitness_is_the_mean_of_a_trial(tmp_path: Path) -> None:
    """The record has the sum."""
    folder = written(tmp_path, [8, 20], trials=4)
    assert Run(folder).best() == 20
    assert list(zswarm.tidy(folder, rows="generations")["best"]) == [2.0, 5.0]


class Played:
    """A connection on which every trial's fitness is the seed's remainder."""

    def outcomes(
        self, _: Any, candidates: list[bytes], *, seeds: list[int]
    ) -> CandidateOutcomes:
        fitness = np.tile([seed % 7 for seed in seeds], (len(candidates), 1)).astype(
            float
        )
        fitness += np.arange(len(candidates))[:, None]
        return CandidateOutcomes(fitness, {"escaped": fitness * 2})


def test_champions_of_a_study_are_compared_by_a_metric(study: Path) -> None:
    groups = grouping.groups(runs_below([study]))
    lines: list[str] = []
    done = evaluating.evaluate(groups, Played(), 6, 3, lines.append)  # type: ignore[arg-type]
    assert {group: len(runs) for group, runs in done.items()} == {
        "hidden 2": 5,
        "hidden 4": 5,
    }
    told = json.loads(typed("compare", str(study), "--measure", "escaped", "--json"))
    assert told["of"] == (
        "champion's escaped on held-out seeds, mean per trial (trials of zswarm-ot evaluate)"
    )
    assert (told["by"], told["families"][0]["at"]) == (None, None)
    assert told["pairs"][0]["a12"] == 0.5
    trials = zswarm.tidy(study, rows="trials")
    assert len(trials) == 60
    means = trials.groupby("run")["fitness"].mean()
    told_of = zswarm.tidy(study).set_index("run")["evaluated_fitness"]
    assert told_of.to_dict() == pytest.approx(means.to_dict())
    with pytest.raises(ConfigError, match="measure wings: unknown; known are: search, "):
        typed("compare", str(study), "--measure", "wings")


def test_another_champion_was_not_evaluated(study: Path) -> None:
    run, other = runs_below([study])[:2]
    measure.save(run, Evaluated(0, np.zeros(3), {}))
    text = json.loads((run.folder / measure.FILE).read_text())
    (run.folder / measure.FILE).write_text(json.dumps(text | {"champion": "00"}))
    with pytest.raises(ConfigError, match="has another champion since"):
        measure.load(run)
    (other.folder / measure.FILE).write_text("[1")
    with pytest.raises(ConfigError, match="cannot be used"):
        measure.load(other)


def test_the_best_median_is_not_bold_without_a_test_that_shows_it(tmp_path: Path) -> None:
    for seed in range(2):
        for hidden, better in ((2, 0.0), (4, 10.0)):
            written(tmp_path, [seed, seed + better + 1], seed=seed, hidden=hidden)
    text = typed("compare", str(tmp_path), "--latex", "-")
    assert r"\textbf" not in text
    assert (
        "% no test: a difference between two groups can be shown with 4 or more" in text
    )


def test_a_group_of_few_runs_has_dots_and_no_box() -> None:
    """Names that are too long for their place have several lines, or are turned."""
    many, few = np.arange(5.0), np.arange(4.0)
    groups = {"CMA-ES, layers": many, "NNGA, layers": few, "three": many, "four": many}
    for shape, drawn in (("box", "patches"), ("violin", "collections")):
        (axes,) = boxes.draw(groups, "fitness", shape, SIZES["column"]).axes
        without = boxes.draw({"a": few}, "fitness", shape, SIZES["column"]).axes[0]
        assert len(getattr(axes, drawn)) > len(getattr(without, drawn))
        texts = [label.get_text() for label in axes.get_xticklabels()]
        assert texts[:2] == ["CMA-ES,\nlayers\n(n = 5)", "NNGA,\nlayers\n(n = 4)"]
    (axes,) = boxes.draw({"x" * 80: many}, "fitness", "box", SIZES["column"]).axes
    assert [label.get_rotation() for label in axes.get_xticklabels()] == [35]


def test_boxes_and_violins_have_a_note_on_what_is_drawn() -> None:
    values = {"a": np.arange(5.0)}
    for shape, words in (("box", "whiskers"), ("violin", "densities")):
        drawn = boxes.draw(values, "fitness", shape, SIZES["column"])
        note = drawn.get_supxlabel()
        assert note.startswith("dots: runs; black lines: medians\n")
        assert words in note
    few = boxes.draw({"a": np.arange(3.0)}, "fitness", "box", SIZES["column"])
    assert few.get_supxlabel() == "dots: runs; black lines: medians"
    without = boxes.draw(values, "fitness", "box", SIZES["column"], noted=False)
    assert without.get_supxlabel() == ""


@pytest.mark.parametrize("shape", ["box", "violin"])
def test_one_number_of_each_run_is_drawn(study: Path, tmp_path: Path, shape: str) -> None:
    style = tmp_path / "paper.mplstyle"
    style.write_text("font.family: serif\n")
    file = tmp_path / f"{shape}.svg"
    arguments = [
        "plot",
        str(study),
        "--as",
        shape,
        "-o",
        str(file),
        "--style",
        str(style),
    ]
    typed(*arguments, "--label", "hidden 4=four")
    first = file.read_bytes()
    assert first.count(b"<path") > 20
    typed(*arguments, "--label", "hidden 4=four")
    assert file.read_bytes() == first
    with pytest.raises(ConfigError, match="--style nothing: no style"):
        typed("plot", str(study), "--as", shape, "-o", str(file), "--style", "nothing")
    with pytest.raises(
        ConfigError, match="--label x: no such group; there are: hidden 2; "
    ):
        typed("plot", str(study), "-o", str(file), "--label", "x=y")


def test_an_archive_holds_the_best_of_each_cell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = {
        "measures": ["escaped", "rounds"],
        "lows": [0, 0],
        "highs": [10, 10],
        "cells": [2, 4],
    }
    elites = PartConfig(kind="map-elites", settings=settings)
    folder = written(tmp_path, [1], optimizer=elites)
    rows = [
        {"fitness": 3.0, "measures": [1.0, 1.0]},
        {"fitness": 5.0, "measures": [4.9, 2.4]},
        {"fitness": 7.0, "measures": [99.0, 10.0]},  # outside: in the outermost cell
        {"fitness": None, "measures": [1.0, 1.0]},
        {"fitness": 9.0, "measures": [None, 1.0]},
    ]
    run = Run(folder)
    monkeypatch.setattr(run, "candidates", lambda _: rows)
    found = archive.of_run(run)
    assert found.fitness[0, 0] == 5.0
    assert found.fitness[1, 3] == 7.0
    assert np.isfinite(found.fitness).sum() == 2
    assert found.coverage == 0.25
    with pytest.raises(ConfigError, match="expected a run with two measures"):
        archive.of_run(Run(written(tmp_path, [1, 2])))
