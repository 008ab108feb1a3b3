"""``zswarm-ot check``: what it predicts of an experiment is what a run does."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from tests.installed_parts import playable
from tests.smallest_experiment import small
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.build import build
from zswarm.ot.cli import command
from zswarm.ot.commands.check import lines
from zswarm.ot.estimate import dry_run
from zswarm.ot.estimate.dry_run import Explanation, explain
from zswarm.ot.study import forecast
from zswarm.sims.minisim import Minisim

STUDY = """
name = "grid"
seed = 1
generations = 2
[problem]
simulator = "xor"
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
[study]
repeat = 2
[study.grid]
"problem.simulator" = ["xor"]
"optimizer.population" = [10, 20]
"""
EXAMPLES = playable(
    sorted(path.stem for path in experiment.examples_folder().glob("*.toml"))
)
SOME = {"minisim", "stadium", "xor"}  # of them, with ``make test``; others: ``make long``


def complete(name: str, *overrides: str) -> experiment.Experiment:
    path = experiment.find(name)
    return experiment.complete(experiment.load(path, overrides), str(path))


def explained(name: str, *overrides: str) -> Explanation:
    whole = complete(name, *overrides)
    return explain(whole, build(whole))


def check(*arguments: str) -> str:
    done = CliRunner().invoke(
        command, ["check", *arguments], catch_exceptions=False, env={"COLUMNS": "80"}
    )
    assert done.exit_code == 0
    return done.stdout


@pytest.mark.parametrize("islands", [1, 3])
def test_the_evaluations_are_counted_as_the_optimizer_asks_for_them(islands: int) -> None:
    overrides = ["generations=6", f"optimizer.islands={islands}", "problem.trials=2"]
    optimizer = build(complete("minisim", *overrides)).optimizer
    asked = 0
    for _ in range(6):
        count = len(optimizer.ask())
        asked += count
        optimizer.tell(np.random.default_rng(1).random(count))
    told = explained("minisim", *overrides)
    assert (told.evaluations, told.simulations) == (asked, 2 * asked)


@pytest.mark.parametrize(
    ("name", "overrides", "assessed"),
    [
        ("minisim", [], 1863),
        ("minisim", ["assessment.budget=0.5"], 9315),
        ("minisim", ["assessment.budget=0"], 0),
        ("minisim", ["assessment.budget=0", "assessment.track=10"], 500),
        ("minisim", ["generations=2", "problem.trials=2"], 0),  # less than a race takes
        ("stadium", [], 0),  # its trials do not differ
        ("minisim-duel", [], 0),
    ],
)
def test_the_simulations_of_the_assessment_are_counted(
    name: str, overrides: list[str], assessed: int
) -> None:
    assert explained(name, *overrides).assessment_simulations == assessed


def test_more_slots_than_trials_of_a_generation_make_nothing_faster() -> None:
    told = explained("stadium", "cluster.local_slots=1000")
    assert told.seconds == pytest.approx(200 * told.trial_s), (
        "a generation takes as long as a trial"
    )
    alone = explained("stadium", "cluster.local_slots=1")
    assert alone.seconds == pytest.approx(alone.evaluations * alone.trial_s)


@pytest.mark.parametrize(
    ("name", "overrides", "warning"),
    [
        ("minisim", ["generations=1"], "generations = 1"),
        ("minisim", ["problem.trials=1"], "trials = 1"),
        ("stadium", ["problem.trials=10"], "trials = 10: the trials do not differ"),
        ("minisim", ["optimizer.population=3"], "only 3 candidates"),
    ],
)
def test_likely_mistakes_are_reported(
    name: str, overrides: list[str], warning: str
) -> None:
    (told,) = explained(name, *overrides).warnings
    assert told.startswith(warning)


def test_a_record_that_does_not_fit_on_the_disk_is_reported() -> None:
    """That of all runs together, of a study."""
    for more in ("generations=1000000000", "study.repeat=10000"):
        changes = ("--set", "generations=1000000", "--set", more)
        told = json.loads(check("minisim", "--json", *changes))
        assert told["warnings"][-1].startswith("the record needs about ")
    assert not list(dry_run.too_large(1))


def test_a_study_with_a_budget_does_not_use_the_number_of_generations() -> None:
    study = ["--set", "study.repeat=2", "--set", "generations=1"]
    for count, told in ((500, []), (60, ["one generation uses the budget: random"])):
        budget = f"study.budget={{ evaluations = {count} }}"
        found = json.loads(check("minisim", "--json", *study, "--set", budget))
        assert [text.partition(" candidates")[0] for text in found["warnings"]] == told


def methods(folder: Path, more: str = "repeat = 2") -> Path:
    """Write the smallest experiment with two methods, neither of which is that of the file."""
    variants = (
        "[study.variants.Small]\n"
        'optimizer = { kind = "nnga", population = 16 }\n'
        "[study.variants.Theirs]\n"
        'optimizer = { kind = "cmaes", population = 30 }\n'
    )
    return small(folder, f"[study]\n{more}\n{variants}")


def test_a_study_is_explained_by_its_runs_and_not_by_its_file(tmp_path: Path) -> None:
    shown = " ".join(check(str(methods(tmp_path))).split())
    for words in (
        "study 2 settings, each run 2 times: 4 runs. All settings are possible",
        "experiment small: seeds 7 to 8",
        "optimizer Small: nnga Theirs: cmaes result",
        "result Small: the same on all machines, bit for bit Theirs: may differ in the last "
        "bits between machines, because of optimizer cmaes",
        "in all 4 runs, ",
    ):
        assert words in shown, words
    assert shown.count("fully-meshed: 10 inputs") == 1, "what they have in common, once"
    for phantom in ("50 candidates", "generations, seed", "each generation"):
        assert phantom not in shown, phantom
    told = json.loads(check(str(methods(tmp_path)), "--json"))
    each = [
        (one["optimizer"], one["candidates_first_generation"]) for one in told["settings"]
    ]
    assert each == [("nnga", 16), ("cmaes", 30)]
    played = sum(one["simulations"] for one in told["settings"])
    assert told["simulations"] == 2 * played
    assert "portable" not in told


def test_a_warning_about_some_settings_names_them(tmp_path: Path) -> None:
    path = methods(tmp_path)
    path.write_text(path.read_text().replace("population = 16", "population = 4"))
    few, *_ = json.loads(check(str(path), "--json"))["warnings"]
    assert few.startswith("Small: only 4 candidates in a generation")


def test_no_more_settings_are_played_than_a_moment_allows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others are expected to take as long."""
    monkeypatch.setattr(forecast, "SAMPLES_S", 0.0)
    grid = '[study.grid]\n"representation.hidden" = [0, 2, 4]\n'
    told = json.loads(check(str(small(tmp_path, grid)), "--json"))
    assert len({one["trial_s"] for one in told["settings"]}) == 1


@pytest.mark.parametrize(
    "name",
    [
        name if name in SOME else pytest.param(name, marks=pytest.mark.long)
        for name in EXAMPLES
    ],
)
def test_examples_have_no_likely_mistakes(name: str) -> None:
    """An example has no warning, whatever its genomes; the stadium has one trial for all seeds."""
    told = check(name)
    assert f"\nthe experiment is fine: zswarm-ot run {name}\n" in told
    assert " 1 outputs" not in told


def test_a_simulator_that_always_fails_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The outcomes stay NaN.
    monkeypatch.setattr(Minisim, "play_lanes", lambda *_arguments: None)
    (warning,) = explained("minisim").warnings
    assert warning.startswith("every trial that was tried failed: Minisim, trial seed ")
    assert warning.endswith(": fitness must be finite, not [nan]; nothing can evolve")
    assert check("minisim").splitlines()[-1] == (
        "when its trials no longer fail: zswarm-ot run minisim"
    )


def test_the_record_is_about_as_large_as_predicted() -> None:
    """The measured sizes of three real runs of 50 generations."""
    for name, size in (
        ("stadium", 716_800),
        ("minisim", 1_441_792),
        ("emergency-exit", 1_277_952),
    ):
        assert explained(name, "generations=50").record_bytes == pytest.approx(
            size, rel=0.25
        )


def test_check_explains_in_lines_of_the_terminals_width() -> None:
    text = check("stadium")
    assert max(map(len, text.splitlines())) <= 80
    flat = " ".join(text.split())
    for words in (
        "stadium: 200 generations, seed 1",
        "72, all driven by the same genome",
        "Robots in a room must leave",
        "10 inputs (exit_dx, exit_dy,",
        "2 hidden nodes, 2 outputs (vx, vy)",
        "60 numbers, 240 bytes",
        "50 candidates in the first generation, then 37",
        "7,413 evaluations",
        "bit for bit",
        "zswarm-ot run stadium",
    ):
        assert words in flat
    again = check("minisim", "--set", "generations=1", "--set", "cluster.connect=[]")
    assert "warning" in again
    assert again.endswith(
        "zswarm-ot run minisim --set generations=1 --set 'cluster.connect=[]'\n"
    )


def test_check_counts_the_runs_of_a_study(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    grid = '[study]\nrepeat = 5\n[study.grid]\n"optimizer.population" = [20, 40]\n'
    path.write_text(experiment.find("minisim").read_text() + grid)
    assert "2 settings, each run 5 times: 10 runs." in " ".join(check(str(path)).split())
    assert json.loads(check(str(path), "--json"))["runs"] == 10
    assert "study" not in check("minisim")


def test_check_prints_the_same_as_json() -> None:
    told: dict[str, Any] = json.loads(check("minisim", "--json"))
    assert list(told) == [*Explanation.__struct_fields__]
    assert (told["evaluations"], told["genome_numbers"]) == (1863, 56)


def test_check_looks_for_servers_where_the_experiment_does(tmp_path: Path) -> None:
    """The experiment turns multicast off, so none is found."""
    nowhere = ["--set", "cluster.multicast=false", "--servers"]
    assert json.loads(check("minisim", "--json", *nowhere))["servers"] == []
    alone = (
        "\nthe experiment is fine, but only this machine can compute it: zswarm-ot run"
    )
    assert alone in check("minisim", *nowhere)
    assert "none found in realm default multicast is off" in " ".join(
        check("minisim", *nowhere).split()
    )
    asked = check("minisim", "--set", "cluster.servers=2", "--servers", "--no-multicast")
    assert asked.endswith(
        "\nwhen 2 more matching servers can be reached: zswarm-ot run minisim --set "
        "cluster.servers=2 --no-multicast\n"
    )


def test_settings_that_differ_by_trial_are_shown() -> None:
    wide = (
        "--set",
        "problem.settings.agents={ from = 5, to = 15 }",
        "--set",
        "problem.settings.exits={ choice = [2, 5] }",
    )
    shown = " ".join(check("emergency-exit", *wide).split())
    assert (
        "ranges agents 5 to 15, exits 2 or 5: drawn for each trial from its seed" in shown
    )
    assert "robots 5 to 15, all driven by the same genome" in shown
    told = json.loads(check("emergency-exit", "--json", *wide))
    assert (told["ranges"], told["agents"], told["most_agents"]) == (
        {"agents": "5 to 15", "exits": "2 or 5"},
        5,
        15,
    )
    assert "ranges" not in check("emergency-exit").partition("optimizer")[0]
    assert json.loads(check("emergency-exit", "--json"))["ranges"] == {}


def test_ranges_make_the_trials_of_a_world_without_chance_differ() -> None:
    """One trial is then too few, and several are not too many."""
    shorter = "problem.settings.steps={ from = 20, to = 50 }"
    assert explained("stadium", shorter).warnings[0].startswith("trials = 1")
    assert explained("stadium", shorter, "problem.trials=5").warnings == []


def test_every_setting_of_a_study_is_checked(tmp_path: Path) -> None:
    """The experiment itself may be possible where one of its settings is not."""
    file = tmp_path / "grid.toml"
    file.write_text(STUDY)
    assert "2 settings, each run 2 times: 4 runs" in check(str(file))
    file.write_text(STUDY.replace('["xor"]', '["xor", "nothing"]'))
    with pytest.raises(ConfigError, match=r'study: with problem\.simulator = "nothing"'):
        check(str(file))


@pytest.mark.parametrize(
    ("changed", "result"),
    [
        ({}, "the same on all machines, bit for bit"),
        (
            {"simulator": "sheep"},
            "the same on all machines, bit for bit; simulator sheep: if it keeps the rules for "
            "own parts",
        ),
        (
            {"portable": False, "optimizer": "cmaes"},
            "may differ in the last bits between machines, because of optimizer cmaes",
        ),
        (
            {"unportable": ["sheep.py:7: np.sum ...", "sheep.py:9: @ ..."]},
            "may differ in the last bits between machines: see 2 lines of minisim below",
        ),
        (
            {"repeatable": False},
            "differs from run to run: trials of minisim do not repeat",
        ),
    ],
)
def test_equal_results_are_promised_where_all_parts_give_them(
    changed: dict[str, Any], result: str
) -> None:
    promised = msgspec.structs.replace(explained("minisim"), **changed)
    assert dict(lines(promised, complete("minisim")))["result"] == result


def test_check_shows_every_setting_of_a_study_and_refuses_an_impossible_one(
    tmp_path: Path,
) -> None:
    """The base is fine, and one combination of the grid is not."""
    path = tmp_path / "grid.toml"
    text = experiment.find("stadium").read_text()
    grid = '[study.grid]\n"optimizer.kind" = ["nnga", "cmaes"]\n"representation.kind" = '
    path.write_text(text + grid + '["fully-meshed", "neat"]\n')
    with pytest.raises(ConfigError, match=r"study: with .*cmaes.*neat: "):
        check(str(path))
    path.write_text(text + grid + '["fully-meshed", "feed-forward"]\n')
    shown = check(str(path))
    for name in ("kind nnga", "representation.hidden", "in all", "does not apply to"):
        assert name in " ".join(shown.split()), name
    assert len(json.loads(check(str(path), "--json"))["settings"]) == 4
