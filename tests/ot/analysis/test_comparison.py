"""Groups of runs compared with each other, and the tests between them."""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.ot.invented_record import written
from zswarm.config.sections import StopConfig
from zswarm.errors import ConfigError
from zswarm.ot.analysis import comparison, curves, grouping, significance
from zswarm.ot.analysis.compared import compare
from zswarm.ot.analysis.comparison import Comparison
from zswarm.ot.analysis.curves import Series
from zswarm.ot.analysis.effect_size import LEVEL, effect
from zswarm.ot.analysis.significance import Family, Pair
from zswarm.ot.record.reader import Run

NAN = float("nan")


def run(*best: float, per_generation: float = 50.0) -> Series:
    generations = np.arange(1.0, len(best) + 1)
    values = np.array(best, np.float64)
    return Series(values, values - 1, generations * per_generation, generations)


def ended(values: Sequence[float]) -> list[Series]:
    return [run(value) for value in values]


def compared(groups: Mapping[str, Sequence[Run]]) -> Comparison:
    loaded, notes = curves.load(groups)
    return comparison.of_series(loaded, "generations", notes)


def test_a_row_has_median_and_quartiles_of_the_runs() -> None:
    (row,) = comparison.of_series({"a": ended([4, 1, 2, 3, 5])}, "generations").rows
    assert row == ("a", 5, 3.0, 2.0, 4.0, 5.0, 1.0, 50.0, 1.0, None, 50.0, "")


def test_runs_of_unequal_length_are_compared_at_the_shortest_length() -> None:
    """The length is the largest number of generations that all have; a note reports it."""
    found = comparison.of_series({"a": [run(1, 2, 3)], "b": [run(1, 5)]}, "generations")
    assert found.families[0].at == 2
    assert [row.median for row in found.rows] == [2.0, 5.0]
    assert (
        "runs are of unequal length: compared after 2 generations, which all have"
        in found.notes
    )


def test_groups_can_be_compared_after_equally_many_evaluations() -> None:
    found = comparison.of_series(
        {"a": [run(1, 2, 3, 4)], "b": [run(1, 5, per_generation=100)]}, "evaluations"
    )
    assert found.families[0].at == 200
    assert [row.median for row in found.rows] == [4.0, 5.0]


def test_a_note_names_groups_of_different_cost() -> None:
    found = comparison.of_series(
        {"a": [run(1, 2)], "b": [run(1, 5, per_generation=100)]}, "generations"
    )
    assert any("different numbers of evaluations" in note for note in found.notes)


def test_runs_without_a_common_number_of_evaluations_are_reported_in_one_line() -> None:
    with pytest.raises(
        ConfigError, match="no number of evaluations is common to all runs"
    ):
        comparison.of_series(
            {"a": [run(1)], "b": [run(1, per_generation=1000)]}, "evaluations"
        )


def test_a_run_in_which_all_failed_is_the_worst() -> None:
    found = comparison.of_series(
        {"a": ended([-math.inf, 1, 2]), "b": ended([-math.inf] * 3)}, "generations"
    )
    assert found.rows[0][2:7] == (1.0, None, 1.5, 2.0, None)
    assert found.rows[1][2:7] == (None,) * 5
    assert "runs in which every candidate failed count as the worst" in found.notes


def test_no_finished_generation_is_reported_in_one_line() -> None:
    with pytest.raises(ConfigError, match="no run finished a generation yet"):
        comparison.of_series({"a": [run()]}, "generations")


def exact_p(a: Sequence[float], b: Sequence[float]) -> float:
    """Two-sided, by all ways to deal the values out."""
    pooled = [*a, *b]

    def u(chosen: Sequence[int]) -> float:
        rest = [pooled[i] for i in range(len(pooled)) if i not in chosen]
        return sum(
            (pooled[i] > other) + 0.5 * (pooled[i] == other)
            for i in chosen
            for other in rest
        )

    ways = [u(chosen) for chosen in itertools.combinations(range(len(pooled)), len(a))]
    seen = ways[0]
    return min(
        1.0,
        2
        * min(sum(way <= seen for way in ways), sum(way >= seen for way in ways))
        / len(ways),
    )


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ([1, 2, 3, 4, 9], [5, 6, 7, 8, 10]),
        ([1, 2, 2, 3, 3], [3, 4, 4, 5, 5, 5]),
        ([3, 4, 4, 5, 5, 5, 9], [1, 2, 2, 3]),
        ([-math.inf, -math.inf, 1, 2, 3], [4, 5, 6, 7]),
    ],
)
def test_a_small_sample_is_tested_exactly(a: list[float], b: list[float]) -> None:
    """The p of all ways to deal the runs out, with ties, too."""
    (pair,) = comparison.of_series({"a": ended(a), "b": ended(b)}, "generations").pairs
    assert pair.method == "exact"
    assert pair.p == pytest.approx(exact_p(a, b))


def test_up_to_fifty_runs_are_tested_exactly_with_ties() -> None:
    """Ten against ten, with ties: 2 of the 184,756 ways are as extreme as the one seen."""
    apart = {"a": ended([1, 1, 2, 3, 4, 5, 6, 7, 8, 8]), "b": ended([9] * 5 + [10] * 5)}
    (pair,) = comparison.of_series(apart, "generations").pairs
    assert pair.method == "exact"
    assert pair.p == pytest.approx(2 / math.comb(20, 10))
    methods = []
    for count in (50, 51):
        values = np.arange(count) // 2
        groups = {"a": ended(values.tolist()), "b": ended((values + 3).tolist())}
        methods += [p.method for p in comparison.of_series(groups, "generations").pairs]
    assert methods == ["exact", "asymptotic"]


def test_a12_is_the_probability_that_a_run_of_the_first_group_is_better() -> None:
    (pair,) = comparison.of_series(
        {"a": ended([1, 2, 3, 4]), "b": ended([1, 5, 6, 7])}, "generations"
    ).pairs
    assert pair.a12 == (0.5 + 1 + 1 + 1) / 16
    assert pair.effect == "unclear", "of so few runs"


def test_an_effect_is_named_if_its_direction_is_clear() -> None:
    assert effect(0.8, 0.55, 0.93) == effect(0.2, 0.07, 0.45) == "large"
    assert effect(0.8, 0.45, 0.95) == "unclear"
    assert effect(0.6, 0.51, 0.68) == "small"
    assert effect(0.52, 0.49, 0.55) == "negligible"


def test_equal_groups_do_not_differ_significantly() -> None:
    found = comparison.of_series({name: ended([7] * 6) for name in "abc"}, "generations")
    assert {pair.p_holm for pair in found.pairs} == {1.0}
    assert found.families == [Family("", 1.0, "", 1.0)]


def test_many_pairs_are_corrected_after_holm() -> None:
    assert significance._holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx(
        [0.03, 0.06, 0.06, 0.02]
    )
    assert significance._holm([0.9, 0.6]) == [1.0, 1.0]


@pytest.mark.parametrize(("groups", "needed"), [(2, 4), (3, 5), (6, 6)])
def test_for_too_few_runs_the_needed_number_is_reported(groups: int, needed: int) -> None:
    """A group with one run less is not tested; the needed number can show a difference."""
    few = {str(g): ended(range(10 * g, 10 * g + needed - 1)) for g in range(groups)}
    (family,) = comparison.of_series(few, "generations").families
    assert f"with {needed} or more runs of each" in family.untested
    enough = comparison.of_series(
        {str(g): ended(range(10 * g, 10 * g + needed)) for g in range(groups)},
        "generations",
    )
    assert enough.untested == []
    assert all(pair.p_holm < LEVEL for pair in enough.pairs)


def test_very_many_groups_are_tested_over_all_only() -> None:
    """A sweep of a hundred settings has a table at once."""
    found = comparison.of_series(
        {str(g): ended(range(g, g + 6)) for g in range(100)}, "generations"
    )
    assert len(found.rows) == 100
    (family,) = found.families
    assert (found.pairs, family.untested.partition(":")[0]) == (
        [],
        "100 groups make 4950 pairs; at most 1000 are tested",
    )
    assert family.kruskal_p is not None
    assert family.kruskal_p < LEVEL


def test_without_scipy_the_table_is_shown_with_an_install_hint(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def missing(module: str, extra: str, what: str) -> None:
        raise ConfigError(
            f"{what} needs {module.partition('.')[0]}: pip install 'zswarm[{extra}]'"
        )

    monkeypatch.setattr(significance, "need", missing)
    found = comparison.of_series(
        {"a": ended(range(5)), "b": ended(range(5))}, "generations"
    )
    assert len(found.rows) == 2
    assert found.untested == [
        ("", "the test between groups needs scipy: pip install 'zswarm[plot]'")
    ]


# ---- recorded runs


def test_a_run_given_twice_counts_as_one_sample(tmp_path: Path) -> None:
    """Runs of one folder or one history are one sample: repeating a seed adds none."""
    first, again = written(tmp_path, [1, 2]), written(tmp_path, [1, 2])
    other = written(tmp_path, [1, 3], seed=2)
    runs = [Run(folder) for folder in (first, first, again, other)]
    found = compared(grouping.groups(runs))
    assert [row.runs for row in found.rows] == [2]
    assert found.notes == [
        f"{again} is omitted: its history is that of {first}, bit by bit"
    ]


def test_unfinished_runs_are_named(tmp_path: Path) -> None:
    folder = written(tmp_path, [1, 2], finished=False)
    begun = written(tmp_path, [], finished=False, seed=2)
    found = compared(grouping.groups([Run(folder), Run(begun)]))
    assert found.notes == [
        f"{folder.name} is not finished: 2 of 3 generations",
        f"{begun.name} is not finished: 0 of 1 generation",
    ]


def test_generations_under_a_budget_have_no_known_end(tmp_path: Path) -> None:
    folder = written(tmp_path, [1, 2], finished=False, stop=StopConfig(evaluations=99))
    assert compared(grouping.groups([Run(folder)])).notes == [
        f"{folder.name} is not finished: 2 generations so far"
    ]


def test_the_summary_needs_no_scipy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(significance, "need", None)
    groups = grouping.groups(
        [Run(written(tmp_path, [1, hidden], hidden=hidden)) for hidden in (1, 2)]
    )
    assert [(row.group, row.median) for row in compared(groups).rows] == [
        ("hidden 1", 1.0),
        ("hidden 2", 2.0),
    ]


# ---- curves


def test_a_curve_is_the_median_up_to_the_shortest_run() -> None:
    drawn = curves.curve("a", [run(1, 2, 3), run(3, 4), run(2, 3, 9)], "generation")
    assert drawn.x.tolist() == [1, 2]
    assert drawn.median.tolist() == [2, 3]
    assert drawn.low.tolist() == [1.5, 2.5]


def test_a_curve_over_evaluations_uses_the_latest_value_of_each_run() -> None:
    drawn = curves.curve("a", [run(1, 2, 3), run(5, 6, per_generation=75)], "evaluations")
    assert drawn.x.tolist() == [75, 100, 150]
    assert drawn.median.tolist() == [3, 3.5, 4.5]


def test_a_long_curve_keeps_its_ends_and_its_extremes() -> None:
    x = np.arange(100_000.0)
    assert len(curves.thinned(x)) <= curves.POINTS
    assert curves.thinned(x)[[0, -1]].tolist() == [0, 99_999]
    y = np.zeros(100_000)
    y[[12_345, 54_321]], y[777:2000] = (9, -9), NAN
    kept_x, kept_y = curves.envelope(x, y)
    assert len(kept_x) <= curves.POINTS
    assert {9.0, -9.0} <= set(kept_y.tolist())
    assert (np.diff(kept_x) > 0).all()


def test_a_difference_without_a_significant_pair_is_explained() -> None:
    """Kruskal-Wallis finds one, Mann-Whitney with Holm's correction does not."""
    groups = {
        "a": ended([4, 8, 9, 11, 12]),
        "b": ended([2, 7, 10, 13, 14]),
        "c": ended([0, 1, 3, 5, 6]),
    }
    found = comparison.of_series(groups, "generations")
    (family,) = found.families
    assert family.kruskal_p is not None
    assert family.kruskal_p < LEVEL < min(pair.p_holm for pair in found.pairs)
    assert significance.disagreement(family, found.pairs).startswith(
        "That some group differs is shown, but not which"
    )
    assert significance.disagreement(family, []) == ""
    clear = {
        "a": ended([10, 11, 12, 13, 14]),
        "b": ended([15, 16, 17, 18, 19]),
        "c": ended([0, 1, 2, 3, 4]),
    }
    found = comparison.of_series(clear, "generations")
    assert significance.disagreement(found.families[0], found.pairs) == ""


def test_words_give_the_p_value_and_the_corrected_one() -> None:
    """A corrected p is no probability of chance: it is named for what it is."""
    pair = Pair("a", "b", 25.0, 0.008, 0.048, 1.0, "exact", 0.6)
    words = comparison.describe(pair, "fitness")
    assert words.endswith("A12 = 1.00 (large effect), p = 0.008, Holm-adjusted p = 0.048")
    alone = comparison.describe(pair._replace(p_holm=0.008), "fitness")
    assert alone.endswith("A12 = 1.00 (large effect), p = 0.008")


@pytest.mark.parametrize(
    ("measure", "words"),
    [
        ("search", "b has a higher best fitness in search than a: A12 = 1.00"),
        ("held-out", "b is better than a: A12 = 1.00"),
        ("fitness", "b is better than a: A12 = 1.00"),
        ("collisions", "b has a higher mean of collisions than a: A12 = 1.00"),
    ],
)
def test_only_what_champions_do_on_held_out_seeds_is_called_better(
    measure: str, words: str
) -> None:
    """The best fitness in search is partly luck, and of a metric lower may be better."""
    pair = Pair("a", "b", 0.0, 0.008, 0.008, 0.0, "exact")
    assert comparison.describe(pair, measure).startswith(words)


def budgeted(trials: int, generations: int, best: float) -> Series:
    """Return a run of which each generation has 10 evaluations of some trials."""
    counts = np.arange(1.0, generations + 1)
    values = np.full(generations, best)
    return Series(values, values, 10 * counts, counts, trials=trials)


def test_groups_are_compared_after_equally_many_simulations() -> None:
    groups = {"few": [budgeted(2, 8, 1.0)], "many": [budgeted(8, 2, 2.0)]}
    found = comparison.of_series(groups, "simulations")
    assert (found.by, found.families[0].at) == ("simulations", 160.0)
    assert [(row.evaluations, row.simulations) for row in found.rows] == [
        (80.0, 160.0),
        (20.0, 160.0),
    ]
    assert comparison.effort_unit(found.rows) == "simulations"
    assert not any("equal effort" in note for note in found.notes)


@pytest.mark.parametrize(
    ("trials", "unit"), [((1, 1), "evaluations"), ((1, 4), "simulations")]
)
def test_unequal_effort_is_named_with_the_option_that_makes_it_equal(
    trials: tuple[int, int], unit: str
) -> None:
    few, many = trials
    groups = {"a": [budgeted(few, 4, 1.0)], "b": [budgeted(many, 4, 2.0)]}
    groups["b"] = [run._replace(evaluations=2 * run.evaluations) for run in groups["b"]]
    (note,) = comparison.of_series(groups, "generations").notes
    assert f"different numbers of {unit}; compare --by {unit} gives" in note


def test_a_point_of_comparison_is_refused_for_what_whole_runs_did(tmp_path: Path) -> None:
    runs = {"a": [Run(written(tmp_path, [1.0]))]}
    with pytest.raises(
        ConfigError, match=r"^--by evaluations compares the fitness in search"
    ):
        compare(runs, "evaluations", "held-out")
