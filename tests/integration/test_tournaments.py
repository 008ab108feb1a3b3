"""Tournaments give the same result for any number of slots and after a kill."""

from pathlib import Path

import pytest

from tests.integration.programs import Optimizer, query, wait_until
from tests.promise.promise import check_run

GENERATIONS, STEPS = 3, 2000
LATER_ROUND = "SELECT 1 FROM outcomes WHERE generation = 1 AND round >= 2"


def options(slots: int) -> list[str]:
    settings = [
        f"generations={GENERATIONS}",
        f"problem.settings.steps={STEPS}",
        "optimizer.population=17",
        f"cluster.local_slots={slots}",
    ]
    return [
        "--json",
        "--servers",
        "local",
        *(word for setting in settings for word in ("--set", setting)),
    ]


@pytest.mark.long
def test_a_killed_tournament_has_the_same_result_on_any_number_of_slots(
    tmp_path: Path,
) -> None:
    """It is killed in a later round of the second generation; no recorded trial is played again."""
    whole = Optimizer(
        tmp_path, "whole", ["run", "minisim-duel", *options(1), "--out", "whole"]
    ).done()
    run = tmp_path / "runs" / "minisim-duel"
    killed = Optimizer(tmp_path, "killed", ["run", "minisim-duel", *options(3)])
    wait_until(lambda: query(run, LATER_ROUND), "a later round is under way")
    killed.kill()
    killed.wait()
    before = dict(query(run, "SELECT id, trials FROM outcomes"))
    done = Optimizer(
        tmp_path,
        "resumed",
        ["resume", "runs/minisim-duel", "--json", "--servers", "local"],
    ).done()
    assert done["history_hash"] == whole["history_hash"]
    after = dict(query(run, "SELECT id, trials FROM outcomes"))
    assert before.items() < after.items(), "the run was over too early for this test"
    assert (
        check_run(run).history_hash
        == check_run(tmp_path / "whole" / "minisim-duel").history_hash
        == done["history_hash"]
    )
