"""``[study]`` in an experiment file: its variants in order, and mistakes in it."""

import re
from pathlib import Path
from typing import Any

import pytest

from tests.smallest_experiment import SMALL, small, study
from zswarm import experiment
from zswarm.config.sections import StudyConfig
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.experiment import complete, load, to_toml, variants


def settings(folder: Path, text: str) -> list[dict[str, Any]]:
    return [variant.settings for variant in variants(study(folder, text), "small.toml")]


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(ConfigError) as refused:
        study(folder, text)
    assert "\n" not in str(refused.value)
    return str(refused.value).removeprefix(f"{folder}/")


def test_a_file_without_a_study_has_one_variant(tmp_path: Path) -> None:
    alone = study(tmp_path, "")
    (variant,) = variants(alone, "small.toml")
    assert variant == ({}, alone)
    assert alone.study == StudyConfig()
    assert "study" not in to_toml(alone)


@pytest.mark.parametrize(
    "text",
    [
        "[study]\nrepeat = 2",
        "[study]\nbudget = { evaluations = 100 }",
        "[study.variants.Large]\noptimizer = { population = 100 }",
    ],
)
def test_repeats_a_budget_or_a_variant_ask_for_the_runs_of_a_study(
    tmp_path: Path, text: str
) -> None:
    assert study(tmp_path, text).study.asks_for_runs()
    assert not study(tmp_path, "[study]\nat_once = 1").study.asks_for_runs()


def test_a_grid_has_every_combination_with_the_last_key_fastest(tmp_path: Path) -> None:
    text = '[study.grid]\n"optimizer.population" = [50, 100]\n"representation.hidden" = [1, 2]'
    made = variants(study(tmp_path, text), "small.toml")
    assert [tuple(variant.settings.values()) for variant in made] == [
        (50, 1),
        (50, 2),
        (100, 1),
        (100, 2),
    ]
    assert [variant.experiment.optimizer.settings["population"] for variant in made] == [
        50,
        50,
        100,
        100,
    ]
    assert [variant.experiment.representation.settings["hidden"] for variant in made] == [
        1,
        2,
        1,
        2,
    ]
    assert all(variant.experiment.study == StudyConfig() for variant in made)


def test_a_list_may_contain_the_unchanged_experiment(tmp_path: Path) -> None:
    text = (
        '[[study.list]]\n[[study.list]]\n"representation.hidden" = 5\n"generations" = 9'
    )
    made = variants(study(tmp_path, text), "small.toml")
    assert [variant.settings for variant in made] == [
        {},
        {"representation.hidden": 5, "generations": 9},
    ]
    assert [variant.experiment.generations for variant in made] == [3, 9]


def test_a_nested_table_equals_a_dotted_path(tmp_path: Path) -> None:
    assert settings(tmp_path, "[study.grid]\noptimizer.population = [5, 6]") == [
        {"optimizer.population": 5},
        {"optimizer.population": 6},
    ]
    assert settings(
        tmp_path, "[[study.list]]\n[study.list.problem.settings]\nagents = 3"
    ) == [{"problem.settings.agents": 3}]


def test_a_study_round_trips_with_the_same_variants(tmp_path: Path) -> None:
    for text in (
        '[study]\nrepeat = 3\n[study.grid]\n"problem.settings.agents" = [1, 2]',
        "[[study.list]]\n[[study.list]]\ngenerations=9",
    ):
        whole = study(tmp_path, text)
        written = tmp_path / "written.toml"
        written.write_text(to_toml(whole))
        again = complete(load(written), "written.toml")
        assert again == whole
        assert variants(again, "x") == variants(whole, "x")


def test_a_variant_of_another_kind_has_the_defaults_of_that_kind(tmp_path: Path) -> None:
    """A file that writes out every default has the same variants as the original."""
    other = '"problem.simulator" = "minisim"\n"problem.settings.robots" = 2'
    text = f"[problem.settings]\nagents = 3\n[[study.list]]\n{other}\n[[study.list]]"
    made = variants(study(tmp_path, text), "small.toml")
    assert made[0].experiment.problem.settings["robots"] == 2
    assert "agents" not in made[0].experiment.problem.settings
    assert made[1].experiment.problem.settings["agents"] == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[study]\nrepeat = 0", "study.repeat: expected int >= 1"),
        ("[study]\nrepeat = 10001", "study.repeat: expected int <= 10000"),
        ("[study]\nat_once = -1", "study.at_once: expected int >= 0"),
        (
            "[study]\nrepeats = 2",
            "study: unknown key 'repeats' (did you mean 'repeat'?); known are: repeat, ",
        ),
        (
            "[study]\nbudget = { evaluation = 3 }",
            "study: budget: unknown key 'evaluation' (did you mean 'evaluations'?); known are: ",
        ),
        ("study = 3", ""),
        ("[study]\nlist = 3", "study.list: expected array, got int"),
        ("[study]\nlist = [3]", "study.list[0]: expected object, got int"),
        ("[study]\ngrid = [3]", "study.grid: expected object, got array"),
        ("[study.grid]\ngenerations = 3", "study.grid[...]: expected array, got int"),
        (
            "[study.grid]\ngenerations = []",
            "study.grid: generations: expected a list of at least one value",
        ),
        (
            "[study.grid]\ngenerations = [3]\n[[study.list]]\ngenerations = 4",
            "study: expected a grid or variants, or a list of settings, not both",
        ),
        (
            "[study.grid]\nseed = [1, 2]",
            "study.grid: seed: the runs of a setting have the seeds seed, seed + 1, ...; give ",
        ),
        (
            "[[study.list]]\nname = 'x'",
            "study.list: 'name': expected generations, or a path below problem, ",
        ),
        (
            "[study.grid]\n'cluster.realm' = ['a']",
            "study.grid: 'cluster.realm': expected generations, or a path ",
        ),
        (
            "[study.grid]\n'study.repeat' = [1]",
            "study.grid: 'study.repeat': expected generations, or a path ",
        ),
        (
            "[study.grid]\n'optimiser.population' = [1]",
            "study.grid: 'optimiser.population' (did you mean 'optimizer'?)",
        ),
        (
            "[study.grid]\n'optimizer..x' = [1]",
            "study.grid: 'optimizer..x': expected generations, or a path ",
        ),
        ("[study.grid]\n'' = [1]", "study.grid: '': expected generations, or a path "),
        (
            '[study.grid]\n"optimizer.\\u001b[2J." = [1]',
            "study.grid: 'optimizer.\\x1b[2J.': expected generations, ",
        ),
        (
            "[study.grid]\n'optimizer.population' = [50]\noptimizer.population = [60]",
            "study.grid: optimizer.population is given twice",
        ),
        ("[study.grid]\n" + "a." * 50 + "a = [1]", "study.grid: nested too deep"),
        (
            "[study.grid]\n'optimizer.populatoin' = [50, 100]",
            "study: with optimizer.populatoin = 50: optimizer: unknown key 'populatoin' (did you ",
        ),
        (
            "[study.grid]\n'representation.hidden' = [1, 2, 3, 4, 5, 6, '7']",
            'study: with representation.hidden = "7": representation: hidden: expected int, got ',
        ),
        (
            "[study.grid]\n'problem.trials' = [1, 0]",
            "study: with problem.trials = 0: problem.trials: expected int >= 1",
        ),
        (
            "[study.grid]\n'generations' = [1, 1]",
            "study: the same setting twice: generations = 1, and generations = 1",
        ),
        (
            "[[study.list]]\n[[study.list]]\n'optimizer.population' = 50",
            "study: the same setting twice: nothing changed, and optimizer.population = 50",
        ),
        (
            "[study]\nrepeat = 5001\n[study.grid]\ngenerations = [1, 2]",
            "study: 10,002 runs; expected 10,000 at most",
        ),
        (
            "[study.grid]\n'optimizer' = [1]",
            "study: with optimizer = 1: optimizer: expected object, got int",
        ),
        (
            "[study.grid]\n'problem.trials.x' = [1]",
            "study: with problem.trials.x = 1: trials is not a table",
        ),
    ],
)
def test_an_impossible_study_is_refused_in_one_line(
    tmp_path: Path, text: str, message: str
) -> None:
    if text == "study = 3":
        path = tmp_path / "small.toml"
        path.write_text(text + SMALL)
        with pytest.raises(ConfigError, match=r"study: expected object, got int"):
            load(path)
        return
    refused = re.sub(r"^small.toml:(\d+:)? ", "", refusal(tmp_path, text))
    assert refused.startswith(message)


def test_an_unknown_kind_in_a_late_setting_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        UnknownPlugin,
        match=r"study: with optimizer.kind = \"ngna\": optimizer.kind: unknown optimizer 'ngna'",
    ):
        study(tmp_path, '[study.grid]\n"optimizer.kind" = ["nnga", "ngna"]')


def test_seeds_beyond_the_last_one_are_refused(tmp_path: Path) -> None:
    path = small(tmp_path)
    last = experiment.LAST_SEED
    assert load(path, [f"seed={last - 2}", "study.repeat=3"]).study.repeat == 3
    with pytest.raises(
        ConfigError,
        match=r"study: repeat: expected seed \+ repeat - 1, the last seed, to be",
    ):
        load(path, [f"seed={last - 2}", "study.repeat=4"])


def test_long_values_are_shortened_in_errors(tmp_path: Path) -> None:
    assert (
        len(refusal(tmp_path, f"[study.grid]\n'problem.trials' = ['{'x' * 5000}']")) < 200
    )


def test_options_set_a_study(tmp_path: Path) -> None:
    path = small(tmp_path)
    assert (
        load(
            path, ["study.grid.optimizer.population=[5, 6]", "study.repeat=2"]
        ).study.runs()
        == 4
    )


# ---- named settings, and a budget


def test_variants_are_named_and_combined_with_the_grid(tmp_path: Path) -> None:
    text = """
[study.grid]
"problem.trials" = [1, 2]
[study.variants.small]
representation = { kind = "feed-forward", layers = [2] }
[study.variants."NNGA 60"]
optimizer.population = 60
"""
    text = text.replace(", layers = [2]", "")
    made = variants(study(tmp_path, text), "small.toml")
    assert [variant.experiment.label for variant in made] == [
        "small, trials 1",
        "small, trials 2",
        "NNGA 60, trials 1",
        "NNGA 60, trials 2",
    ]
    assert [variant.experiment.representation.kind for variant in made] == [
        *["feed-forward"] * 2,
        *["fully-meshed"] * 2,
    ]
    assert made[2].settings == {"optimizer.population": 60, "problem.trials": 1}


def test_a_grids_tables_replace_whole_ones_and_may_have_labels(tmp_path: Path) -> None:
    text = """
population = 70
[study.grid]
optimizer = [{ kind = "nnga" }, { kind = "cmaes", population = 9, label = "CMA-ES" }]
"""
    first, second = variants(study(tmp_path, text), "small.toml")
    assert (first.experiment.label, second.experiment.label) == ("", "CMA-ES")
    assert [
        one.experiment.optimizer.settings["population"] for one in (first, second)
    ] == [
        50,
        9,
    ]
    assert second.settings == {"optimizer": {"kind": "cmaes", "population": 9}}


def test_a_budget_is_every_settings_limit(tmp_path: Path) -> None:
    text = '[study]\nbudget = { evaluations = 900 }\n[study.grid]\n"optimizer.population" = [5, 9]'
    whole = study(tmp_path, text)
    assert [one.experiment.stop.evaluations for one in variants(whole, "x")] == [900, 900]
    written = tmp_path / "written.toml"
    written.write_text(to_toml(whole))
    assert complete(load(written), "written.toml") == whole


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[study]\nbudget = { evaluations = 3, simulations = 4 }",
            "expected evaluations or simulations, not both",
        ),
        (
            "[study.variants.a]\n'cluster.realm' = 'x'",
            "study.variants.a: 'cluster.realm': ",
        ),
        (
            "[study.grid]\ngenerations=[3]\n[study.variants.a]\ngenerations = 4",
            "study: generations: expected in the grid or the variants only",
        ),
        (
            "[study.grid]\noptimizer=[{kind='nnga',label='a'},{kind='cmaes',label='a'}]",
            "study: two settings have the label 'a'",
        ),
        ('[study.variants."\\u0007"]\ngenerations = 4', "expected a printable name"),
        ("[stop]\nfitnes = 3", "stop: unknown key 'fitnes' (did you mean 'fitness'?)"),
    ],
)
def test_an_impossible_variant_or_budget_is_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    assert message in refusal(tmp_path, text)
