"""Ranges of settings: what is valid, and what is refused."""

import tomllib
from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from zswarm import experiment
from zswarm.config import ranges
from zswarm.errors import ConfigError


class Wind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    speed: Annotated[float, Meta(ge=0, le=10)] = 1.0


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    robots: Annotated[int, Meta(ge=1, le=9)] = 2
    mass: Annotated[float, Meta(gt=0)] = 1.0
    gait: Literal["walk", "run"] = "walk"
    wind: Wind = Wind()
    free: dict[str, Any] = {}


def test_numbers_in_ranges_get_the_type_of_the_setting() -> None:
    """Nested tables are covered, too. A choice may have values of any type. Defaults are added."""
    given = {
        "mass": {"from": 1, "to": 2},
        "robots": {"from": 1, "to": 9},
        "gait": {"choice": ["run", "walk", "run"]},
        "wind": {"speed": {"from": 0, "to": 10}},
        "free": {"gravity": {"from": 1, "to": 2.5}, "other": {"choice": [[1], {"a": 1}]}},
    }
    whole = ranges.complete(given, Settings, "it")
    assert msgspec.json.encode(whole, order="sorted") == msgspec.json.encode(
        {
            **given,
            "mass": {"from": 1.0, "to": 2.0},
            "wind": {"speed": {"from": 0.0, "to": 10.0}},
        },
        order="sorted",
    )
    assert ranges.complete(whole, Settings, "it") == whole
    assert ranges.complete({}, Settings, "it") == msgspec.to_builtins(Settings())


@pytest.mark.parametrize(
    ("written", "line"),
    [
        ("robots = { from = 0, to = 3 }", "robots: expected int >= 1 (in its range: 0)"),
        (
            "robots = { from = 3, to = 10 }",
            "robots: expected int <= 9 (in its range: 10)",
        ),
        (
            "robots = { from = 1.5, to = 3 }",
            "robots: expected int, got float (in its range: 1.5)",
        ),
        ("robots = { from = 3, to = 2 }", "robots: from 3 must not be above to 2"),
        (
            "robots = { from = 3, too = 4 }",
            "robots: expected { from = 5, to = 15 } or { choice = [5, 10] }, or one value",
        ),
        (
            "robots = { from = 3 }",
            "robots: expected { from = 5, to = 15 } or { choice = [5, 10] }, or one value",
        ),
        (
            "robots = { choice = [] }",
            "robots: choice: expected a list of 1 to 100 values, such as [5, 10]",
        ),
        (
            "robots = { choice = 3 }",
            "robots: choice: expected a list of 1 to 100 values, such as [5, 10]",
        ),
        (
            "robots = { choice = [3, '4'] }",
            "robots: expected int, got str (in its range: 4)",
        ),
        (
            "robots = { choice = [3, { from = 1, to = 2 }] }",
            'robots: expected int, got object (in its range: {"from":1,"to":2})',
        ),
        ("mass = { from = 0, to = 1 }", "mass: expected float > 0.0 (in its range: 0)"),
        (
            "mass = { from = 1, to = inf }",
            "mass: to: expected a finite number, not inf; other values: choice = [...]",
        ),
        (
            "mass = { from = nan, to = 1 }",
            "mass: from: expected a finite number, not nan; other values: choice = [...]",
        ),
        (
            "mass = { from = true, to = 2 }",
            "mass: from: expected a finite number, not True; other values: choice = [...]",
        ),
        (
            "free.a = { from = -1e308, to = 1e307 }",
            "free.a: from: expected a finite number, not -1e+308; other values: choice = [...]",
        ),
        (
            "gait = { from = 'run', to = 'walk' }",
            "gait: from: expected a finite number, not 'run'; other values: choice = [...]",
        ),
        (
            "gait = { choice = ['walk', 'rnu'] }",
            "gait: expected walk or run, not 'rnu' (did you mean 'run'?) (in its range: rnu)",
        ),
        (
            "wind.speed = { from = 1, to = 11 }",
            "wind.speed: expected float <= 10.0 (in its range: 11)",
        ),
        (
            "wnid.speed = { from = 1, to = 11 }",
            "unknown key 'wnid' (did you mean 'wind'?); known are: robots, mass, gait, wind, free",
        ),
    ],
)
def test_an_invalid_range_is_refused_in_one_line(written: str, line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        ranges.complete(tomllib.loads(written), Settings, "it")
    assert str(caught.value) == f"it: {line}"


def test_a_range_in_a_file_is_refused_with_its_line(tmp_path: Any) -> None:
    path = tmp_path / "my.toml"
    text = experiment.find("emergency-exit").read_text()
    path.write_text(text.replace("agents = 10", "agents = { from = 0, to = 3 }"))
    assert "{ from" in path.read_text()
    number = next(
        at for at, line in enumerate(path.read_text().splitlines(), 1) if "{ from" in line
    )
    with pytest.raises(ConfigError) as caught:
        experiment.complete(experiment.load(path), str(path))
    assert (
        str(caught.value)
        == f"{path}:{number}: problem.settings: agents: expected int >= 1 (in its range: 0)"
    )


def test_ranges_outside_of_the_problem_are_refused() -> None:
    with pytest.raises(
        ConfigError, match="representation: hidden: expected int, got object"
    ):
        loaded("representation.hidden={ from = 1, to = 3 }")


def loaded(*overrides: str) -> experiment.Experiment:
    path = experiment.find("emergency-exit")
    return experiment.complete(experiment.load(path, overrides), "it")


def test_a_range_is_set_changed_and_fixed_from_the_command_line() -> None:
    wide = "problem.settings.agents={ from = 5, to = 15 }"
    assert loaded(wide).problem.settings["agents"] == {"from": 5, "to": 15}
    assert loaded(wide, "problem.settings.agents.to=20").problem.settings["agents"] == {
        "from": 5,
        "to": 20,
    }
    assert loaded(wide, "problem.settings.agents=7").problem.settings["agents"] == 7


def test_a_complete_experiment_with_ranges_round_trips() -> None:
    whole = loaded(
        "problem.settings.agents={ from = 5, to = 15 }",
        "problem.settings.exits={ choice = [2, 4] }",
    )
    assert experiment.check(tomllib.loads(experiment.to_toml(whole)), "it") == whole


def test_a_study_may_vary_ranges_and_values() -> None:
    """Grids and lists take them; other tables in a list are paths of keys."""
    values = [10, {"from": 5, "to": 15}, {"choice": [5, 15]}]
    mapping = experiment.to_mapping(loaded())
    for study in (
        {"grid": {"problem.settings.agents": values}},
        {"list": [{"problem.settings.agents": value} for value in values]},
        {"list": [{"problem": {"settings": {"agents": value}}} for value in values]},
    ):
        whole = experiment.complete(
            experiment.check({**mapping, "study": study}, "it"), "it"
        )
        told = [
            variant.experiment.problem.settings["agents"]
            for variant in experiment.variants(whole, "it")
        ]
        assert told == values
