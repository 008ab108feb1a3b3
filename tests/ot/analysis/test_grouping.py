"""Repeats are one group, labelled by what differs."""

from pathlib import Path

import pytest

from tests.ot.record.recorded import make
from zswarm import experiment
from zswarm.ot.analysis.grouping import groups
from zswarm.ot.record.runs import runs_below
from zswarm.ot.record.writer import Record


def test_repeats_are_one_group_named_as_their_experiment(tmp_path: Path) -> None:
    for seed in (1, 2, 3):
        make(
            tmp_path,
            "lab",
            f"seed={seed}",
            f"generations={seed}",
            f"cluster.local_slots={seed}",
        )
    together = groups(runs_below([tmp_path]))
    assert {label: len(runs) for label, runs in together.items()} == {"lab": 3}


@pytest.mark.parametrize(
    ("settings", "labels"),
    [
        (
            [["optimizer.population=50"], ["optimizer.population=100"]],
            ["population 50", "population 100"],
        ),
        (
            [
                ["optimizer.population=50", "representation.hidden=2"],
                ["optimizer.population=50", "representation.hidden=4"],
                ["optimizer.population=60", "representation.hidden=4"],
            ],
            [
                "hidden 2, population 50",
                "hidden 4, population 50",
                "hidden 4, population 60",
            ],
        ),
        ([["problem.trials=1"], ["problem.trials=2"]], ["trials 1", "trials 2"]),
        (
            [["optimizer.severity=0.3"], ["optimizer.severity=0.25"]],
            ["severity 0.3", "severity 0.25"],
        ),
        (
            [["representation.activation=clamp"], ["representation.activation=relu"]],
            ["activation clamp", "activation relu"],
        ),
        (
            [
                [],
                [
                    "representation.hidden=3",
                    "problem.trials=2",
                    "optimizer.population=7",
                    "optimizer.severity=0.2",
                ],
            ],
            ["lab", "lab (lab-2)"],
        ),
    ],
)
def test_groups_are_named_by_what_differs(
    tmp_path: Path, settings: list[list[str]], labels: list[str]
) -> None:
    for setting in settings:
        make(tmp_path, "lab", *setting)
    together = groups(runs_below([tmp_path]))
    assert sorted(together) == sorted(labels)
    assert all(len(runs) == 1 for runs in together.values())


def test_groups_with_different_problems_are_labelled_by_simulator(
    tmp_path: Path,
) -> None:
    make(tmp_path, "lab")
    minisim = experiment.complete(experiment.load(experiment.find("minisim")), "test")
    Record.create(tmp_path, minisim, "hash").close()
    together = groups(runs_below([tmp_path]))
    assert [label.split(",")[0] for label in together] == ["emergency-exit", "minisim"]
