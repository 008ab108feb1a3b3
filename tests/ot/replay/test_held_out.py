"""Champions on held-out seeds, also if nothing depends on the seed."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from tests.ot.invented_record import written
from zswarm.champion.controller import load_controller
from zswarm.errors import ConfigError
from zswarm.ot.cli import command
from zswarm.ot.record.reader import Run
from zswarm.ot.replay.held_out import HeldOutResult, other_code
from zswarm.plugins.version_hash import version_hash
from zswarm.sims.emergency_exit import EmergencyExit

ALIKE = "every trial was the same: nothing in them depends on the seed"


def evaluate(folder: Path, *arguments: str) -> str:
    done = CliRunner().invoke(
        command,
        ["evaluate", str(folder), *arguments],
        catch_exceptions=False,
        env={"COLUMNS": "80"},
    )
    assert done.exit_code == 0
    return done.stdout


def test_problems_that_do_not_depend_on_the_seed_are_reported(tmp_path: Path) -> None:
    """The stadium is reported; a single trial and random fields are not."""
    folder = written(tmp_path, [1])
    told = evaluate(folder, "--trials", "3")
    assert ALIKE in told
    assert "3 trials" in " ".join(told.split())
    assert "unseen" not in told
    assert ALIKE not in evaluate(folder, "--trials", "1")
    random = msgspec.structs.replace(
        load_controller(folder), simulator_settings={"field": "random"}
    )
    (tmp_path / "random.zsc").write_bytes(msgspec.msgpack.encode(random))
    told = evaluate(tmp_path / "random.zsc", "--trials", "20")
    assert "20 held-out trials" in " ".join(told.split())
    assert ALIKE not in told


def test_a_metric_may_have_any_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a name replaces no other number in the JSON output."""
    folder = written(tmp_path, [1])
    plain = json.loads(evaluate(folder, "--trials", "2", "--json"))
    monkeypatch.setattr(EmergencyExit, "metrics", ("mean", "trials"))
    renamed = json.loads(evaluate(folder, "--trials", "2", "--json"))
    assert set(plain) == {"trials", "mean", "q25", "median", "q75", "metrics"}
    assert list(renamed.pop("metrics").values()) == list(plain.pop("metrics").values())
    assert renamed == plain


@pytest.mark.parametrize(
    ("fitness", "metrics", "same"),
    [
        ([1, 1], [[2], [2]], True),
        ([1, 2], [[2], [2]], False),
        ([1, 1], [[2], [3]], False),
        ([np.nan, np.nan], [[], []], True),
    ],
)
def test_trials_are_the_same_if_fitness_and_metrics_are(
    fitness: list[float], metrics: list[list[float]], same: bool
) -> None:
    assert (
        HeldOutResult(
            np.array(fitness)[:, None], np.array(metrics, np.float64), ("m",)
        ).all_the_same()
        is same
    )


def test_a_champion_is_tried_on_other_settings(tmp_path: Path) -> None:
    """Ranges are drawn from, set and fixed; the champion fixes the rest of the experiment."""
    folder = written(tmp_path, [1])
    assert ALIKE in evaluate(folder, "--trials", "8")
    drawn = evaluate(
        folder, "--trials", "8", "--set", "problem.settings.steps={ from = 1, to = 50 }"
    )
    assert ALIKE not in drawn
    assert "rounds          mean 1\n" in evaluate(
        folder, "--trials", "8", "--set", "problem.settings.steps=1"
    )
    varied = written(tmp_path / "varied", [1], settings={"steps": {"from": 1, "to": 50}})
    assert evaluate(varied, "--trials", "8").splitlines()[1:] == drawn.splitlines()[1:]
    assert "rounds          mean 7\n" in evaluate(
        varied, "--set", "problem.settings.steps=7"
    )


@pytest.mark.parametrize(
    ("override", "line"),
    [
        (
            "steps=3",
            "--set steps=3: expected a simulator's setting, such as problem.settings.agents=20",
        ),
        (
            "problem.trials=3",
            "--set problem.trials=3: expected a simulator's setting, such as "
            "problem.settings.agents=20",
        ),
        ("problem.settings.agents=0", "problem.settings: agents: expected int >= 1"),
        (
            "problem.settings.agnets=3",
            "problem.settings: unknown key 'agnets' (did you mean 'agents'?)",
        ),
    ],
)
def test_other_settings_are_checked(override: str, line: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        command, ["evaluate", str(written(tmp_path, [1])), "--set", override]
    )
    assert isinstance(done.exception, ConfigError)
    assert str(done.exception).startswith(line)


def test_a_champion_that_other_code_evolved_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = written(tmp_path, [1])
    run = Run(folder)
    assert other_code(run).startswith(
        f"The code has changed since this run (version hash {run.meta['version_hash']}"
    )
    monkeypatch.setitem(
        run.meta, "version_hash", version_hash("emergency-exit", "fully-meshed")
    )
    assert other_code(run) == ""
    said = CliRunner().invoke(command, ["evaluate", str(folder), "--trials", "1"])
    assert "The code has changed since this run" in said.stderr


def test_options_of_the_cluster_are_refused_for_one_run(tmp_path: Path) -> None:
    """Its champion plays here; those of a study are played on servers, too."""
    folder = written(tmp_path, [1])
    with pytest.raises(
        ConfigError, match=r"^--servers: the champion of one run plays on"
    ):
        evaluate(folder, "--servers", "3")
