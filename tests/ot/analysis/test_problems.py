"""Studies of several problems: their groups are named, tested and marked within each problem."""

import csv
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import zswarm
from tests.ot.invented_record import written
from zswarm.ot.analysis import figures, grouping
from zswarm.ot.analysis.compared import compare, over_problems
from zswarm.ot.analysis.curves import load
from zswarm.ot.analysis.effect_size import LEVEL
from zswarm.ot.cli import command
from zswarm.ot.record.runs import runs_below
from zswarm.ot.report import report

METHODS = (("A", 2, 0.0), ("B", 3, 50.0), ("C", 4, 90.0))
PROBLEMS = ((8, 0.0), (16, 1000.0), (24, 2000.0))  # agents, and how easy that is


def typed(*arguments: object) -> str:
    texts = [str(argument) for argument in arguments]
    done = CliRunner().invoke(command, texts, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def studied(
    out: Path, runs: int, problems: int, methods: int = 3, *, label: bool = True
) -> Path:
    """Write a study for each of some problems; a later method, or problem, is always better."""
    for agents, easy in PROBLEMS[:problems]:
        for name, hidden, better in METHODS[:methods]:
            for seed in range(runs):
                written(
                    out / f"study-{agents}",
                    [easy + better + seed],
                    seed=seed,
                    hidden=hidden,
                    settings={"agents": agents},
                    label=name if label else "",
                )
    return out


def test_groups_are_tested_within_their_problem_only(tmp_path: Path) -> None:
    """Holm's correction is for the three pairs of a problem, and so are the runs needed."""
    groups = grouping.groups(runs_below([studied(tmp_path, runs=5, problems=3)]))
    found = compare(groups)
    assert [family.problem for family in found.families] == [
        "agents 8",
        "agents 16",
        "agents 24",
    ]
    problem_of = {row.group: row.problem for row in found.rows}
    assert len(found.pairs) == 9
    for pair in found.pairs:
        assert problem_of[pair.first] == problem_of[pair.second] == pair.problem
        assert pair.p == pytest.approx(2 / 252)
        assert pair.p_holm == pytest.approx(3 * pair.p)
    for family in found.families:
        assert family.untested == ""
        assert family.kruskal_p is not None
        assert family.kruskal_p < LEVEL


def test_groups_have_the_name_of_their_problem(tmp_path: Path) -> None:
    studied(tmp_path, runs=1, problems=2, methods=2)
    assert list(grouping.groups(runs_below([tmp_path]))) == [
        "A (agents 8)",
        "B (agents 8)",
        "A (agents 16)",
        "B (agents 16)",
    ]
    one = grouping.groups(runs_below([tmp_path / "study-8"]))
    assert list(one) == ["A", "B"]


def test_methods_of_one_name_and_problem_have_the_name_of_their_study(
    tmp_path: Path,
) -> None:
    for study, hidden in (("first", 2), ("second", 3)):
        written(tmp_path / study, [1.0], hidden=hidden, label="A")
    groups = grouping.groups(runs_below([tmp_path]))
    assert list(groups) == ["A (first)", "A (second)"]


def test_settings_of_one_simulator_are_compared_if_nothing_else_differs(
    tmp_path: Path,
) -> None:
    """They are then what the study is about; a note warns of their fitness."""
    groups = grouping.groups(
        runs_below([studied(tmp_path, runs=4, problems=2, methods=1, label=False)])
    )
    found = compare(groups)
    assert [family.problem for family in found.families] == [""]
    assert len(found.pairs) == 1
    assert "runs whose problems differ in agents: their fitness may not compare" in (
        found.notes
    )


def test_the_only_group_of_a_problem_is_not_tested(tmp_path: Path) -> None:
    for seed in range(5):
        written(tmp_path, [seed], seed=seed)
        written(tmp_path, [seed + 9], seed=seed, simulator="minisim")
    found = compare(grouping.groups(runs_below([tmp_path])))
    assert found.pairs == []
    assert sorted(found.untested) == [
        (" (emergency-exit)", "it is the only group of its problem"),
        (" (minisim)", "it is the only group of its problem"),
    ]


def test_each_problem_has_its_best_group_in_the_tables(tmp_path: Path) -> None:
    text = typed("compare", studied(tmp_path, runs=6, problems=2), "--latex", "-")
    table, _, _ = text.partition(r"\bottomrule")
    bold = [line.split(" & ")[0] for line in table.splitlines() if r"\textbf" in line]
    assert bold == ["C (agents 8)", "C (agents 16)"]
    assert r"C (agents 8) & 6 & \textbf{92.50} &" in text
    assert r"C (agents 16) & 6 & \textbf{1092} &" in text


def test_every_output_has_the_problem_of_a_pair(tmp_path: Path) -> None:
    runs = studied(tmp_path / "runs", runs=6, problems=2)
    file = tmp_path / "table.csv"
    told = json.loads(typed("compare", runs, "--json", "--csv", file))
    assert {pair["problem"] for pair in told["pairs"]} == {"agents 8", "agents 16"}
    assert [one["problem"] for one in told["families"]] == ["agents 8", "agents 16"]
    with file.open() as opened:
        rows = list(csv.DictReader(opened))
    assert {row["problem"] for row in rows} == {"agents 8", "agents 16"}
    assert {len(row) for row in rows} == {len(rows[0])}
    frames = zswarm.compare(runs)
    assert list(frames.families["problem"]) == ["agents 8", "agents 16"]
    assert list(frames.pairs["problem"]) == [pair["problem"] for pair in told["pairs"]]
    said = " ".join(typed("compare", runs).split())
    assert "C (agents 8) has a higher best fitness in search than A (agents 8)" in said
    assert "Kruskal-Wallis over all groups (agents 8): p < 0.001" in said
    page = report.of_study(runs, runs_below([runs]))
    assert "C (agents 8) has a higher best fitness in search than A (agents 8)" in page
    assert "Kruskal-Wallis over all groups (agents 8): p &lt; 0.001" in page
    for text in (said, page):
        assert (
            "(agents 16) has a higher best fitness in search than C (agents 8" not in text
        )


def test_the_note_of_a_figure_has_the_test_of_each_problem(tmp_path: Path) -> None:
    runs = runs_below([studied(tmp_path, runs=6, problems=2, methods=2)])
    loaded, _ = load(grouping.groups(runs))
    (note,) = [text.get_text() for text in figures.of_series(loaded).axes[0].texts]
    assert note.splitlines()[1:] == [
        "agents 8: Mann-Whitney U after 1 generation: p = 0.002",
        "A12 = 1.00 of B (agents 8) over A (agents 8)",
        "agents 16: Mann-Whitney U after 1 generation: p = 0.002",
        "A12 = 1.00 of B (agents 16) over A (agents 16)",
    ]


@pytest.mark.parametrize(("problems", "shown"), [(2, False), (3, True)])
def test_friedman_is_shown_where_it_can_be_significant(
    tmp_path: Path, problems: int, shown: bool
) -> None:
    runs = studied(tmp_path, runs=1, problems=problems)
    groups = grouping.groups(runs_below([runs]))
    ranked = over_problems(groups, compare(groups))
    assert ranked is not None
    assert ranked.ranks == {"A": 3.0, "B": 2.0, "C": 1.0}
    assert (ranked.needed, ranked.p < LEVEL) == (3, shown)
    said = " ".join(typed("compare", runs).split())
    assert ("Friedman over 3 problems: p = 0.050." in said) == shown
    none = "Friedman's test can show a difference over 3 or more problems; here are 2."
    assert (f"No test over problems: with 3 methods, {none}" in said) != shown


def test_unequal_effort_is_that_within_a_problem(tmp_path: Path) -> None:
    for agents, candidates in ((8, 3), (16, 9)):
        for hidden in (2, 3):
            written(
                tmp_path,
                [1.0],
                settings={"agents": agents},
                hidden=hidden,
                candidates=candidates,
            )
    notes = compare(grouping.groups(runs_below([tmp_path]))).notes
    assert not any("different numbers of evaluations" in note for note in notes)


def test_each_problem_has_its_own_point_of_comparison(tmp_path: Path) -> None:
    for agents, length in ((8, 2), (16, 4)):
        for hidden in (2, 3):
            best = [float(generation) for generation in range(length + hidden)]
            written(tmp_path, best, settings={"agents": agents}, hidden=hidden)
    found = compare(grouping.groups(runs_below([tmp_path])))
    assert {family.problem: family.at for family in found.families} == {
        "agents 8": 4,
        "agents 16": 6,
    }
    assert {row.problem: row.median for row in found.rows} == {
        "agents 8": 3.0,
        "agents 16": 5.0,
    }
    said = " ".join(typed("compare", tmp_path).split())
    assert (
        "of each run after 4 generations (agents 8), after 6 generations (agents 16)"
        in said
    )
    note = "runs (agents 8) are of unequal length: compared after 4 generations"
    assert note in said
