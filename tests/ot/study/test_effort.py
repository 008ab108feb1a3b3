"""What a study takes is known before it starts, and what makes its settings unequal is named."""

from pathlib import Path

from tests.smallest_experiment import small
from zswarm import experiment
from zswarm.ot.study import effort
from zswarm.ot.study.effort_table import as_objects, total
from zswarm.ot.study.study import checked_plan

GRID = """
population = 30
[study]
repeat = 2
[study.grid]
optimizer = [{ kind = "nnga", population = 30, label = "NNGA" },
             { kind = "cmaes", population = 10, label = "CMA-ES" }]
representation = [{ kind = "fully-meshed", label = "meshed" },
                  { kind = "feed-forward", label = "layers" }]
"""


def written(
    folder: Path, more: str, meshed: str = ""
) -> tuple[list[str], list[effort.Cell]]:
    path = small(folder, more)
    path.write_text(
        path.read_text().replace('"fully-meshed"\n', f'"fully-meshed"\n{meshed}\n', 1)
    )
    loaded = experiment.load(path)
    _, cells = checked_plan(experiment.complete(loaded, path.name), path.name, {})
    return list(effort.warnings(loaded, cells)), cells


def test_a_setting_that_does_not_reach_all_is_named_once_with_those(
    tmp_path: Path,
) -> None:
    warnings, _ = written(tmp_path, GRID, "hidden = 3")
    hidden = [text for text in warnings if "hidden" in text]
    assert hidden == [
        "representation.hidden = 3 does not apply to NNGA, meshed; CMA-ES, meshed: "
        "fully-meshed has hidden = 2 there",
        "representation.hidden = 3 does not apply to NNGA, layers; CMA-ES, layers: "
        "feed-forward has hidden = [2, 2] there",
    ]
    assert not any("population" in text for text in warnings), "each setting has its own"


def test_unequal_work_is_named_and_a_budget_removes_it(tmp_path: Path) -> None:
    warnings, _ = written(tmp_path, GRID)
    assert "from 30 to 74 simulations a run" in warnings[-1]
    advice = warnings[-1].partition("for example, ")[2]
    assert advice.startswith("budget = { evaluations = ")
    assert written(tmp_path, GRID.replace("repeat = 2", f"repeat = 2\n{advice}"))[0] == []
    equal = GRID.replace("repeat = 2", "repeat = 2\nbudget = { evaluations = 300 }")
    warnings, cells = written(tmp_path, equal)
    assert warnings == []
    assert {cell.effort.evaluations for cell in cells} <= {*range(290, 301)}
    assert total(cells, 2).startswith("8 runs, ")
    known = as_objects(cells)
    assert known[0]["setting"] == "NNGA, meshed"
    assert known[2]["differing"]["optimizer"] == "cmaes"


def test_a_budget_below_a_first_generation_is_named_with_what_is_used(
    tmp_path: Path,
) -> None:
    """Better advice follows: the same budget would not help."""
    small_budget = GRID.replace("repeat = 2", "repeat = 2\nbudget = { evaluations = 25 }")
    exceeded, unequal = written(tmp_path, small_budget)[0]
    assert exceeded == (
        "the budget of 25 evaluations is less than a first generation, which is played whole: "
        "NNGA, meshed uses 30 (5 too many); NNGA, layers uses 30 (5 too many)"
    )
    advice = unequal.partition("for example, ")[2]
    assert written(tmp_path, GRID.replace("repeat = 2", f"repeat = 2\n{advice}"))[0] == []


def test_no_budget_is_advised_where_none_is_equal(tmp_path: Path) -> None:
    """The first generation of a setting is larger than any budget may be."""
    _, (one, *others) = written(tmp_path, GRID)
    most = 2 * 10**9
    huge = {"first": most, "first_simulations": most, "simulations": most}
    one = one._replace(effort=one.effort._replace(**huge))
    *_, text = effort.warnings(one.experiment, [one, *others])
    assert text.endswith(" to 2,000,000,000 simulations a run")


def test_a_run_with_a_budget_has_room_for_generations(tmp_path: Path) -> None:
    """How many candidates a generation has may change on the way."""
    text = GRID.replace("repeat = 2", "repeat = 2\nbudget = { simulations = 300 }")
    loaded = experiment.load(small(tmp_path, text))
    planned, cells = checked_plan(experiment.complete(loaded, "x"), "x", {})
    for one, cell in zip(planned[: len(cells)], cells, strict=True):
        assert cell.effort.generations < one.experiment.generations <= 300
        assert one.experiment.stop.simulations == 300


def test_settings_with_unequal_trials_are_advised_a_budget_in_simulations(
    tmp_path: Path,
) -> None:
    text = f'{GRID}"problem.trials" = [2, 8]\n'
    in_evaluations = text.replace("[study]", "[study]\nbudget = { evaluations = 300 }")
    (warning,) = written(tmp_path, in_evaluations)[0]
    advice = warning.partition("for example, ")[2]
    assert advice.startswith("budget = { simulations = ")
    followed = text.replace("[study]", f"[study]\n{advice}")
    assert written(tmp_path, followed)[0] == []
    in_simulations = text.replace("[study]", "[study]\nbudget = { simulations = 2000 }")
    assert written(tmp_path, in_simulations)[0] == []
