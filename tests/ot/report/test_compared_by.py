"""A study's page compares what all runs have: evaluate's trials, held-out seeds, or search."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.ot.invented_record import written
from zswarm.champion.held_out import HeldOut
from zswarm.ot.analysis import compared, grouping, measure
from zswarm.ot.analysis.measure import FITNESS, HELD_OUT, SEARCH, Evaluated
from zswarm.ot.record.reader import Run
from zswarm.ot.record.runs import runs_below
from zswarm.ot.record.writer import Record
from zswarm.ot.report import report
from zswarm.ot.report.compared_by import PARTLY, compare

RUNS = 8  # four of each group


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Return runs of which those with two hidden neurons are the better ones in search."""
    for hidden in (1, 2):
        for seed in range(RUNS // 2):
            written(tmp_path, [hidden + seed / 8], hidden=hidden, seed=seed)
    return tmp_path


def assess(runs: list[Run]) -> None:
    """Give champions held-out values: those with one hidden neuron are better."""
    for run in runs:
        mean = (
            run.experiment.seed - 9.0 * run.experiment.representation.settings["hidden"]
        )
        found = HeldOut(mean=mean, low=mean, high=mean, seeds=50, in_search=1.0)
        with Record.open(run.folder)[0] as record:
            record.set_meta("assessment", msgspec.json.encode(found).decode())
            record.set_meta("history_hash", run.history_hash)


def evaluate(runs: list[Run], trials: int = 30) -> None:
    """Give champions values as of evaluate: those with one hidden neuron are better."""
    for run in runs:
        hidden = run.experiment.representation.settings["hidden"]
        fitness = np.full(trials, run.experiment.seed / 8 - 20.0 * hidden)
        measure.save(run, Evaluated(0, fitness, {}))


def page_of(study: Path) -> str:
    return " ".join(report.of_study(study, runs_below([study])).split())


def test_search_is_compared_if_there_is_nothing_else(study: Path) -> None:
    page = page_of(study)
    assert (
        "best fitness in search, mean per trial, of each run after 1 generation;" in page
    )
    assert "hidden 2 has a higher best fitness in search than hidden 1" in page
    assert compared.UNASSESSED.partition(":")[0] in page
    assert ">evaluated</th>" not in page


def test_held_out_values_of_all_runs_are_compared(study: Path) -> None:
    runs = runs_below([study])
    assess(runs[1:])
    assert compare(grouping.groups(runs_below([study]))).found.measure == SEARCH
    assess(runs)
    groups = grouping.groups(runs_below([study]))
    made = compare(groups)
    assert (made.found.measure, made.trials) == (HELD_OUT, "")
    assert made.found == compared.compare(groups, None, HELD_OUT)
    page = page_of(study)
    assert f"Compared: {measure.words(HELD_OUT)}" in page.replace("&#39;", "'")
    assert "hidden 1 is better than hidden 2" in page
    assert "hidden 2 is better" not in page


def test_what_evaluate_found_of_all_champions_is_compared(study: Path) -> None:
    runs = runs_below([study])
    assess(runs)
    evaluate(runs)
    groups = grouping.groups(runs_below([study]))
    made = compare(groups)
    assert (made.found.measure, made.trials) == (FITNESS, "30")
    assert made.found == compared.compare(groups, None, FITNESS)
    page = page_of(study)
    assert f"Compared: {measure.words(FITNESS)}" in page.replace("&#39;", "'")
    assert "Each champion played 30 trials in zswarm-ot evaluate." in page
    assert "hidden 1 is better than hidden 2" in page
    assert ">evaluated</th><th>history hash</th>" in page
    row = '<td>stadium-2</td><td class="right">1</td><td class="right">1</td>'
    assert f'{row}<td class="right">1.125</td><td class="right">-8</td>' in page
    assert '<td class="right">-8</td><td class="right">-19.875</td>' in page
    evaluate(runs[:1], trials=20)
    assert compare(grouping.groups(runs)).trials == "20 to 30"


def test_what_evaluate_found_of_some_is_not_compared_and_the_page_says_so(
    study: Path,
) -> None:
    runs = runs_below([study])
    evaluate(runs[1:])
    made = compare(grouping.groups(runs))
    assert (made.found.measure, made.found.notes[0]) == (SEARCH, PARTLY)
    assert PARTLY in page_of(study)


def test_unfinished_runs_are_compared_in_search(study: Path) -> None:
    written(study, [1, 2], finished=False, seed=77)
    runs = runs_below([study])
    evaluate(runs)
    made = compare(grouping.groups(runs))
    assert made.found.measure == SEARCH
    assert any("is not finished" in note for note in made.found.notes)


def test_pairs_have_the_interval_of_a12(study: Path) -> None:
    (pair,) = compare(grouping.groups(runs_below([study]))).found.pairs
    interval = f"{pair.a12_low:.2f} to {pair.a12_high:.2f}"
    assert pair.a12 == 0.0 < pair.a12_high < 1.0
    page = page_of(study)
    assert '<th class="right">A12</th><th class="right">95 %</th>' in page
    assert f'<td class="right">0.00</td><td class="right">{interval}</td>' in page
