"""The settings on a report's page: all that influence the result, of each group of runs."""

import re
from pathlib import Path

import msgspec

from tests.ot.invented_record import EXPERIMENT, written
from zswarm import experiment
from zswarm.config.sections import BudgetConfig, PartConfig, StopConfig, StudyConfig
from zswarm.ot.analysis import grouping
from zswarm.ot.record import stopping
from zswarm.ot.record.folder import EXPERIMENT as FILE
from zswarm.ot.record.reader import Run
from zswarm.ot.record.runs import runs_below
from zswarm.ot.record.writer import Record
from zswarm.ot.report import report
from zswarm.ot.report.settings import (
    NO_LIMIT,
    SettingRow,
    contrast,
    rows_of,
    settings_rows,
    study_rows,
)

BUDGET = StopConfig(evaluations=7)
USED = "the budget is used: 6 of 7 evaluations"
RANDOM = PartConfig(kind="random", settings={"population": 40})


def ended_early(out: Path, optimizer: PartConfig, seed: int = 1) -> Run:
    """Write a run that its budget ended after two of 40 generations."""
    folder = written(out, [1, 2], optimizer=optimizer, stop=BUDGET, seed=seed)
    file, history = folder / FILE, Run(folder).history_hash
    text = re.sub("^generations = .*", "generations = 40", file.read_text(), flags=re.M)
    file.write_text(text)
    with Record.open(folder)[0] as record:
        record.set_meta(stopping.STOPPED, stopping.entry(BUDGET, USED))
        record.set_meta("history_hash", history)
    return Run(folder)


def by_key(rows: list[SettingRow]) -> dict[str, tuple[str, str | None]]:
    return {row.key: (row.value, row.default) for row in rows}


def test_settings_that_are_no_defaults_are_marked(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1], hidden=7))
    changed = {
        row.key: (row.value, row.default)
        for row in settings_rows(run.experiment)
        if row.default is not None
    }
    assert changed == {
        "representation.hidden": ("7", "2"),
        "problem.settings.field": ("stadium", "random"),
    }


def test_settings_without_effect_are_left_out_unless_they_were_changed(
    tmp_path: Path,
) -> None:
    """The stadium has its own robots, exits and size."""
    stadium = Run(written(tmp_path, [1], settings={"exits": 9})).experiment
    rows = {
        row.key.removeprefix("problem.settings."): (row.value, row.default)
        for row in settings_rows(stadium)
        if row.key.startswith("problem.settings.")
    }
    steps = str(stadium.problem.settings["steps"])
    assert rows["steps"][0] == steps
    assert rows == {
        "field": ("stadium", "random"),
        "steps": rows["steps"],
        "exits": ("9 (not used)", "5"),
    }
    drawn = Run(written(tmp_path, [1], settings={"field": "random"})).experiment
    keys = [row.key for row in settings_rows(drawn)]
    assert {"problem.settings.agents", "problem.settings.seed"} <= {*keys}


def test_a_ranking_is_shown_unless_it_is_the_default(tmp_path: Path) -> None:
    complete = Run(written(tmp_path, [1])).experiment
    keys = [row.key for row in settings_rows(complete)]
    assert not [key for key in keys if key.startswith("ranking")]
    ranking = PartConfig(
        kind="swiss", settings={"all_sides": False, "rounds": 5, "win": 2, "tie": 1}
    )
    rows = settings_rows(msgspec.structs.replace(complete, ranking=ranking))
    assert [row for row in rows if row.key.startswith("ranking")] == [
        ("ranking.kind", "swiss", "absolute"),
        ("ranking.all_sides", "false", "true"),
        ("ranking.rounds", "5", "0"),
        ("ranking.win", "2", None),
        ("ranking.tie", "1", None),
    ]


def test_every_section_that_influences_the_result_is_shown(tmp_path: Path) -> None:
    """So is ``[cluster]``; ``[record]`` and ``[study]`` of a run take no part."""
    rows = rows_of([ended_early(tmp_path, EXPERIMENT.optimizer)])
    sections = dict.fromkeys(row.key.partition(".")[0] for row in rows)
    everything = {*experiment.to_mapping(EXPERIMENT), "stop"}
    assert everything - {*sections} == {"record", "ranking"}, "absolute is the default"
    known = by_key(rows)
    assert known["stop.evaluations"] == ("7", NO_LIMIT)
    assert "stop.stagnation" not in known
    assert known["assessment.budget"] == ("auto", None)


def test_generations_are_those_that_there_were(tmp_path: Path) -> None:
    whole = Run(written(tmp_path, [1, 2, 3]))
    assert by_key(rows_of([whole]))["generations"] == ("3", None)
    stopped = Run(written(tmp_path, [1, 2, 3], finished=False))
    assert by_key(rows_of([stopped]))["generations"][0] == "3 of at most 4: not finished"
    early = ended_early(tmp_path, EXPERIMENT.optimizer)
    assert by_key(rows_of([early]))["generations"][0] == f"2 of at most 40: {USED}"
    several = by_key(rows_of([whole, early]))
    assert several["generations"][0] == "2 to 3 of at most 3 to 40: the budget is used"


def test_repeats_are_one_column_with_all_their_values(tmp_path: Path) -> None:
    runs = [Run(written(tmp_path, [1], seed=seed)) for seed in (1, 2, 3)]
    assert by_key(rows_of(runs))["seed"] == ("1 to 3", None)
    assert by_key(rows_of([runs[2], runs[0]]))["seed"] == ("1, 3", None)
    other = Run(written(tmp_path, [1], stop=StopConfig(stagnation=5)))
    longer = Run(written(tmp_path, [1], stop=StopConfig(stagnation=9)))
    assert by_key(rows_of([other, longer]))["stop.stagnation"] == ("5 or 9", NO_LIMIT)


def test_a_study_shows_its_repeats_and_its_budget() -> None:
    study = StudyConfig(repeat=5, budget=BudgetConfig(simulations=1000))
    complete = msgspec.structs.replace(EXPERIMENT, study=study)
    assert by_key(study_rows(complete)) == {
        "study.repeat": ("5", "1"),
        "study.budget.simulations": ("1000", NO_LIMIT),
    }
    assert by_key(study_rows(EXPERIMENT)) == {"study.repeat": ("1", None)}


def test_the_settings_of_each_group_are_shown(tmp_path: Path) -> None:
    runs = [
        ended_early(tmp_path, optimizer, seed)
        for optimizer in (EXPERIMENT.optimizer, RANDOM)
        for seed in (1, 2)
    ]
    groups = grouping.groups(runs)
    shared, differing = contrast({each: rows_of(groups[each]) for each in groups})
    assert list(groups) == ["nnga", "random"]
    cells = {key: [cell and cell.value for cell in row] for key, row in differing.items()}
    assert cells["optimizer.kind"] == ["nnga", "random"]
    assert cells["optimizer.severity"] == ["0.3", None]
    assert cells["optimizer.population"] == ["50", "40"]
    assert {key.partition(".")[0] for key in differing} == {"optimizer"}
    assert {*by_key(shared)} & {*differing} == set()
    assert {*by_key(shared)} | {*differing} == {
        row.key for members in groups.values() for row in rows_of(members)
    }
    assert by_key(shared)["stop.evaluations"] == ("7", NO_LIMIT)


def test_groups_are_columns_and_many_groups_are_rows(tmp_path: Path) -> None:
    for hidden in range(1, report.MAX_COLUMNS + 1):
        written(tmp_path, [hidden], hidden=hidden)
    key = "<code>representation.hidden</code></th>"
    columns = report.of_study(tmp_path, runs_below([tmp_path]))
    assert '<th scope="col">hidden 1</th><th scope="col">hidden 2</th>' in columns
    assert f'<th scope="row" class="keep">{key}' in columns
    written(tmp_path, [9], hidden=9)
    rows = report.of_study(tmp_path, runs_below([tmp_path]))
    assert f'<th scope="col">{key}' in rows
    row = (
        r'<th scope="row">hidden 9</th><td>\s*<mark>9</mark> <span class="dim">default 2'
    )
    assert re.search(row, rows)
