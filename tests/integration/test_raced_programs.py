"""Racing and the assessment with real programs: equal on any servers, and after kills."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration import asleep
from tests.integration.evacuation import COUNTED, TRIALS
from tests.integration.programs import Optimizer, Server, query, wait_until
from zswarm.ot.record.reader import Run
from zswarm.ot.record.schema import ASSESSMENT

pytestmark = [pytest.mark.programs, pytest.mark.usefixtures("sleeping")]

SHARE = 0.5  # of the assessment: long enough to be disturbed
RACED = [
    "--set=assessment.racing=true",
    f"--set=assessment.budget={SHARE}",
]
SEARCHED = "SELECT count(*) FROM generations"


@pytest.fixture(scope="module")
def alone(
    sleeping: None,
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[dict[str, Any], int]:
    """Return the result of a run that nothing happens to, and its trials."""
    folder = tmp_path_factory.mktemp("alone")
    local = ["--servers=local", "--set=cluster.local_slots=4"]
    done = run(folder, *local).done()
    Run(folder / "runs" / "raced").check()
    trials = counted(folder)
    assert trials < (1 + SHARE) * TRIALS, "racing stops no trial"
    return done, trials


@pytest.fixture
def servers(sleeping: None, tmp_path: Path) -> Iterator[list[Server]]:
    """Yield four servers of one slot."""
    made = [Server(tmp_path, f"ss-{number}", capacity=1) for number in range(4)]
    try:
        yield [server.ready() for server in made]
    finally:
        for server in made:
            server.close()


def run(folder: Path, *options: str) -> Optimizer:
    file = asleep.write(folder, "raced")
    return Optimizer(folder, "run", ["run", file, "--json", *RACED, *options])


def on(servers: list[Server]) -> list[str]:
    """Return options that use only these servers."""
    endpoints = [f"--connect={server.endpoint}" for server in servers]
    return ["--no-multicast", f"--servers={len(servers)}", *endpoints]


def counted(folder: Path) -> int:
    rows = query(folder / "runs" / "raced", COUNTED)
    return int(rows[0][0]) if rows else 0


def searched(folder: Path) -> int:
    """Return how many generations have ended."""
    rows = query(folder / "runs" / "raced", SEARCHED)
    return int(rows[0][0]) if rows else 0


def assessing(folder: Path, trials: int) -> bool:
    """Return whether so many trials of the assessment are counted."""
    rows = query(folder / "runs" / "raced", f"{COUNTED} WHERE generation = {ASSESSMENT}")
    return bool(rows) and rows[0][0] > trials


def assert_same(folder: Path, done: dict[str, Any], alone: dict[str, Any]) -> None:
    keys = ("history_hash", "assessment_hash", "champion", "best", "evaluations")
    assert {key: done[key] for key in keys} == {key: alone[key] for key in keys}
    Run(folder / "runs" / "raced").check()


def test_servers_die_in_a_race_and_in_the_assessment(
    tmp_path: Path, servers: list[Server], alone: tuple[dict[str, Any], int]
) -> None:
    optimizer = run(tmp_path, *on(servers))
    try:
        wait_until(lambda: searched(tmp_path) == 1, "the second generation is raced")
        servers[1].kill()
        assert searched(tmp_path) < 3, "the run is over too early for this test"
        wait_until(lambda: assessing(tmp_path, 100), "the assessment is under way")
        servers[2].kill()
        before = counted(tmp_path)
        done = optimizer.done()
    finally:
        optimizer.close()
    assert before < alone[1], "the assessment is over too early for this test"
    assert_same(tmp_path, done, alone[0])
    assert counted(tmp_path) == alone[1]


@pytest.mark.parametrize("phase", ["race", "assessment"])
def test_a_killed_optimizer_resumes_in_the_middle_on_fewer_servers(
    tmp_path: Path, servers: list[Server], alone: tuple[dict[str, Any], int], phase: str
) -> None:
    killed = run(tmp_path, *on(servers))
    try:
        if phase == "race":
            wait_until(lambda: searched(tmp_path) >= 1, "the second generation is raced")
            third_round = counted(tmp_path) + 37 * 9  # of rounds of 4 trials for each
            wait_until(lambda: counted(tmp_path) > third_round, "it is a race's middle")
        else:
            wait_until(lambda: assessing(tmp_path, 100), "the assessment is under way")
    finally:
        killed.kill()
        killed.wait()
    before, ended = counted(tmp_path), searched(tmp_path)
    assert ended < 4 if phase == "race" else ended == 4
    assert before < alone[1], "the run is over too early for this test"
    again = ["resume", "runs/raced", "--json", *on(servers[:1])]
    done = Optimizer(tmp_path, "resumed", again).done()
    assert_same(tmp_path, done, alone[0])
    assert counted(tmp_path) == alone[1], "a recorded trial was evaluated again"
