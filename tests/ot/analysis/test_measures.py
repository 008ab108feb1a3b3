"""What is compared: the best fitness in search, or what champions do on held-out seeds."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import zswarm
from tests.ot.invented_record import written
from zswarm.errors import ConfigError
from zswarm.ot.analysis import compared, grouping, latex, measure
from zswarm.ot.analysis.measure import Evaluated
from zswarm.ot.cli import command
from zswarm.ot.record.runs import runs_below


def typed(*arguments: object) -> str:
    texts = [str(argument) for argument in arguments]
    done = CliRunner().invoke(command, texts, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture
def assessed(tmp_path: Path) -> Path:
    """Two settings; the second seems better in search, and is worse on held-out seeds."""
    for seed in range(5):
        for hidden, seems, better in ((2, 0.0, 10.0), (4, 10.0, 0.0)):
            written(
                tmp_path,
                [seed, seed + seems],
                seed=seed,
                hidden=hidden,
                held_out=float(seed + better),
                candidates=hidden,
            )
    return tmp_path


def compare(folder: Path, *options: str) -> dict[str, object]:
    found: dict[str, object] = json.loads(typed("compare", folder, "--json", *options))
    return found


def test_assessed_champions_are_compared_by_default(assessed: Path) -> None:
    found = compare(assessed)
    assert (found["measure"], found["by"]) == ("held-out", None)
    said = " ".join(typed("compare", assessed).split())
    assert "hidden 2 is better than hidden 4: A12 = 1.00" in said
    assert (
        "Compared: champion's fitness on held-out seeds, mean per trial (assessment at the end of "
        "each run); higher is better." in said
    )
    groups = grouping.groups(runs_below([assessed]))
    _, height, _ = compared.numbers(groups, None)
    assert height == "champion's fitness on held-out seeds, mean per trial"
    assert zswarm.compare(assessed).of == found["of"]


def test_search_is_compared_where_a_run_is_not_assessed_or_not_finished(
    assessed: Path,
) -> None:
    assert compare(assessed, "--by", "evaluations")["measure"] == "search"
    hint = "compare --measure held-out compares what the champions do on other seeds"
    notes = compared.compare(
        grouping.groups(runs_below([assessed])), None, "search"
    ).notes
    assert f"the best fitness in search is partly luck: {hint}" in notes
    written(assessed, [1.0], seed=9)
    found = compare(assessed)
    assert found["measure"] == "search"
    assert "zswarm-ot evaluate FOLDER plays all champions" in str(found["notes"])


def test_an_unfinished_run_leaves_the_search_to_compare(assessed: Path) -> None:
    written(assessed, [1.0], seed=9, finished=False)
    assert compare(assessed)["measure"] == "search"


@pytest.mark.parametrize("name", ["held-out", "fitness"])
def test_unequal_effort_of_whole_runs_is_named(assessed: Path, name: str) -> None:
    for run in runs_below([assessed]):
        measure.save(run, Evaluated(0, np.ones(3), {}))
    assert compare(assessed, "--measure", name)["notes"] == [
        "the groups used different numbers of evaluations; compare --by evaluations compares the "
        "best fitness in search at equal effort"
    ]


def test_the_assessment_has_a_column_next_to_the_search_only(
    assessed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    groups = grouping.groups(runs_below([assessed]))
    for run in runs_below([assessed]):
        measure.save(run, Evaluated(0, np.ones(3), {}))
    for name, column in (("search", True), ("held-out", False), ("fitness", False)):
        table = latex.tables(compared.compare(groups, None, name))
        assert ("& held-out &" in table) == column
        heads = typed("compare", assessed, "--measure", name).splitlines()[1]
        assert ("held-out" in heads) == column
    assert "(trials of zswarm-ot evaluate)" in table


def test_a_run_without_an_assessment_is_told_the_way_out(tmp_path: Path) -> None:
    folder = written(tmp_path / "study", [1.0])
    with pytest.raises(ConfigError) as refused:
        typed("compare", folder, "--measure", "held-out")
    assert "its champion was not assessed on held-out seeds; " in str(refused.value)
    assert f"zswarm-ot evaluate {folder.parent} plays" in str(refused.value)
    assert "--measure fitness compares" in str(refused.value)


@pytest.mark.parametrize(
    ("trials", "seeds", "words"),
    [
        ((1, 4), ("fixed", "fixed"), "numbers of trials"),
        ((1, 1), ("fixed", "fresh"), "seeds (fixed or fresh)"),
        ((1, 4), ("fixed", "fresh"), "seeds (fixed or fresh) and numbers of trials"),
    ],
)
def test_luck_by_seeds_and_trials_is_named(
    tmp_path: Path, trials: tuple[int, int], seeds: tuple[str, str], words: str
) -> None:
    for count, kind in zip(trials, seeds, strict=True):
        written(
            tmp_path, [1.0], trials=count, seeds="fresh" if kind == "fresh" else "fixed"
        )
    found = compared.compare(grouping.groups(runs_below([tmp_path])))
    assert (
        f"the runs' candidates have different {words}: with fresh seeds or fewer trials, the best "
        "fitness in search owes more to luck" in found.notes
    )


@pytest.mark.parametrize("label", ["NNGA", "=NNGA", "hidden 2="])
def test_a_label_without_both_names_is_refused(assessed: Path, label: str) -> None:
    with pytest.raises(ConfigError, match=f"^--label {label}: expected GROUP=NAME$"):
        typed("compare", assessed, "--label", label)


def test_the_result_in_python_says_what_was_compared(assessed: Path) -> None:
    assert repr(zswarm.compare(assessed, measure="search")) == (
        "<Compared: best fitness in search, mean per trial; hidden 2: 5 runs, hidden 4: 5 runs; "
        "1 pair tested>"
    )


def test_p_below_a_thousandth_is_bold_mathematics(tmp_path: Path) -> None:
    for seed in range(9):
        for hidden, better in ((2, 0.0), (4, 50.0)):
            written(tmp_path, [seed + better], seed=seed, hidden=hidden)
    text = typed("compare", tmp_path, "--latex", "-")
    assert r"& $<0.001$ & {\boldmath$<0.001$} &" in text
