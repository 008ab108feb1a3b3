"""Answers about a run."""

from pathlib import Path

import pytest

from tests.ot.invented_record import written
from zswarm.errors import ConfigError
from zswarm.ot.dashboard import endpoints
from zswarm.ot.dashboard.run_index import RunIndex
from zswarm.ot.record.reader import Run


def test_an_address_must_ask_for_a_number(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1.0]))
    for text in (
        "",
        "-1",
        "1.5",
        "x",
        "1" * 40,
        "0" * 20 + "9" * 30,
        "1" * 5000,
        "\u0663",
    ):
        with pytest.raises(ConfigError, match="generation: expected a whole number"):
            endpoints.BY_NAME["generation"](run, {"generation": text})
    with pytest.raises(
        LookupError, match="generation 8 has no candidate 0; the record has 1 generations"
    ):
        endpoints.candidate(run, {"generation": "7", "candidate": "0"})


def test_a_candidate_has_its_network_and_its_trials(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1.0]))
    found = endpoints.candidate(run, {"generation": "0", "candidate": "2"})
    assert [node["kind"] for node in found["graph"]["nodes"]] == ["input"] * 10 + [
        "hidden"
    ] * 2 + ["output"] * 2
    assert len(found["graph"]["edges"]) == found["edges"] == 4 * 14
    assert (found["genes"], len(found["numbers"])) == (60, 60)
    assert [trial["server"] for trial in found["trials"]] == ["lab-1-0123abcd"]


def test_curves_of_several_runs_come_in_one_answer(tmp_path: Path) -> None:
    """Runs that cannot be read are left out: the list of runs says why."""
    written(tmp_path, [1.0, 2.0])
    damaged = written(tmp_path, [1.0]) / "run.sqlite"
    damaged.write_bytes(damaged.read_bytes()[:100])
    query = {"runs": "stadium stadium-2 none", "points": "2"}
    found = endpoints.curves(RunIndex([tmp_path]), query)
    assert list(found) == ["stadium"]
    assert found["stadium"]["curve"]["best"] == [1.0, 2.0]
    assert found["stadium"]["settings"]["representation.hidden"] == "2"


def test_settings_explain_the_fitness_of_runs(tmp_path: Path) -> None:
    for hidden, best in ((1, 1.0), (1, 1.5), (2, 3.0), (2, 3.5)):
        written(tmp_path, [best], hidden=hidden)
    runs = " ".join(row["id"] for row in RunIndex([tmp_path]).rows())
    found = endpoints.explained(RunIndex([tmp_path]), {"runs": runs})
    (effect,) = found["effects"]
    assert effect["settings"] == ("representation.hidden",)
    assert effect["eta2"] == pytest.approx(4.0 / 4.25)
    assert endpoints.explained(RunIndex([tmp_path]), {"runs": "stadium"})["why"]
